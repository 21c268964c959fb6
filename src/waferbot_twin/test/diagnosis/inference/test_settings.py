# SPDX-License-Identifier: Apache-2.0
"""Settings of a diagnosis out of their range are refused by name."""

from __future__ import annotations

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.settings import Settings


@pytest.mark.parametrize(
    ('values', 'named'),
    [
        ({'named_from': 0.0}, 'named_from'),
        ({'named_from': 1.0}, 'named_from'),
        ({'credible_level': 1.5}, 'credible_level'),
        ({'refutation_level': 0.0}, 'refutation_level'),
        ({'expected_causes': 0.0}, 'expected_causes'),
        ({'prior_scales': (0.1, -1.0)}, 'prior_scales'),
        ({'most_causes': 0}, 'most_causes'),
        ({'most_refits': 0}, 'most_refits'),
        ({'named_from': float('nan')}, 'named_from'),
        ({'included_from': 0.0}, 'included_from'),
        ({'named_from': 0.5, 'included_from': 0.6}, 'named_from is 0.5, less than'),
    ],
)
def test_a_value_out_of_its_range_is_refused(values, named):
    with pytest.raises(UserError, match=named):
        Settings(**values)


def test_the_usual_ones_are_in_range():
    assert (
        0.5 == Settings().included_from < Settings().named_from < Settings().credible_level < 1.0
    )
