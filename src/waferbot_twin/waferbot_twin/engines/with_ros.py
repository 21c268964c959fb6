# SPDX-License-Identifier: Apache-2.0
"""The engines that need ROS 2, imported only when they are asked for."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from waferbot_lockstep.errors import UserError


def engine_with_ros(name: str) -> ModuleType:
    """Return `waferbot_twin.engines.<name>`; raises `UserError` where there is no ROS 2 for it."""
    try:
        return import_module(f'waferbot_twin.engines.{name}')
    except ImportError as error:
        raise UserError(
            f'nodes over ROS 2 need ROS 2 Jazzy and waferbot_msgs ({error}): `make demo` in a checkout '
            'of waferbot brings both, or source your workspace. Without ROS there is --engine '
            'inprocess: the same signals, bit for bit'
        ) from error
