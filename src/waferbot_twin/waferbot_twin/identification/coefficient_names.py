# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the least squares as a reader knows them."""

from __future__ import annotations

import math
from collections.abc import Sequence


def coefficient_name(name: str, length_unit: str, wave_numbers: Sequence[float] = ()) -> str:
    """
    Return the name of a coefficient on an axis whose position is in m or rad.

    `wave_numbers` are those of its sines, `estimation.inverse_dynamics.Terms`.
    """
    kind, _, place = name.partition('_')
    if kind in ('sine', 'cosine'):
        return f'{kind}, {_wave_text(wave_numbers[int(place) - 1], length_unit)}'
    names = {
        'inertia': 'mass' if length_unit == 'm' else 'inertia',
        'viscous': 'viscous friction',
        'viscous_forward': 'viscous friction forwards',
        'viscous_backward': 'viscous friction backwards',
        'coulomb': 'Coulomb friction',
        'rise': 'more of it at rest',
    }
    return names.get(name, name)


def _wave_text(wave_number: float, length_unit: str) -> str:
    """Return a wave number (rad per m or rad) as a period in mm, or as an order per turn."""
    if length_unit == 'm':
        return f'period {2e3 * math.pi / wave_number:.4g} mm'
    return f'{wave_number:.4g} per turn'
