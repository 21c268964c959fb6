# SPDX-License-Identifier: Apache-2.0
"""
Nuisance parameters: what every machine, and every log, has a little different from its model.

Masses, inertias, force constants and frictions are never exactly those of the data sheets, and what a
drive does between two samples of a log is not in it. What is off in a machine is a dense effect beside
the sparse causes, what is off in logs another one: the one says nothing of the other (X. Zhou,
P. Carbonetto, M. Stephens, PLoS Genetics 9, 2013: sparse effects and many small ones), each number with
the prior

    p = p_0 + c x,    x / s ~ Student's t, all together, |x| <= 3 s,    s its usual spread,        (1)

a part of every fit (`residuals.prior_block`, equation (2)). c is p_0 for what a data sheet has. The
damping of what gives is in no data sheet: it is known to a factor, p = p_0 exp(x), and is free where
something gives. For the time of a drive between its samples (`residuals.drive_path`) p_0 is 0, c 1 s, s
what the log leaves open (`Record.skew_spread_s`), and |x| half a step at most. A dense effect competes
with the causes as a whole: where one thing alone is wrong, that is far more probable than many which
happen to look like it; where all are a little off, no one of them is a cause. A parameter becomes a
cause, beside the dense effects, only where it is further off than (1) has it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_plant.description_drives import FORCE_KEYS
from waferbot_plant.motors import force_constant
from waferbot_twin.diagnosis.corrections import Correction, corrected
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    is_nothing,
    parameters_of,
    standard_errors,
)
from waferbot_twin.estimation.intervals import Rival, averaged
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record

NAME = 'nuisance_parameters'
NAME_OF_DAMPINGS = 'nuisance_dampings'
NAME_OF_LOGS = 'nuisance_times'

DAMPING = 'damping_factor'
"""Key of the damping of a connection, as a factor."""

LOGS = 'logs'
"""Section of what is off in logs, and not in the machine's description."""

SPREADS = 3.0
"""How far a parameter may be off, in its usual spread: what is further off has a cause."""


@dataclass(frozen=True)
class Number:
    """
    One number of a description: section, name and key where it stands, and its usual spread.

    `words` and `unit` are for the report; `value` is what the model has there. `also` are further names
    in the section with the same number: a part that several connections are of. One with the `key`
    `DAMPING` is the factor of what the model has, and its spread that of the logarithm.
    """

    section: str
    name: str
    key: str
    spread: float
    words: str
    unit: str
    value: float
    also: tuple[str, ...] = ()

    @property
    def is_damping(self) -> bool:
        """Whether it is the damping of what gives, known to a factor."""
        return self.key == DAMPING

    @property
    def per_x(self) -> float:
        """The c of equation (1)."""
        return self.value or 1.0

    @property
    def room(self) -> tuple[float, float]:
        """How far x can go down and up; between two samples of a log there is half a step either way."""
        most = math.sqrt(3.0) if self.section == LOGS else SPREADS
        return -most * self.spread, most * self.spread

    @property
    def path(self) -> str:
        """The place in the description as one word."""
        return f'{self.section}.{self.name}.{self.key}'


def numbers(variant: Variant, records: Sequence[Record], settings: Settings) -> list[Number]:
    """Return every number of a machine and its logs that is usually a little off."""
    return [
        *_of_bodies(variant, settings),
        *_of_motors(variant, settings),
        *_of_frictions(variant, settings),
        *_of_connections(variant, settings),
        *_of_logs(records),
    ]


def _of_bodies(variant: Variant, settings: Settings) -> list[Number]:
    found = []
    spread = settings.spread_of_masses
    for name, body in variant.description.bodies.items():
        words = name.replace('_', ' ')
        found.append(
            Number('bodies', name, 'mass_kg', spread, f'mass of {words}', 'kg', body.mass)
        )
        largest = float(np.max(np.diag(body.inertia)))
        if largest > 0.0:
            found.append(
                Number(
                    'bodies', name, 'inertia_kg_m2', spread, f'inertia of {words}', 'kg m2', largest
                )
            )  # fmt: skip
    for name, entry in (variant.machine.get('rotors') or {}).items():
        value = float(places.plain(variant, entry['inertia_kg_m2']))
        words = f'inertia of {name.replace("_", " ")}'
        found.append(Number('rotors', name, 'inertia_kg_m2', spread, words, 'kg m2', value))
    return found


