# SPDX-License-Identifier: Apache-2.0
"""
What waferbot's library calls each hidden effect, and with which values.

`right` names do exactly what is hidden, in the machine at hand; `related` ones are a part of it, or
cannot be told from it in some motions: naming one is neither right nor a false alarm.

    hidden (values): right names; related names

    coulomb (friction at the axis): coulomb_friction [1, 2]; presliding
    motor_coulomb (friction at the motor): gearbox_friction [3]; coulomb_friction, presliding
    direction_dependent (forward, backward): coulomb_friction, its mean, with the rest as constant_force:
        the library's direction_dependent_friction is that sum
    stribeck (breakaway, speed): stribeck_friction
    viscous (damping): viscous_friction [2]
    mass (amount, kg or kg m2): wrong_inertia [2], a correction of it or of the acceleration per ampere;
        force_constant, encoder_scale
    motor_constant (ratio): force_constant, the same corrections; wrong_inertia, encoder_scale
    constant_force (force): constant_force
    imbalance (offset_x, offset_y, m): centre_of_gravity
    cogging (cosine_N, sine_N at the motor): cogging
    eccentricity (cosine, sine, period): encoder_eccentricity
    motor_eccentricity (cosine, sine, period): motor_encoder_eccentricity; transmission_error
    encoder_delay (delay_s): encoder_delay, a correction of the drive's time in the log, both by as much
        as the position is later than the drive there (`Setup.drive_late_s`); encoder_delay by all of
        it beside such a correction; motor_encoder_delay
    drive_delay (delay_s): the same, and command_delay; motor_encoder_delay
    backlash (gap, rad at the output): backlash; gearbox_compliance, that of the flanks
    compliance (rad/Nm at the output): gearbox_compliance

1. Where the description has dry friction, wrong_friction, too. 2. Of a gear that does not give, what is
before it acts just as well: gearbox_friction, gearbox_damping, motor_inertia. 3. There, what is right
for coulomb is right as well.

Mass and motor constant are told apart by nothing but friction, weight and the like, which the log may
not hold: a diagnosis that names one has to have the other in its set of what it cannot tell apart.
Frictions that the description has are then off by a factor, too: wrong_friction and viscous_friction are
related.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from independent_machine.machine import Machine, physics_of

TIME = 'time of the drive'
"""Stands for a small correction: the drive's time in the log, which samples leave open."""


@dataclass(frozen=True)
class Answer:
    """
    A name of the library with the values expected, by parameter; those that are left out are free.

    Where the drive's time is told too, those of `beside_time` are other ones.
    """

    effect: str
    values: Mapping[str, float] = field(default_factory=dict)
    beside_time: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Answers:
    """What is right for a hidden effect, the first of it best, and what is at least not false."""

    right: tuple[Answer, ...]
    related: frozenset[str] = frozenset()

    @property
    def names(self) -> frozenset[str]:
        """The names that are right."""
        return frozenset(answer.effect for answer in self.right)


