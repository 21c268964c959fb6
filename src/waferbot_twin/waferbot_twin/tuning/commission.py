# SPDX-License-Identifier: Apache-2.0
"""
From a description of a machine to a model that runs: settings of its amplifiers and its controller.

Of each axis, as one commissions a drive:

    current loop     Cp, Ci from R and L of the motor, unity gain at 1.5 kHz (`gains_from_motor`)
    commutation      by the encoder on the motor, or by one that moves with it
    feedback         the axis' own encoder for position and velocity; counts per m or rad of the axis
    gains            natural frequency 2 pi f, damping ratio 0.7, no integral gain (`tuning.gains`)
    bias             Ixx29, what holds the weight at home
    limits           fatal following error 2 mm or 20 mrad, a warning at half of it; speeds and
                     accelerations of programmed moves are those of the shipped machine, in m and rad

That is where tuning begins: everything is taken as rigid and without friction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from waferbot_copley.current_loop import gains_from_motor
from waferbot_lockstep.contract import usual_axis
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED as SHIPPED_LAYOUT
from waferbot_lockstep.timing import Timing
from waferbot_plant import statics
from waferbot_plant.assembly import assemble
from waferbot_plant.description import Description, Encoder
from waferbot_plant.motors import check_windings
from waferbot_plant.plant import Machine
from waferbot_pmac.i_variables import axis_parameters, servo_parameters
from waferbot_twin.effects.variant import Overlay, Variant, with_rigid
from waferbot_twin.models import SHIPPED, load_model
from waferbot_twin.tuning.gains import AxisScale, Tuning, loop_gains

DAMPING_RATIO = 0.7

FATAL_ERROR = {'m': 2e-3, 'rad': 2e-2}

PER_COUNT = ('Ixx15', 'Ixx16', 'Ixx17', 'Ixx19', 'Ixx22', 'Ixx28')
"""I-variables in counts, or counts and ms, which are those of the shipped machine in m and rad."""


@dataclass(frozen=True)
class _Axis:
    """An axis of a rigid machine, and where its coordinates are among the independent ones."""

    name: str
    machine: Machine

    def ratio(self, coordinate: str) -> float:
        """Return how far a coordinate goes per m or rad of the axis; raises `UserError`."""
        placing = self.machine.assembly.placing
        row, own = placing[self.machine.description.axes[self.name]]
        other, ratio = placing[coordinate]
        if other != row:
            raise UserError(f'axis {self.name}: {coordinate} does not move with it')
        return ratio / own

    def moves_with(self, encoder: Encoder) -> bool:
        """Tell whether an encoder is on a coordinate that moves with the axis."""
        placing = self.machine.assembly.placing
        own = placing[self.machine.description.axes[self.name]][0]
        return encoder.coordinate in placing and placing[encoder.coordinate][0] == own


def commission(variant: Variant, bandwidths_hz: Mapping[str, float]) -> Variant:
    """
    Return a machine with settings of its amplifiers and its controller, for bandwidths by axis.

    Raises `UserError` for an axis without motor, encoder or bandwidth, or that runs backwards.
    """
    description = variant.description
    check_windings(description)
    rigid_description = with_rigid(description, description.connections)
    rigid = Machine(rigid_description, assemble(rigid_description), Timing())
    for axis in bandwidths_hz:
        if axis not in description.axes:
            raise UserError(
                f'{variant.name} has no axis {axis}; it has {", ".join(description.axes)}'
            )
    copley: dict[str, dict[str, Any]] = {}
    pmac: dict[str, dict[str, Any]] = {}
    for axis in description.axes:
        if axis not in bandwidths_hz:
            raise UserError(f'say the bandwidth of {axis} as well: {axis}=HZ')
        if axis not in description.motors:
            raise UserError(f'{variant.name}: axis {axis} has no motor')
        one = _Axis(axis, rigid)
        copley[axis] = _amplifier(one, variant)
        pmac[axis] = _feedback(one, description, axis)
    # Of axes that this machine lacks, the controller asks for nothing.
    layout = description.layout
    pmac |= {axis: {'Ixx29': 0} for axis in layout.axes if axis not in description.axes}
    scaled = variant.with_overlay(Overlay(pmac=pmac, copley=copley))
    base = servo_parameters(scaled.pmac, variant.name, variant.layout)[0]
    holding = statics.holding_currents(rigid, rigid.parameters(), {})
    for axis, hertz in bandwidths_hz.items():
        tuning = Tuning(2.0 * math.pi * hertz, DAMPING_RATIO, 1.0, 0.0)
        gains = loop_gains(tuning, AxisScale.of(rigid, axis), base)
        amperes = base['amplifier_peak_current'][layout.place(axis)] / 32768.0
        pmac[axis] |= {**gains, 'Ixx29': round(holding[axis] / amperes)}
    return variant.with_overlay(Overlay(pmac=pmac, copley=copley))


def _amplifier(axis: _Axis, variant: Variant) -> dict[str, Any]:
    """Return the settings of an axis' amplifier."""
    description = axis.machine.description
    motor = description.motors[axis.name]
    ratio = axis.ratio(motor.coordinate)
    if ratio < 0.0:
        raise UserError(
            f'axis {axis.name}: its motor turns against it; turn the axis of {motor.coordinate} round'
        )
    places = [
        name
        for name in description.layout.encoders
        if name in description.encoders and axis.moves_with(description.encoders[name])
    ]
    if not places:
        raise UserError(
            f'axis {axis.name}: no encoder moves with its motor, which is to be commutated'
        )
    on_motor = [one for one in places if description.encoders[one].coordinate == motor.coordinate]
    place = (on_motor or places)[0]
    encoder = description.encoders[place]
    per_motor = encoder.counts_per_unit * axis.ratio(encoder.coordinate) / ratio
    peak = variant.amplifier_setting(axis.name, 'peak_current')
    proportional, integral = gains_from_motor(
        motor.resistance,
        motor.inductance,
        peak_current=peak,
        gain_scale=variant.amplifier_setting(axis.name, 'gain_scale'),
        integral_scale=variant.amplifier_setting(axis.name, 'integral_scale'),
    )
    return {
        'motor_resistance': motor.resistance,
        'proportional_gain': proportional,
        'integral_gain': integral,
        'commutation_encoder': description.layout.encoder_place(place),
        'counts_per_electrical_cycle': per_motor * 2.0 * math.pi / motor.electrical_gain,
    }


