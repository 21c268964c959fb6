# SPDX-License-Identifier: Apache-2.0
"""
What a description says about friction in numbers: a table over speed, or a map over load and speed.

How they are interpolated is in `friction_laws`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.marked_yaml import Key

if TYPE_CHECKING:
    from waferbot_plant.description_reader import Reader

Array = NDArray[np.float64]

LOADS = ('load_n', 'load_nm')


def read_table(reader: Reader, key: Key, revolute: bool) -> tuple[Array, Array, Array]:
    """
    Return speeds (n,), m/s or rad/s, loads (m,) and resistances, N or Nm, of the friction at `key`.

    Resistances are (n,) without loads, which are a single zero then, and (m, n) with them. Raises
    `UserError` with file, line and key if they do not fit together.
    """
    value = reader.data['frictions'][key[1]]
    speeds = reader.quantity(key, revolute, 'speed_m_s', 'speed_rad_s')
    resistances = reader.quantity(key, revolute, 'force_n', 'torque_nm')
    where = (*key, 'torque_nm' if revolute else 'force_n')
    if not any(name in value for name in LOADS):
        if 'load_of' in value:
            raise reader.document.error(
                (*key, 'load_of'), 'needs load_n: a map over the load of the bearing'
            )
        if any(isinstance(row, list) for row in resistances):
            raise reader.document.error(where, f'rows are for loads: give {LOADS[revolute]} too')
        if len(speeds) != len(resistances):
            raise reader.document.error(
                key, f'{len(speeds)} speeds but {len(resistances)} values of friction'
            )
        _check_rising(reader, key, 'speeds', speeds)
        return np.array(speeds, float), np.zeros(1), np.array(resistances, float)
    of_bearing = 'load_of' in value
    if of_bearing and 'load_nm' in value:
        raise reader.document.error(
            (*key, 'load_nm'), 'the load of a bearing is in N: give load_n'
        )
    over = LOADS[revolute and not of_bearing]
    loads = value[over] if of_bearing else reader.quantity(key, revolute, *LOADS)
    _check_rising(reader, key, 'speeds', speeds)
    _check_rising(reader, (*key, over), 'loads', loads)
    if len(loads) != len(resistances):
        raise reader.document.error(
            where, f'{len(loads)} loads but {len(resistances)} rows of friction'
        )
    for place, row in enumerate(resistances):
        if not isinstance(row, list):
            raise reader.document.error(
                (*where, place), f'is {row}; with loads it is a row, a value for each speed'
            )
        if len(row) != len(speeds):
            raise reader.document.error(
                (*where, place), f'{len(speeds)} speeds but {len(row)} values of friction'
            )
    return np.array(speeds, float), np.array(loads, float), np.array(resistances, float)


def refuse_loads(reader: Reader, key: Key, reason: str) -> None:
    """Raise `UserError` if the friction at `key` has loads."""
    for name in LOADS:
        if name in reader.data['frictions'][key[1]]:
            raise reader.document.error((*key, name), reason)


def _check_rising(reader: Reader, key: Key, name: str, values: Sequence[float]) -> None:
    """Refuse points that do not rise from zero."""
    if values[0] != 0.0 or any(a >= b for a, b in pairwise(values)):
        raise reader.document.error(key, f'{name} must rise from 0; they are {values}')