def _of_motors(variant: Variant, settings: Settings) -> list[Number]:
    found = []
    for axis in places.motor_axes(variant):
        if axis in variant.base.force_driven:
            continue
        motor = variant.description.motors[axis]
        turns = places.motor_rotary(variant, axis)
        key = f'back_emf_lead_to_lead_v_s_{"rad" if turns else "m"}'
        if motor.by_force:
            key = FORCE_KEYS[turns]
        found.append(
            Number(
                'motors', axis, key, settings.spread_of_force_constants,
                f'{"torque" if turns else "force"} constant of {axis}',
                'Nm/A' if turns else 'N/A', force_constant(motor),
            )
        )  # fmt: skip
    return found


def _of_frictions(variant: Variant, settings: Settings) -> list[Number]:
    found = []
    for name, entry in (variant.machine.get('frictions') or {}).items():
        if entry is None:
            continue
        words = f'friction of {name.replace("_", " ")}'
        value = float(places.plain(variant, entry.get('factor', 1.0)))
        found.append(
            Number('frictions', name, 'factor', settings.spread_of_frictions, words, '', value)
        )
    for name, entry in (variant.machine.get('dampers') or {}).items():
        key = next((one for one in entry if one.startswith('damping_')), None)
        if key is None:
            continue
        value = float(places.plain(variant, entry[key]))
        if value > 0.0:
            unit = 'N s/m' if key.endswith('n_s_m') else 'Nm s/rad'
            words = f'viscous friction of {name.replace("_", " ")}'
            found.append(
                Number('dampers', name, key, settings.spread_of_frictions, words, unit, value)
            )
    return found


def _of_connections(variant: Variant, settings: Settings) -> list[Number]:
    """Return the damping of every part that gives or may give; one of several connections once."""
    found = []
    for part, (name, *others) in _connections_of_parts(variant).items():
        connection = variant.description.connections[name]
        if (connection.damping or connection.loss_factor or 0.0) <= 0.0:
            continue
        # As the description has it: what a library keeps of it can be written there.
        value = float(variant.machine['connections'][name].get(DAMPING, 1.0))
        words = f'damping factor of {part.replace("_", " ")}'
        spread = settings.spread_of_dampings
        found.append(Number('connections', name, DAMPING, spread, words, '', value, tuple(others)))
    return found


def _connections_of_parts(variant: Variant) -> dict[str, list[str]]:
    """Return the connections of every part by its name; of one without a part, itself by its own."""
    entries = variant.machine.get('connections') or {}
    found: dict[str, list[str]] = {}
    for name in variant.description.connections:
        found.setdefault(entries[name].get('part', name), []).append(name)
    return found


def _of_logs(records: Sequence[Record]) -> list[Number]:
    """Return the time of the drive of every axis, the same in all logs, as far as they leave it open."""
    axes = records[0].layout.axes if records else ()
    spreads = np.zeros(len(axes))
    for record in records:
        spreads = np.maximum(spreads, record.skew_spread_s)
    return [
        Number(LOGS, axis, 'skew_s', spread, f'time of the drive of {axis} in the logs', 's', 0.0)
        for axis, spread in zip(axes, spreads.tolist(), strict=True)
        if spread > 0.0
    ]


def nuisance(
    variant: Variant, records: Sequence[Record], settings: Settings
) -> tuple[list[Effect], list[Number]]:
    """Return the dense effects of a machine and of its logs, and their numbers."""
    known = numbers(variant.base, records, settings)
    return [_dense(group) for group in _groups(known)], known


def prior_groups(known: Sequence[Number]) -> list[list[str]]:
    """Return the paths of numbers, those of one dense effect together (`Problem.with_prior`)."""
    return [[item.path for item in group] for group in _groups(known)]


