# SPDX-License-Identifier: Apache-2.0
"""
What a description says about the imperfections of a mechanism, read and checked.

A key that is left out has its neutral value, which is the machine without that imperfection. What
they do is in `disturbances`, `friction_laws` and `spring_laws`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.marked_yaml import Key
from waferbot_plant import disturbances

if TYPE_CHECKING:
    from waferbot_plant.description_reader import Reader

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Disturbance:
    """
    A force on a coordinate, N or Nm; which numbers count depends on `kind` (see `disturbances`).

    `wave_number` in rad per m or rad, `bandwidth` in Hz, `at` in m, rad, their rates, or s.
    """

    name: str
    coordinate: str
    kind: str
    constant: float = 0.0
    cosine: float = 0.0
    sine: float = 0.0
    wave_number: float = 0.0
    rms: float = 0.0
    bandwidth: float = 0.0
    seed: int = 0
    at: Vector = field(default_factory=lambda: np.zeros(1))
    values: Vector = field(default_factory=lambda: np.zeros(1))


@dataclass(frozen=True)
class Vibration:
    """The floor's acceleration: amplitude (3,) in m/s2 times sin(2 pi f t + phase)."""

    acceleration: Vector = field(default_factory=lambda: np.zeros(3))
    frequency: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True)
class TransmissionError:
    """
    By how much the driven end stands ahead: amplitude (m, rad) times cos(order angle - phase).

    `order` is per turn of the driving coordinate, or of the driven one if `of_driven`.
    """

    amplitude: float
    order: float
    phase: float
    of_driven: bool


_KEYS = {
    'constant': {'force_n', 'torque_nm'},
    'periodic': {
        'period_m', 'period_rad', 'order', 'cosine_n', 'cosine_nm', 'sine_n', 'sine_nm',
    },
    'table': {
        'over', 'at_m', 'at_rad', 'at_m_s', 'at_rad_s', 'at_s', 'force_n', 'torque_nm',
    },
    'noise': {'rms_n', 'rms_nm', 'bandwidth_hz', 'seed'},
}  # fmt: skip
_AT = {
    'position': ('at_m', 'at_rad'),
    'velocity': ('at_m_s', 'at_rad_s'),
    'time': ('at_s', 'at_s'),
}


def read_disturbances(reader: Reader) -> dict[str, Disturbance]:
    """Read the section `disturbances`."""
    section = reader.section('disturbances')
    if len(section) > disturbances.SLOTS:
        raise reader.document.error(
            ('disturbances',), f'there are {len(section)}; at most {disturbances.SLOTS} can be'
        )
    return {name: _disturbance(reader, name) for name in section}


def _disturbance(reader: Reader, name: str) -> Disturbance:
    """Read one force."""
    key: Key = ('disturbances', name)
    value = reader.data['disturbances'][name]
    kind = value['kind']
    for other in value:
        if other not in {'kind', 'coordinate', *_KEYS[kind]}:
            raise reader.document.error(
                (*key, other), f'a {kind} force has no such key; it takes {_listed(_KEYS[kind])}'
            )
    coordinate, revolute = reader.coordinate(key, value)
    if kind == 'constant':
        force = reader.quantity(key, revolute, 'force_n', 'torque_nm')
        if isinstance(force, list):
            raise reader.document.error(key, 'a constant force must be a number, not a list')
        return Disturbance(name, coordinate, kind, constant=float(force))
    if kind == 'periodic':
        return Disturbance(
            name,
            coordinate,
            kind,
            cosine=optional(reader, key, revolute, 'cosine_n', 'cosine_nm'),
            sine=optional(reader, key, revolute, 'sine_n', 'sine_nm'),
            wave_number=wave_number(reader, key, revolute, value.get('order', 1)),
        )
    if kind == 'noise':
        for needed in ('bandwidth_hz', 'seed'):
            if needed not in value:
                raise reader.document.error(key, f'{needed} missing')
        return Disturbance(
            name,
            coordinate,
            kind,
            rms=float(reader.quantity(key, revolute, 'rms_n', 'rms_nm')),
            bandwidth=float(value['bandwidth_hz']),
            seed=int(value['seed']),
        )
    if 'over' not in value:
        raise reader.document.error(key, 'over missing: position, velocity or time')
    wanted = _AT[value['over']][revolute]
    for other in ('at_m', 'at_rad', 'at_m_s', 'at_rad_s', 'at_s'):
        if other in value and other != wanted:
            raise reader.document.error(
                (*key, other), f'over {value["over"]} of this coordinate the table takes {wanted}'
            )
    if wanted not in value:
        raise reader.document.error(key, f'{wanted} missing')
    forces = reader.quantity(key, revolute, 'force_n', 'torque_nm')
    if not isinstance(forces, list):
        raise reader.document.error(key, 'a table takes a list of forces')
    at = value[wanted]
    if len(at) != len(forces):
        raise reader.document.error(key, f'{len(at)} points but {len(forces)} forces')
    _check_rising(reader, (*key, wanted), at)
    return Disturbance(
        name, coordinate, value['over'], at=np.array(at, float), values=np.array(forces, float)
    )


def read_vibration(reader: Reader) -> Vibration:
    """Read the section `vibration`; a floor at rest if there is none."""
    value = reader.section('vibration')
    if not value:
        return Vibration()
    return Vibration(
        np.array(value['acceleration_m_s2'], float),
        float(value['frequency_hz']),
        float(value.get('phase_rad', 0.0)),
    )


