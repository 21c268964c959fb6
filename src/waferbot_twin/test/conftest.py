# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of waferbot_twin."""

from __future__ import annotations

import os

import numpy as np
import pytest


@pytest.fixture
def random(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers of the seed `SEED` of a test's module, or of the environment."""
    seed = int(os.environ.get('WAFERBOT_SEED', request.module.SEED))
    print(f'seed {seed}: repeat with WAFERBOT_SEED={seed}')
    return np.random.default_rng(seed)
