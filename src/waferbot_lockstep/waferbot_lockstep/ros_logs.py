# SPDX-License-Identifier: Apache-2.0
"""Where ROS keeps its logs: rclpy does not start if it cannot make that folder."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path


def ensure_log_folder() -> None:
    """
    Let ROS log to a temporary folder if it cannot log where it would, as with a home that is read-only.

    Call it before `rclpy.init`. Processes that this one starts log there too; it is removed at the end.
    """
    home = os.environ.get('ROS_HOME') or os.path.join(os.path.expanduser('~'), '.ros')
    folder = Path(os.environ.get('ROS_LOG_DIR') or os.path.join(home, 'log'))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return
    except OSError:
        os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='waferbot-ros-log-')
        atexit.register(shutil.rmtree, os.environ['ROS_LOG_DIR'], ignore_errors=True)
