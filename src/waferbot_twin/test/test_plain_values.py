# SPDX-License-Identifier: Apache-2.0
"""Numbers and names as a reader reads them."""

from __future__ import annotations

import math

import pytest

from waferbot_twin.plain_values import listed, significant


@pytest.mark.parametrize(
    ('value', 'digits', 'said'),
    [
        (710.4, 2, '710'),
        (-123456.0, 4, '-123500'),
        (99.96, 3, '100'),
        (1234.0, 4, '1234'),
        (2.5e9, 3, '2.5e+09'),
        (0.012345, 3, '0.0123'),
        (0.0, 3, '0'),
        (math.inf, 3, '-'),
        (None, 3, '-'),
    ],
)
def test_significant_digits_without_an_exponent_up_to_millions(value, digits, said):
    assert significant(value, digits) == said


@pytest.mark.parametrize(
    ('names', 'said'),
    [([], ''), (['a'], 'a'), (['a', 'b'], 'a and b'), (['a', 'b', 'c'], 'a, b and c')],
)
def test_names_in_a_sentence(names, said):
    assert listed(names) == said