def _feedback(axis: _Axis, description: Description, name: str) -> dict[str, Any]:
    """Return the I-variables of an axis that follow from its encoder."""
    place = description.position_encoder(name)
    if place not in description.encoders:
        wanted = ' or '.join(description.layout.encoders_of(name))
        raise UserError(f'axis {name} has no encoder; it is to be {wanted}')
    encoder = description.encoders[place]
    counts = encoder.counts_per_unit * axis.ratio(encoder.coordinate)
    if counts <= 0.0:
        raise UserError(f'axis {name}: encoder {place} counts against it')
    shipped = servo_parameters(load_model(SHIPPED).of_axes('pmac'), SHIPPED)[0]
    index = description.layout.encoder_place(place)
    unit = description.axis_units[name]
    alike = SHIPPED_LAYOUT.place(usual_axis(name, unit))  # of the shipped machine
    fatal = round(16.0 * counts * FATAL_ERROR[unit])
    found: dict[str, Any] = {
        'Ixx03': index,
        'Ixx04': index,
        'Ixx09': int(shipped['Ixx08'][alike]),  # one encoder for both loops
        'counts_per_unit': counts,
        'Ixx11': fatal,
        'Ixx12': fatal // 2,
    }
    finer = counts / float(shipped['counts_per_unit'][alike])
    for one in axis_parameters(name, description.layout):
        if one.name in PER_COUNT:
            value = float(shipped[one.name][alike]) * finer
            value = min(max(value, one.low), one.high)
            found[one.name] = max(1, round(value)) if one.integer else value
    return found