def _groups(known: Sequence[Number]) -> list[list[Number]]:
    """Return the numbers of a machine, its dampings, and those of logs: none without any."""
    by_name: dict[str, list[Number]] = {NAME: [], NAME_OF_DAMPINGS: [], NAME_OF_LOGS: []}
    for item in known:
        by_name[_effect_of(item)].append(item)
    return [group for group in by_name.values() if group]


def _effect_of(item: Number) -> str:
    """Return the name of the dense effect that a number is of."""
    if item.section == LOGS:
        return NAME_OF_LOGS
    return NAME_OF_DAMPINGS if item.is_damping else NAME


_SUMMARIES = {
    NAME: 'parameters a little different from the model',
    NAME_OF_DAMPINGS: 'damping of what gives different from the model',
    NAME_OF_LOGS: 'times a little different from the model',
}


def _dense(known: Sequence[Number]) -> Effect:
    """Return some numbers as one effect, on the first axis of a machine with a motor."""
    name = _effect_of(known[0])

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(item.path, '', 0.0, item.spread, *item.room, item.words, spread=item.spread)
            for item in known
        )

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        machine: dict[str, dict[str, dict[str, Any]]] = {}
        between_s: dict[str, float] = {}
        for item in known:
            value = values[item.path]
            if item.section == LOGS:
                between_s[item.name] = value
                continue
            ratio = math.exp(value) if item.is_damping else 1.0 + value
            for place in (item.name, *item.also):
                entry = machine.setdefault(item.section, {}).setdefault(place, {})
                entry[item.key] = _scaled(variant, replace(item, name=place), ratio)
        deviations = {item.path: values[item.path] / item.spread for item in known}
        return Overlay(machine, deviations=deviations, between_s=between_s)

    return Effect(
        name,
        Block.PLANT,
        _SUMMARIES[name],
        lambda variant: places.motor_axes(variant)[:1],
        parameters,
        overlay,
    )


def _scaled(variant: Variant, item: Number, ratio: float) -> Any:
    """Return what stands at a number's place, times a ratio."""
    if item.section == 'bodies' and item.key == 'inertia_kg_m2':
        return places.tensor_entries(variant.description.bodies[item.name].inertia * ratio)
    return ratio * _number_at(variant, item.path)


def _number_at(variant: Variant, path: str) -> float:
    """Return what a variant has at the path of a number; of an inertia the largest moment."""
    section, rest = path.split('.', 1)
    name, key = rest.rsplit('.', 1)
    if section == 'bodies' and key == 'inertia_kg_m2':
        return float(np.max(np.diag(variant.description.bodies[name].inertia)))
    return float(places.plain(variant, variant.machine[section][name].get(key, 1.0)))


def is_nuisance(cause: Cause) -> bool:
    """Return whether a cause is a dense effect."""
    return cause.effect.name in _SUMMARIES


def is_damping(cause: Cause) -> bool:
    """Return whether a cause is the dense effect of what damps the parts that give."""
    return cause.effect.name == NAME_OF_DAMPINGS


