# SPDX-License-Identifier: Apache-2.0
"""
What a description says about motors, encoders and current sensors, read and checked.

A key that is left out has its neutral value, as in `imperfections`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from waferbot_lockstep.marked_yaml import Key
from waferbot_plant.description import (
    LONGEST_DELAY,
    CurrentSensors,
    CyclicError,
    Encoder,
    EncoderErrors,
    Heating,
    Motor,
    Ripple,
)

if TYPE_CHECKING:
    from waferbot_plant.description_reader import Reader


FORCE_KEYS = ('force_per_ampere_n_a', 'torque_per_ampere_nm_a')
"""What a motor may be known by in place of its data sheet, where it slides and where it turns."""

LAG_KEY = 'lag_s'
"""How the force of a motor follows what its drive is told, where no amplifier is modelled."""

CYCLE_KEYS = ('electrical_cycle_m', 'pole_pairs')
"""How a description gives a motor's poles."""

WINDING_KEYS = ('winding', 'resistance_lead_to_lead_ohm', 'inductance_lead_to_lead_h')

_OF_WINDINGS = (
    *WINDING_KEYS, 'back_emf_lead_to_lead_v_s_m', 'back_emf_lead_to_lead_v_s_rad', 'heating',
    'phase_imbalance',
)  # fmt: skip

STAND_IN_RESISTANCE, STAND_IN_INDUCTANCE = 1.0, 1e-3
"""Of a motor that is known by its force alone, ohm and H; nothing is ever reckoned with them."""


def read_motor(reader: Reader, axis: str) -> Motor:
    """Read a motor: its data sheet, or its force per ampere alone."""
    key: Key = ('motors', axis)
    value = reader.data['motors'][axis]
    coordinate, revolute = reader.coordinate(key, value)
    if not any(name in value for name in FORCE_KEYS):
        missing = [name for name in WINDING_KEYS if name not in value]
        if missing:
            raise reader.document.error(
                key, f'{" and ".join(missing)} missing (or give {FORCE_KEYS[revolute]} alone)'
            )
        back_emf = reader.quantity(
            key, revolute, 'back_emf_lead_to_lead_v_s_m', 'back_emf_lead_to_lead_v_s_rad'
        )
        poles_known = True
        cycle = reader.quantity(key, revolute, *CYCLE_KEYS)
        windings = (
            value['winding'],
            float(value['resistance_lead_to_lead_ohm']),
            float(value['inductance_lead_to_lead_h']),
        )
    else:
        for name in _OF_WINDINGS:
            if name in value:
                raise reader.document.error(
                    (*key, name),
                    'says how the motor is wound; give either the whole data sheet or '
                    f'{FORCE_KEYS[revolute]}',
                )
        # Force is sqrt(3)/2 of the EMF from lead to lead, in either winding.
        back_emf = reader.quantity(key, revolute, *FORCE_KEYS) * 2.0 / math.sqrt(3.0)
        # Without poles, orders count per turn or per metre.
        poles_known = any(name in value for name in CYCLE_KEYS)
        cycle = reader.quantity(key, revolute, *CYCLE_KEYS) if poles_known else 1.0
        windings = ('wye', STAND_IN_RESISTANCE, STAND_IN_INDUCTANCE)
    return Motor(
        axis,
        coordinate,
        *windings,
        float(back_emf),
        float(cycle) if revolute else 2.0 * math.pi / cycle,
        _heating(reader, axis),
        float(value.get('saturation_current_a', 0.0)),
        _ripple(reader, axis),
        _pair(value.get('phase_imbalance', (0.0, 0.0))),
        any(name in value for name in FORCE_KEYS),
        float(value.get(LAG_KEY, 0.0)),
        float(value.get('peak_current_a', math.inf)),
        poles_known,
    )


def _ripple(reader: Reader, axis: str) -> tuple[Ripple, ...]:
    """Read the ripples of a motor's constant, which together must leave it its sign."""
    ripple = tuple(
        Ripple(float(one['order']), float(one.get('cosine', 0.0)), float(one.get('sine', 0.0)))
        for one in reader.data['motors'][axis].get('ripple', ())
    )
    total = sum(math.hypot(one.cosine, one.sine) for one in ripple)
    if total >= 1.0:
        raise reader.document.error(
            ('motors', axis, 'ripple'),
            f'amplitudes add up to {total:g}; they are relative and must stay below 1',
        )
    return ripple


