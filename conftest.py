# SPDX-License-Identifier: Apache-2.0
"""
For all tests: linear algebra on one thread, as in every command; examples untimed and repeatable.

The workers of pytest-xdist take a file each as they become free (`--dist loadfile`). Files with a test
that is marked `long` come first, those that take longest before the others, then those with one that is
`slow`: so short ones at the end let the workers end together.
"""

import os

import hypothesis
import pytest

import waferbot_twin  # noqa: F401  before any test imports numpy

# A machine that is busy with something else must not fail a test, nor chance.
hypothesis.settings.register_profile('waferbot', deadline=None, derandomize=True)
hypothesis.settings.load_profile('waferbot')

LONG_S = 30.0
"""What a file takes that is marked `long` without saying how many seconds."""


@pytest.hookimpl(optionalhook=True)  # where pytest-xdist is installed
def pytest_xdist_auto_num_workers() -> int:
    """Return one more than there are cores: nodes over ROS wait for one another much of the time."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files first that take long, else in the order in which they were found."""
    seconds: dict[object, float] = {}
    slow = set()
    for item in items:
        if item.get_closest_marker('slow'):
            slow.add(item.path)
        if mark := item.get_closest_marker('long'):
            own = float(mark.args[0]) if mark.args else LONG_S
            seconds[item.path] = max(own, seconds.get(item.path, 0.0))
    items.sort(key=lambda item: (-seconds.get(item.path, 0.0), item.path not in slow))