def read_transmission_error(
    reader: Reader, key: Key, value: dict[str, Any]
) -> TransmissionError | None:
    """Read the error of a transmission; only a spring in it can take it up."""
    if 'transmission_error' not in value:
        return None
    inner = (*key, 'transmission_error')
    error = value['transmission_error']
    of = error.get('of', 'driving')
    if not reader.revolute[value[of]]:
        raise reader.document.error(
            (*inner, 'of'), f'the {of} coordinate is a length; an order is per turn of an angle'
        )
    states = [
        reader.section('connections')[stage['connection']]['state']
        for stage in value['stages']
        if 'connection' in stage
    ]
    if 'flexible' not in states or any(stage['kind'] == 'cable' for stage in value['stages']):
        raise reader.document.error(
            inner, 'needs a flexible connection in the transmission, and none that only pulls'
        )
    amplitude = reader.quantity(
        inner, reader.revolute[value['driven']], 'amplitude_m', 'amplitude_rad'
    )
    return TransmissionError(
        float(amplitude), float(error['order']), float(error.get('phase_rad', 0.0)), of == 'driven'
    )


_LAW_KEYS = {
    'gap': ('gap_m', 'gap_rad'),
    'hardening': ('hardening_1_m2', 'hardening_1_rad2'),
    'slip': ('slip_force_n', 'slip_torque_nm'),
}


def read_spring_law(
    reader: Reader, key: Key, rotary: bool, stage_kind: str | None
) -> dict[str, Any]:
    """Return what a connection says beyond its stiffness, by the names of `Connection`."""
    value = reader.data['connections'][key[1]]
    law: dict[str, Any] = {}
    for name, keys in _LAW_KEYS.items():
        for given in keys:
            if given in value and stage_kind == 'cable':
                raise reader.document.error((*key, given), 'a cable has slack_m instead')
        if keys[0] in value or keys[1] in value:
            law[name] = float(reader.quantity(key, rotary, *keys))
    for given, name, kind in (
        ('slack_preload_n', 'slack_preload', 'belt'),
        ('slack_m', 'slack', 'cable'),
        ('rope_mass_kg', 'rope_mass', 'cable'),
    ):
        if given in value:
            if stage_kind != kind:
                raise reader.document.error((*key, given), f'only a {kind} has that')
            law[name] = float(value[given])
    return law


def read_friction_law(reader: Reader, key: Key, revolute: bool) -> dict[str, float]:
    """Return the parameters of `friction_laws` that a friction gives, by name, in SI units."""
    value = reader.data['frictions'][key[1]]
    law = {
        name: float(value[name])
        for name in ('asymmetry', 'per_motor_force', 'position_amplitude', 'cold_amplitude')
        if name in value
    }
    if 'position_amplitude' in value:
        law['position_wave'] = wave_number(reader, key, revolute, value.get('position_order', 1))
        law['position_phase'] = float(value.get('position_phase_rad', 0.0))
    else:
        for name in ('position_order', 'position_phase_rad', 'period_m', 'period_rad'):
            if name in value:
                raise reader.document.error((*key, name), 'goes with position_amplitude')
    if ('cold_amplitude' in value) != ('cold_time_s' in value):
        raise reader.document.error(key, 'give both cold_amplitude and cold_time_s, or neither')
    if 'cold_time_s' in value:
        law['cold_rate'] = 1.0 / value['cold_time_s']
    if 'per_motor_force_back' in value:
        driving = value.get('per_motor_force', 0.0)
        law['more_when_driven'] = float(value['per_motor_force_back']) - driving
    if 'drag' in value:
        law |= _drag(reader, key, revolute, float(value.get('factor', 1.0)))
    if 'presliding' in value:
        inner = (*key, 'presliding')
        if value.get('breakaway', 1.0) != 1.0:
            raise reader.document.error(
                (*key, 'breakaway'),
                'friction with presliding breaks away at its table for speed zero; '
                'put the peak there',
            )
        law['bristle_stiffness'] = float(
            reader.quantity(inner, revolute, 'stiffness_n_m', 'stiffness_nm_rad')
        )
        law['bristle_damping'] = optional(
            reader, inner, revolute, 'damping_n_s_m', 'damping_nm_s_rad'
        )
    return law


def _drag(reader: Reader, key: Key, revolute: bool, factor: float) -> dict[str, float]:
    """Return coefficient and exponent of b |u|^p, from the force at one speed."""
    inner = (*key, 'drag')
    force = reader.quantity(inner, revolute, 'force_n', 'torque_nm')
    speed = reader.quantity(inner, revolute, 'at_speed_m_s', 'at_speed_rad_s')
    exponent = float(reader.data['frictions'][key[1]]['drag'].get('exponent', 1.0))
    return {'drag': factor * force / speed**exponent, 'drag_exponent': exponent}


def optional(
    reader: Reader, key: Key, revolute: bool, linear: str, rotary: str, default: float = 0.0
) -> float:
    """Return a quantity that may be left out, under the key that has the coordinate's unit."""
    value: Any = reader.data
    for part in key:
        value = value[part]
    if linear in value or rotary in value:
        return float(reader.quantity(key, revolute, linear, rotary))
    return default


def wave_number(reader: Reader, key: Key, revolute: bool, order: float) -> float:
    """Return 2 pi order / period, rad per m or rad."""
    return 2.0 * math.pi * order / reader.quantity(key, revolute, 'period_m', 'period_rad')


def _check_rising(reader: Reader, key: Key, values: Sequence[float]) -> None:
    """Refuse abscissas that do not rise."""
    if any(a >= b for a, b in pairwise(values)):
        raise reader.document.error(key, f'must rise from point to point; it is {values}')


def _listed(names: set[str]) -> str:
    """Return names in a fixed order."""
    return ', '.join(sorted(names))