def answers(
    machine: Machine,
    kind: str,
    values: Mapping[str, float],
    hidden: Mapping,
    drive_late_s: float = 0.0,
) -> Answers:
    """
    Return the answers to one of the hidden effects of a case, `hidden` being all of them.

    `drive_late_s` is how late the drive stands in the log (`Setup.drive_late_s`).
    """
    gives = 'backlash' in hidden or 'compliance' in hidden
    stiff_gear = machine.kind == 'geared' and not gives
    if kind == 'coulomb':
        return _dry(machine, values['friction'], hidden, stiff_gear)
    if kind == 'motor_coulomb':
        own = Answer('gearbox_friction', {'friction': values['friction']})
        if not stiff_gear:
            return Answers((own,), frozenset({'coulomb_friction', 'presliding'}))
        at_axis = _dry(machine, machine.ratio * values['friction'], hidden, stiff_gear)
        others = tuple(answer for answer in at_axis.right if answer.effect != own.effect)
        return Answers((own, *others), at_axis.related)
    if kind == 'viscous':
        damping = values['damping']
        right = (Answer('viscous_friction', {'damping': damping}),)
        if stiff_gear:
            right += (Answer('gearbox_damping', {'damping': damping / machine.ratio**2}),)
        return Answers(right)
    if kind == 'mass':
        amount = values['amount']
        parameter = 'mass' if machine.linear else 'inertia'
        right = (Answer('wrong_inertia', {parameter: amount}),)
        if stiff_gear:
            right += (Answer('motor_inertia', {'inertia': amount / machine.ratio**2}),)
        corrected = {'value': (machine.mass if machine.linear else machine.inertia) + amount}
        path = 'mass_kg' if machine.linear else 'inertia_kg_m2'
        right += (_acceleration(machine, hidden), Answer(f'bodies.load.{path}', corrected))
        return Answers(right, _in_other_measure(machine, 'force_constant'))
    if kind in ('encoder_delay', 'drive_delay'):
        late_s = values['delay_s'] - drive_late_s
        right = (
            Answer(
                'encoder_delay', {'delay': 1e3 * late_s}, {'delay': 1e3 * values['delay_s']}
            ),  # ms
            Answer(TIME, {'late_s': -late_s}),
        )
        if kind == 'drive_delay':
            right += (Answer('command_delay'),)
        return Answers(right, frozenset({'motor_encoder_delay'}))
    if kind == 'direction_dependent':
        mean = 0.5 * (values['forward'] + values['backward'])
        own = _dry(machine, mean, hidden, stiff_gear)
        return Answers(own.right, own.related | {'constant_force'})
    if kind == 'constant_force' and 'direction_dependent' in hidden:
        return Answers((Answer(kind),))  # with the rest of that friction
    if kind == 'motor_constant':
        path = (
            f'motors.{machine.axis}.back_emf_lead_to_lead_v_{"s_m" if machine.linear else "s_rad"}'
        )
        corrected = {'value': values['ratio'] * machine.constant * 2.0 / math.sqrt(3.0)}
        right = (
            Answer('force_constant', dict(values)),
            _acceleration(machine, hidden),
            Answer(path, corrected),
        )
        return Answers(right, _in_other_measure(machine, 'wrong_inertia'))
    name, related = {
        'stribeck': ('stribeck_friction', set()),
        'constant_force': ('constant_force', set()),
        'imbalance': ('centre_of_gravity', set()),
        'cogging': ('cogging', set()),
        'eccentricity': ('encoder_eccentricity', set()),
        'motor_eccentricity': ('motor_encoder_eccentricity', {'transmission_error'}),
        'backlash': ('backlash', {'gearbox_compliance'}),
        'compliance': ('gearbox_compliance', set()),
    }[kind]
    return Answers((Answer(name, dict(values)),), frozenset(related))


def _acceleration(machine: Machine, hidden: Mapping) -> Answer:
    """Return the correction that both a wrong mass and a wrong motor constant are."""
    ratio = hidden.get('motor_constant', {}).get('ratio', 1.0)
    moving = physics_of(machine, hidden).load_mass + machine.motor
    value = ratio * machine.axis_constant / moving
    return Answer(f'axes.{machine.axis}.acceleration_per_ampere', {'value': value})


def _in_other_measure(machine: Machine, other: str) -> frozenset[str]:
    """
    Return what stands together for a wrong mass or motor constant: all else in another measure of force.

    r k I = M q'' + R is k I = M q'' / r + R / r: with `other` the known frictions are off by a factor.
    """
    found = {other, 'encoder_scale'}
    found |= {'wrong_friction'} if machine.coulomb > 0.0 else set()
    found |= {'viscous_friction'} if machine.viscous > 0.0 else set()
    return frozenset(found)


def _dry(machine: Machine, friction: float, hidden: Mapping, stiff_gear: bool) -> Answers:
    """Return the answers to a Coulomb friction at the axis."""
    dry = {'coulomb', 'direction_dependent', *(['motor_coulomb'] if stiff_gear else [])}
    # Several that act as one: the sum is what can be found, under any of their names or all.
    both = len(dry & hidden.keys()) > 1
    values = {} if both else {'friction': friction}
    right = [Answer('coulomb_friction', values)]
    if stiff_gear:
        scaled_values = {} if both else {'friction': friction / machine.ratio}
        right.append(Answer('gearbox_friction', scaled_values))
    if machine.coulomb > 0.0:
        ratio = {} if both else {'ratio': 1.0 + friction / machine.coulomb}
        right.append(Answer('wrong_friction', ratio))
    return Answers(tuple(right), frozenset({'presliding'}))


SHAPES = ('period', 'speed')
"""Values that have no size of their own."""


def scaled(kind: str, values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Return the values of an effect that is larger by a factor."""
    if kind == 'motor_constant':
        return {'ratio': 1.0 + factor * (values['ratio'] - 1.0)}
    return {name: value if name in SHAPES else factor * value for name, value in values.items()}