def each_once(problem: Problem, causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """
    Return causes; what any of them changes does not deviate in the dense effect as well.

    No log could tell the two apart: such parameters are held where the model has them, and so is the
    damping of what does not give.
    """
    changed: set[tuple[str, str]] = set()
    for cause in causes:
        if not is_nuisance(cause) and not is_nothing(problem, cause):
            changed |= _entries(problem.nominal) ^ _entries(
                cause.effect.apply(problem.nominal, cause.axis, cause.values)
            )
    paths = {path for path, _ in changed}
    if any(is_nuisance(cause) for cause in causes):
        paths |= _dampings_of_rigid(problem.nominal, causes)

    def once(dense: Cause) -> Cause:
        held = tuple(name for name in dense.values if name in paths)
        return replace(dense, held=held).with_values(dict.fromkeys(held, 0.0))

    return tuple(once(cause) if is_nuisance(cause) else cause for cause in causes)


def _off(nominal: Variant, machine: Variant, item: Number) -> float:
    """Return the x of equation (1) of a number, whatever in a machine is the cause of it."""
    if item.section == LOGS:
        return machine.between_s.get(item.name, 0.0)
    before, after = (_number_at(one, item.path) for one in (nominal, machine))
    return math.log(after / before) if item.is_damping else (after - before) / (before or 1.0)


def in_place_of_bounds(
    problem: Problem, causes: Sequence[Cause], candidates: Sequence[Cause]
) -> list[tuple[Cause, ...]]:
    """
    Return causes with each candidate in place of a parameter that is as far off as (1) has any.

    What is further off has a cause: one that changes the same number, here at the value with which it
    says the same of that. From there a fit can follow it, and what made up for it, along which the logs
    tell nothing.
    """
    nominal, there = problem.nominal, {cause.name for cause in causes}
    on_bounds = {
        item.name: cause.values[item.name]
        for cause in causes
        if is_nuisance(cause)
        for item in parameters_of(problem, cause)
        if cause.values[item.name] in (item.low, item.high) and not item.name.startswith(LOGS)
    }
    found = []
    for rival in candidates if on_bounds else ():
        for item in parameters_of(problem, rival) if rival.name not in there else ():
            if item.shape:
                continue
            none = {one.name: one.neutral for one in parameters_of(problem, rival)}
            full = rival.with_values({**none, item.name: item.typical})
            try:
                changed = apply_all(nominal, [full])
                both = {
                    path: [_number_at(one, path) for one in (nominal, changed)]
                    for path in on_bounds
                }
            except UserError:  # there is no machine with so much of it
                continue
            for path, (before, after) in both.items():
                if before == after:
                    continue
                share = before * on_bounds[path] / (after - before)
                value = item.neutral + share * (item.typical - item.neutral)
                named = full.with_values({item.name: min(max(value, item.low), item.high)})
                found.append(each_once(problem, (*causes, named)))
    return found


def _dampings_of_rigid(nominal: Variant, causes: Sequence[Cause]) -> set[str]:
    """
    Return the paths of the dampings which have no effect beside causes, as nothing gives there.

    None where there is no such machine: that is for whoever simulates it to say.
    """
    try:
        connections = apply_all(nominal, causes).description.connections
    except UserError:
        return set()
    return {
        f'connections.{names[0]}.{DAMPING}'
        for names in _connections_of_parts(nominal.base).values()
        if not any(connections[name].flexible for name in names)
    }


def _entries(variant: Variant) -> set[tuple[str, str]]:
    """Return every entry of a description by its path, and what stands there."""
    return {
        (f'{section}.{name}.{key}', repr(value))
        for section, names in variant.machine.items()
        if isinstance(names, Mapping)
        for name, entry in names.items()
        if isinstance(entry, Mapping)
        for key, value in entry.items()
    }


def corrections(
    problem: Problem, found: Hypothesis, known: list[Number], rivals: Sequence[Rival] = ()
) -> list[Correction]:
    """
    Return the corrected parameters of a hypothesis, those that are furthest off first.

    Intervals are averages over the other models, `rivals`, where they are known no better than here.
    """
    errors = standard_errors(found)
    machines = [(apply_all(problem.nominal, one.found.causes), one.log_odds) for one in rivals]
    first, rows = 0, []
    for cause in found.causes:
        own = errors[first : first + cause.free]
        first += cause.free
        if not is_nuisance(cause):
            continue
        by_path = {item.path: item for item in known}
        for parameter, error in zip(parameters_of(problem, cause), own, strict=False):
            item, value = by_path[parameter.name], cause.values[parameter.name]
            others = [
                (_off(problem.nominal, machine, item), float(error), log_odds)
                for machine, log_odds in machines
            ]
            ends = averaged(value, float(error), others)
            found_there, low, high = (
                corrected(item.value, x, item.is_damping) for x in (value, *ends)
            )
            correction = Correction(
                item.words,
                item.path,
                item.unit,
                item.value,
                found_there,
                low,
                high,
                item.is_damping,
            )
            rows.append((abs(value) / item.spread, correction))
    return [row for _, row in sorted(rows, key=lambda pair: -pair[0])]
