# SPDX-License-Identifier: Apache-2.0
"""For all tests: linear algebra on one thread, as in every command; examples untimed and repeatable."""

import hypothesis

import waferbot_twin  # noqa: F401  before any test imports numpy

# A machine that is busy with something else must not fail a test, nor chance.
hypothesis.settings.register_profile('waferbot', deadline=None, derandomize=True)
hypothesis.settings.load_profile('waferbot')
