# SPDX-License-Identifier: Apache-2.0
"""When an extension that was found is withdrawn for what it does to the positions."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.diagnose import _worse


@pytest.mark.parametrize(
    ('ratios', 'worse'),
    [
        ((1.000001, 1.0, 1.0), False),  # as of a warm winding
        ((0.7, 1.02, 1.0), False),
        ((1.0, 1.05, 1.0), True),
        ((0.98, 1.3, 0.99), True),
        ((), False),
    ],
)
def test_an_extension_is_withdrawn_if_it_plainly_loses(ratios, worse):
    gains = [SimpleNamespace(rms_before=2e-6, rms_after=2e-6 * ratio) for ratio in ratios]
    assert _worse(gains) is worse