def _heating(reader: Reader, axis: str) -> Heating | None:
    """Read how a motor warms up; None for one that stays at the data sheet's temperature."""
    value = reader.data['motors'][axis].get('heating')
    if value is None or value['state'] == 'cold':
        return None
    return Heating(
        to_air=float(value['winding_to_air_k_w']),
        capacity=float(value['winding_capacity_j_k']),
        air=float(value['air_degc']),
        resistance_at=float(value['resistance_at_degc']),
        coefficient=float(value['resistance_rise_1_k']),
        start=float(value.get('winding_start_degc', value['air_degc'])),
        limit=value.get('winding_limit_degc'),
    )


def read_encoder(reader: Reader, place: str) -> Encoder:
    """Read an encoder's resolution."""
    key: Key = ('encoders', place)
    coordinate, revolute = reader.coordinate(key, reader.data['encoders'][place])
    counts = reader.quantity(key, revolute, 'counts_per_m', 'counts_per_revolution')
    per_unit = counts / (2.0 * math.pi) if revolute else float(counts)
    errors = _encoder_errors(reader, place, revolute)
    counting = str(reader.data['encoders'][place].get('counting', ''))
    return Encoder(place, coordinate, per_unit, errors, counting)


def _encoder_errors(reader: Reader, place: str, revolute: bool) -> EncoderErrors:
    """Read what is wrong with an encoder."""
    key: Key = ('encoders', place)
    value = reader.data['encoders'][place]
    lost: dict[str, Any] = value.get('lost_counts', {})
    every = reader.quantity((*key, 'lost_counts'), revolute, 'every_m', 'every_rad') if lost else 0
    errors = EncoderErrors(
        scale=float(value.get('scale_error', 0.0)),
        eccentricity=_eccentricity(reader, (*key, 'eccentricity'), revolute),
        interpolation=_cyclic_error(value.get('interpolation'), 'counts'),
        coarseness=float(value.get('coarseness_counts', 1.0)),
        extra_delay=int(value.get('extra_delay_cycles', 0)),
        delay_fraction=float(value.get('delay_fraction', 0.0)),
        delay=float(value.get('delay_s', 0.0)),
        noise=float(value.get('noise_counts', 0.0)),
        noise_seed=int(value.get('noise_seed', 0)),
        lost_counts=float(lost.get('counts', 0.0)),
        lost_every=float(every),
    )
    common = int(reader.section('feedback').get('delay_cycles', 1))
    if common + errors.extra_delay > LONGEST_DELAY:
        raise reader.document.error(
            (*key, 'extra_delay_cycles'),
            f'is {errors.extra_delay}; with feedback.delay_cycles = {common} the count would be '
            f'{common + errors.extra_delay} cycles late, the longest delay is {LONGEST_DELAY}',
        )
    return errors


def _eccentricity(reader: Reader, key: Key, revolute: bool) -> CyclicError:
    """Read the eccentricity of an encoder, in the unit of its coordinate."""
    value = reader.data['encoders'][key[1]].get('eccentricity')
    if value is None:
        return CyclicError()
    reader.quantity(key, revolute, 'amplitude_m', 'amplitude_rad')
    reader.quantity(key, revolute, 'period_m', 'period_rad')
    unit = 'rad' if revolute else 'm'
    return _cyclic_error(value, unit)


def read_current_sensors(reader: Reader, axis: str) -> CurrentSensors:
    """Read the errors of a motor's current sensors."""
    reader.reference(('current_sensors', axis), axis, reader.section('motors'), 'motor')
    value = reader.data['current_sensors'][axis]
    return CurrentSensors(
        axis,
        (float(value.get('gain_1', 0.0)), float(value.get('gain_2', 0.0))),
        (float(value.get('offset_1_a', 0.0)), float(value.get('offset_2_a', 0.0))),
        float(value.get('noise_a', 0.0)),
        int(value.get('noise_seed', 0)),
    )


def _pair(values: Sequence[float]) -> tuple[float, float]:
    """Return two numbers as a tuple."""
    return float(values[0]), float(values[1])


def _cyclic_error(value: Mapping[str, Any] | None, unit: str) -> CyclicError:
    """Return the cyclic error whose amplitude and period are given in `unit`; none for None."""
    if value is None:
        return CyclicError()
    return CyclicError(
        float(value[f'amplitude_{unit}']),
        float(value[f'period_{unit}']),
        float(value.get('phase_rad', 0.0)),
    )
