# SPDX-License-Identifier: Apache-2.0
"""What ROS refuses of a secured process (SROS2), in words: it has no key, or may not do what it does."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from waferbot_lockstep.errors import UserError

ENABLE = 'ROS_SECURITY_ENABLE'
"""Environment variable of ROS: `true` if security is asked for."""


@contextlib.contextmanager
def refusals_told() -> Iterator[None]:
    """
    Raise `UserError` for what rcl refuses inside, if security is asked for.

    No enclave, another domain, a topic that its permissions do not have, middleware that is built
    without security: rclpy has one exception for all of it, a RuntimeError.
    """
    try:
        yield
    except RuntimeError as error:
        if os.environ.get(ENABLE, '').lower() != 'true':
            raise
        said = ' '.join(str(error).split())
        raise UserError(f'with {ENABLE}=true ROS refuses this process: {said}') from error
