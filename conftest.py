# SPDX-License-Identifier: Apache-2.0
"""For all tests: linear algebra on one thread, as in every command (see `waferbot_twin`)."""

import waferbot_twin  # noqa: F401  before any test imports numpy
