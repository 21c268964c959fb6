# SPDX-License-Identifier: Apache-2.0
"""
What a description says about controllers, read and checked.

A machine of one's own is controlled by something that is no PMAC. Its law is described here, per axis;
what it computes is `waferbot_twin.controllers.law`, and docs/controllers.md has every key. Gains are in
the unit of the `output` per what the key says: `proportional_gain_per_m: 4000` with `output: V` is 4000
V/m. An output in A, N or Nm drives the axis by itself; of one in V, or in a share of full scale, the
description has to say what the drive makes of it (`drive_gain_a`, `drive_gain_n`, `drive_gain_nm`: per
V, or at full scale).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from waferbot_lockstep.marked_yaml import Key
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant.description import Controller

if TYPE_CHECKING:
    from waferbot_plant.description_reader import Reader

FASTEST_HZ = 1e5
"""A faster controller is more likely a wrong unit."""

DRIVE_GAINS = {'drive_gain_a': 'A', 'drive_gain_n': 'N', 'drive_gain_nm': 'Nm'}

KEYS_OF_ALL = (
    'kind', 'rate_hz', 'output', *DRIVE_GAINS, 'output_limit', 'delay_ms',
    'acceleration_feedforward_s2_per_',
)  # fmt: skip
KEYS_OF_P = (*KEYS_OF_ALL, 'proportional_gain_per_', 'velocity_feedforward_s_per_')
KEYS_OF_INTEGRATOR = ('integral_limit', 'anti_windup', 'tracking_time_ms')
KEYS_OF_PI = (*KEYS_OF_P, 'integral_gain_per_', *KEYS_OF_INTEGRATOR)
KEYS: dict[str, tuple[str, ...]] = {
    'p': KEYS_OF_P,
    'pi': KEYS_OF_PI,
    'pid': (*KEYS_OF_PI, 'derivative_gain_s_per_', 'derivative_filter_hz', 'derivative_of'),
    'cascade': (
        *KEYS_OF_ALL, 'position_gain_1_s', 'position_integral_gain_1_s2',
        'position_integral_limit_', 'velocity_limit_', 'velocity_gain_s_per_',
        'velocity_integral_gain_per_', 'velocity_filter_hz', 'velocity_feedforward',
        *KEYS_OF_INTEGRATOR,
    ),
}  # fmt: skip
"""The keys of each kind; one that ends in an underscore goes on with the unit of the axis."""

NEEDED = {
    'p': ('proportional_gain_per_',),
    'pi': ('proportional_gain_per_', 'integral_gain_per_'),
    'pid': ('proportional_gain_per_',),
    'cascade': ('position_gain_1_s', 'velocity_gain_s_per_'),
}


def read_controller(reader: Reader, axis: str) -> Controller:
    """Read the controller of an axis."""
    key: Key = ('controllers', axis)
    reader.reference(key, axis, reader.section('axes'), 'axis')
    reader.reference(key, axis, reader.section('motors'), 'motor')
    values: dict[str, Any] = reader.data['controllers'][axis]
    revolute = reader.revolute[reader.section('axes')[axis]]
    _check_keys(reader, key, values, revolute)

    def of(name: str, default: float = 0.0) -> float:
        """Return the value of a key, its unit that of the axis."""
        return float(values.get(_with_unit(name, revolute), default))

    drive_gain, drive_unit = _drive_gain(reader, key, values, revolute)
    anti_windup = str(values.get('anti_windup', 'conditional'))
    if (anti_windup == 'back_calculation') != ('tracking_time_ms' in values):
        raise reader.document.error(
            (*key, 'anti_windup'), 'back_calculation and tracking_time_ms go together'
        )
    return Controller(
        axis,
        values['kind'],
        float(values['rate_hz']),
        values['output'],
        drive_gain,
        drive_unit,
        output_limit=of('output_limit', math.inf),
        delay=1e-3 * of('delay_ms'),
        proportional=of('proportional_gain_per_'),
        integral=of('integral_gain_per_'),
        derivative=of('derivative_gain_s_per_'),
        derivative_filter=of('derivative_filter_hz'),
        derivative_of=str(values.get('derivative_of', 'error')),
        integral_limit=of('integral_limit', math.inf),
        anti_windup=anti_windup,
        tracking_time=1e-3 * of('tracking_time_ms'),
        velocity_feedforward=of(
            'velocity_feedforward'
            if values['kind'] == 'cascade'
            else 'velocity_feedforward_s_per_'
        ),
        acceleration_feedforward=of('acceleration_feedforward_s2_per_'),
        position_gain=of('position_gain_1_s'),
        position_integral=of('position_integral_gain_1_s2'),
        position_integral_limit=of('position_integral_limit_', math.inf),
        velocity_limit=of('velocity_limit_', math.inf),
        velocity_gain=of('velocity_gain_s_per_'),
        velocity_integral=of('velocity_integral_gain_per_'),
        velocity_filter=of('velocity_filter_hz'),
    )


def _with_unit(name: str, revolute: bool) -> str:
    """Return the whole key of an axis that turns or slides."""
    length = 'rad' if revolute else 'm'
    if name == 'integral_gain_per_':
        return f'{name}{length}_s'
    if name in ('position_integral_limit_', 'velocity_limit_'):
        return f'{name}{length}_s'
    return name + length if name.endswith('_') else name


def _check_keys(reader: Reader, key: Key, values: dict[str, Any], revolute: bool) -> None:
    """Refuse keys that the kind does not have, and units that the axis does not have."""
    kind = values['kind']
    known = [_with_unit(name, revolute) for name in KEYS[kind]]
    other = {_with_unit(name, not revolute): _with_unit(name, revolute) for name in KEYS[kind]}
    for name in values:
        if name in known:
            continue
        if name in other:
            moves = 'an angle' if revolute else 'a length'
            raise reader.document.error(
                (*key, name), f'wrong unit: the coordinate is {moves}; give {other[name]}'
            )
        raise reader.document.error(
            (*key, name),
            f'a controller of kind {kind} has no such key{did_you_mean(name, known)} '
            f'(its keys: {", ".join(known)})',
        )
    missing = [_with_unit(name, revolute) for name in NEEDED[kind]]
    missing = [name for name in missing if name not in values]
    if missing:
        raise reader.document.error(key, f'{" and ".join(missing)} missing')
    if not values['rate_hz'] <= FASTEST_HZ:
        raise reader.document.error(
            (*key, 'rate_hz'), f'is {values["rate_hz"]:g}; it must be at most {FASTEST_HZ:g}'
        )


def _drive_gain(
    reader: Reader, key: Key, values: dict[str, Any], revolute: bool
) -> tuple[float, str]:
    """Return what the drive makes of a unit of the output, and its unit."""
    force, other = ('Nm', 'N') if revolute else ('N', 'Nm')
    output = values['output']
    given = [name for name in DRIVE_GAINS if name in values]
    if other in (output, *(DRIVE_GAINS[name] for name in given)):
        place = 'output' if output == other else f'drive_gain_{other.lower()}'
        moves = 'turns' if revolute else 'slides'
        raise reader.document.error((*key, place), f'wrong unit: the axis {moves}; give {force}')
    if output in ('A', 'N', 'Nm'):
        if given:
            raise reader.document.error(
                (*key, given[0]), f'an output in {output} drives the axis by itself; take it away'
            )
        return 1.0, output
    if len(given) != 1:
        raise reader.document.error(
            key,
            f'give one of drive_gain_a and drive_gain_{force.lower()}: what the drive makes of '
            + ('1 V' if output == 'V' else 'full scale'),
        )
    return float(values[given[0]]), DRIVE_GAINS[given[0]]
