# SPDX-License-Identifier: Apache-2.0
"""
Everything a little off: the numbers that no real machine has exactly as its model.

Of a description every mass with its inertia, every inertia of a rotor, every force constant, every dry
friction and every damping is multiplied by a factor of its own,

    true = nominal (1 + e),    |e| uniform in 2 to 5 %, either sign.

What differs of any two machines is told for an axis by `equivalents`: the values of the library's
effects that give the nominal model the inertia, weight, force constants and frictions of the true one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import home_mass_matrix_and_weight
from waferbot_plant.motors import force_constant
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Overlay, Variant

SMALLEST, LARGEST = 0.02, 0.05
"""Relative deviations, without sign."""

CORRECTED = (
    'wrong_inertia',
    'counterweight_mass',
    'force_constant',
    'coulomb_friction',
    'viscous_friction',
)
"""Effects that a machine with everything a little off needs, and that are no causes there."""

BESIDE_THEM = (
    'centre_of_gravity',
    'constant_force',
    'counterweight_friction',
    'gearbox_damping',
    'gearbox_friction',
    'motor_inertia',
    'wafer',
)
"""Effects that are not hidden there either: a mass or friction that is off looks like them."""

RESISTANCES = ('force_n', 'torque_nm')
DAMPINGS = ('damping_n_s_m', 'damping_nm_s_rad')
BACK_EMF = ('back_emf_lead_to_lead_v_s_m', 'back_emf_lead_to_lead_v_s_rad')


@dataclass(frozen=True)
class Deviation:
    """A number of the description, by its path, and by what it is multiplied on the true machine."""

    path: str
    factor: float


def with_friction(variant: Variant) -> Variant:
    """
    Return a model that has friction: a frictionless one as if it had been identified.

    Coulomb and viscous friction of each axis, of typical size. They belong to the model: effects are
    sized by it, and add to it.
    """
    if variant.machine.get('frictions'):
        return variant
    own: dict[str, dict[str, Any]] = {'frictions': {}, 'dampers': {}}
    for axis in places.motor_axes(variant):
        for name in ('coulomb_friction', 'viscous_friction'):
            effect = find(name)
            overlay = effect.overlay(variant, axis, effect.typical(variant, axis))
            for section, entries in overlay.machine.items():
                own[section] |= {f'{axis}_identified': one for one in entries.values()}
    return itself(variant.with_overlay(Overlay(own)))


def itself(variant: Variant) -> Variant:
    """Return a variant as a model of its own, that nothing was laid over."""
    return dataclasses.replace(variant, origin=None)


def draw_deviations(variant: Variant, random: np.random.Generator) -> tuple[Deviation, ...]:
    """Return a deviation of every mass, force constant and friction of a model."""
    found = []
    for path in paths(variant):
        sign = -1.0 if random.random() < 0.5 else 1.0
        found.append(Deviation(path, 1.0 + sign * float(random.uniform(SMALLEST, LARGEST))))
    return tuple(found)


def paths(variant: Variant) -> list[str]:
    """Return what is off, as `bodies.NAME`, `rotors.`, `motors.`, `frictions.` or `dampers.NAME`."""
    return [
        f'{section}.{name}'
        for section in ('bodies', 'rotors', 'motors', 'frictions', 'dampers')
        for name, entry in (variant.machine.get(section) or {}).items()
        if entry is not None
    ]


def off(variant: Variant, deviations: tuple[Deviation, ...]) -> Variant:
    """Return the machine with its deviations; raises `UserError` for one that cannot be."""
    changed: dict[str, dict[str, Any]] = {}
    for item in deviations:
        section, name = item.path.split('.', 1)
        changed.setdefault(section, {})[name] = _changed(variant, section, name, item.factor)
    return itself(variant.with_overlay(Overlay(changed)))


def _changed(variant: Variant, section: str, name: str, factor: float) -> dict[str, Any]:
    """Return what differs in an entry of the description whose number is multiplied."""
    description, entry = variant.description, variant.machine[section][name]
    if section == 'bodies':
        body = description.bodies[name]
        inertia = places.tensor_entries(factor * body.inertia)
        return {'mass_kg': factor * body.mass, 'inertia_kg_m2': inertia}
    if section == 'rotors':
        return {'inertia_kg_m2': factor * description.rotors[name].inertia}
    if section == 'frictions' and 'part' in entry:
        return {'factor': factor * float(places.plain(variant, entry.get('factor', 1.0)))}
    if section == 'motors':
        keys: tuple[str, ...] = tuple(key for key in entry if key.startswith('force_n_'))
        keys = keys or tuple(key for key in entry if key.startswith('torque_nm_')) or BACK_EMF
    else:
        keys = RESISTANCES if section == 'frictions' else DAMPINGS
    key = next(key for key in keys if key in entry)
    value = places.plain(variant, entry[key])
    if isinstance(value, list):
        return {key: [factor * float(one) for one in value]}
    return {key: factor * float(value)}


def equivalents(nominal: Variant, true: Variant) -> dict[str, float]:
    """
    Return the values of effects that make the true machine of the nominal model.

    By `effect:axis.parameter`, in the parameter's unit. Inertia is that which moves with an axis at
    home, all else rigid, after the axes that it carries were corrected; weight is what the masses of
    `wrong_inertia` and `counterweight_mass` leave. An axis with dry friction that is not Coulomb's, on
    either machine, has no equivalents of friction.
    """
    nominal, true = itself(nominal), itself(true)
    found: dict[str, float] = {}
    now = nominal

    def correct(name: str, axis: str, value: float) -> Variant:
        effect = find(name)
        parameter = effect.parameters(nominal, axis)[0].name
        found[f'{name}:{axis}.{parameter}'] = value
        overlay = effect.overlay(now, axis, {parameter: value})
        return itself(now.with_overlay(overlay)) if value else now

    for axis in places.counterweight_axes(nominal):
        masses = [_counterweight(one, axis) for one in (nominal, true)]
        now = correct('counterweight_mass', axis, masses[1] - masses[0])
    for axis in reversed(places.jointed_axes(nominal)):
        more = places.moving_inertia(true, axis) - places.moving_inertia(now, axis)
        now = correct('wrong_inertia', axis, more)
    for axis in places.motor_axes(nominal):
        found[f'constant_force:{axis}.force'] = weight(true, axis) - weight(now, axis)
        constants = [force_constant(one.description.motors[axis]) for one in (nominal, true)]
        found[f'force_constant:{axis}.ratio'] = constants[1] / constants[0]
        dry, dry_true = _coulomb(nominal, axis), _coulomb(true, axis)
        if dry is not None and dry_true is not None:
            more = _damping(true, axis) - _damping(nominal, axis)
            found[f'viscous_friction:{axis}.damping'] = more
            found[f'coulomb_friction:{axis}.friction'] = dry_true - dry
    for name in ('encoder_delay', 'motor_encoder_delay'):
        for axis in find(name).axes(nominal):
            cycles = true.description.encoder_delay - nominal.description.encoder_delay
            found[f'{name}:{axis}.delay'] = 1e3 * cycles / Timing().encoder_hz
    return found


def _counterweight(variant: Variant, axis: str) -> float:
    """Return the mass of the counterweight of an axis, kg."""
    driven = places.counterweight_coordinate(variant, axis)
    return next(
        variant.description.bodies[joint.child].mass
        for joint in variant.description.joints.values()
        if any(freedom.name == driven for freedom in joint.freedoms)
    )


def weight(variant: Variant, axis: str) -> float:
    """Return the force (N) or torque (Nm) of gravity along or about an axis at home."""
    assembly = variant.rigid
    _, pull = home_mass_matrix_and_weight(
        list(assembly.links),
        assembly.placing,
        len(assembly.coordinates),
        variant.description.gravity,
    )
    row, ratio = assembly.placing[places.coordinate(variant, axis)]
    return float(pull[row] / ratio)


def _ratio(variant: Variant, axis: str, name: str) -> float:
    """Return the speed of a coordinate per speed of the axis that it moves with, without sign."""
    placing = variant.rigid.placing
    return abs(placing[name][1] / placing[places.coordinate(variant, axis)][1])


def _damping(variant: Variant, axis: str) -> float:
    """Return the viscous friction of all that moves with an axis, felt at the axis."""
    return sum(
        damper.damping * _ratio(variant, axis, damper.coordinate) ** 2
        for damper in variant.description.dampers.values()
        if places.moves_with(variant, axis, damper.coordinate)
    )


def _coulomb(variant: Variant, axis: str) -> float | None:
    """Return the dry friction of all that moves with an axis, felt at it; None if not Coulomb's."""
    whole = 0.0
    for friction in variant.description.frictions.values():
        if not places.moves_with(variant, axis, friction.coordinate):
            continue
        if np.ptp(friction.resistances) > 0.0 or any(friction.law.values()):
            return None
        whole += float(friction.resistances[0]) * _ratio(variant, axis, friction.coordinate)
    return whole
