# SPDX-License-Identifier: Apache-2.0
"""
For all tests: linear algebra on one thread, as in every command; examples untimed and repeatable.

Files with a test that is marked `long` come first, then those with one that is `slow`. The workers of
pytest-xdist take a file each as they become free (`--dist loadfile`), so short ones at the end let them
end together.
"""

import hypothesis
import pytest

import waferbot_twin  # noqa: F401  before any test imports numpy

# A machine that is busy with something else must not fail a test, nor chance.
hypothesis.settings.register_profile('waferbot', deadline=None, derandomize=True)
hypothesis.settings.load_profile('waferbot')


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files first that take long, else in the order in which they were found."""
    long, slow = (
        {item.path for item in items if item.get_closest_marker(name)} for name in ('long', 'slow')
    )
    items.sort(key=lambda item: (item.path not in long, item.path not in slow))
