# SPDX-License-Identifier: Apache-2.0
"""
Effects that make something give, or give more or less than the model says.

An effect acts on a group of connections that are one part of the machine: the bearings of one
guide, one belt. Its parameter is a compliance c = 1 / k, because that is zero where the model
holds a part rigid, and small changes of it do little: k = infinite is no place to begin a fit
from.

- Where no connection of the group gives (rigid, held), c = 0 is neutral; c > 0 makes all of them
  flexible, the first with k = 1 / c and the others in the proportion that the data of their part has.
- Where some give already, c = 1 / k of the first of these is neutral, and all of these change in
  proportion; the others stay as they are.

Stiffness of a connection with a part is changed through the data of the part, as friction and
loads are worked out from the part as well; that of a shaft is given in place of its part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from waferbot_plant.description import Connection, Freedom
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

Group = Callable[[Variant, str], tuple[str, ...]]
"""Names of the connections of a group on an axis; empty where the axis has none."""

_STIFFNESS_OF = {
    'cable': 'elastic_modulus_pa',
    'belt': 'specific_stiffness_n_per_m',
    'gearbox': 'torsional_rigidity_nm_per_arcmin',
}
"""What the stiffness of a part is in proportion to."""

_DAMPING = ('damping_n_s_m', 'damping_nm_s_rad')

_GUIDE_CHARTS = ('radial', 'reverse', 'transverse')


GIVING = tuple(np.geomspace(0.5, 20.0, 8).tolist())
"""
Times its typical value at which a compliance is tried. A little of it says nothing of one that rings,
but one that gives 30 % too much or too little mostly still makes much of what the right one does; much
stiffer ones make lines in a spectrum.
"""


def compliance_effect(name: str, summary: str, group: Group, title: str = '') -> Effect:
    """Return the effect of another compliance of a group of connections."""

    def axes(variant: Variant) -> tuple[str, ...]:
        return tuple(axis for axis in places.jointed_axes(variant) if group(variant, axis))

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        parts = giving(variant, group(variant, axis))
        nominal = 1.0 / parts[0].stiffness
        unit = 'rad/Nm' if parts[0].rotary else 'm/N'
        meaning = f'1 / stiffness of {parts[0].name}'
        most = 20.0 * nominal
        if parts[0].flexible:
            return (
                Parameter(
                    'compliance', unit, nominal, 1.3 * nominal, 0.05 * nominal, most, meaning
                ),
            )
        return (Parameter('compliance', unit, 0.0, nominal, 0.0, most, meaning),)

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        if values['compliance'] == parameters(variant.base, axis)[0].neutral:
            return Overlay()
        parts = giving(variant.base, group(variant.base, axis))
        softer = values['compliance'] * parts[0].stiffness
        return Overlay(with_compliance(variant, parts, softer))

    return Effect(
        name,
        Block.PLANT,
        summary,
        axes,
        parameters,
        overlay,
        equation="F = e / compliance + d e', d = loss factor / (compliance omega_1), (5.4), (5.5)",
        usual=True,
        rings=True,
        tried_at=GIVING,
        title=title,
    )


def giving(variant: Variant, names: tuple[str, ...]) -> tuple[Connection, ...]:
    """Return the connections of a group that give; all of them where none does."""
    parts = tuple(variant.description.connections[name] for name in names)
    return tuple(part for part in parts if part.flexible) or parts


STIFFER = 30.0
"""By how much a part that only has to give way to something else is stiffer than its data say."""

CARRIER_LOSS = 1.0
"""
Loss factor of such a part: half of critical damping. A gear of steel without any loss, thirty times as
stiff, would ring at 500 Hz, and a loop that holds the motor by its own encoder would feed that.
"""


def let_go(variant: Variant, names: tuple[str, ...]) -> dict[str, Any]:
    """
    Return the part of a description that lets connections give, if none of them does.

    They become `STIFFER` than their data say, with `CARRIER_LOSS`: springs to carry a gap or a slip, not
    compliances.
    """
    parts = giving(variant, names)
    if parts[0].flexible:
        return {}
    damped = {}
    for part in parts:
        entry = variant.machine['connections'][part.name]
        gone = {key: None for key in _DAMPING if key in entry}
        damped[part.name] = {**gone, 'loss_factor': CARRIER_LOSS}
    machine = with_compliance(variant, parts, 1.0 / STIFFER)
    return _with_more(machine, damped)


def with_law(
    machine: dict[str, Any], names: tuple[str, ...], law: dict[str, Any]
) -> dict[str, Any]:
    """Return a part of a description with more said of some connections, of each the same."""
    return _with_more(machine, dict.fromkeys(names, law))


def _with_more(machine: dict[str, Any], said: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    connections = dict(machine.get('connections', {}))
    for name, more in said.items():
        connections[name] = {**connections.get(name, {}), **more}
    return {**machine, 'connections': connections}


def with_compliance(
    variant: Variant, parts: tuple[Connection, ...], softer: float
) -> dict[str, Any]:
    """
    Return the part of a description that makes connections flexible, `softer` times as much.

    That is in terms of the model before any effect, and under the loads there: the same whatever other
    effects come before it.
    """
    base = variant.base
    connections: dict[str, Any] = {}
    changed: dict[str, Any] = {}
    for name in (part.name for part in parts):
        part, entry = base.description.connections[name], base.machine['connections'][name]
        present = variant.machine['connections'][name]
        as_before = {
            key: entry.get(key)
            for key in ('loss_factor', *_DAMPING)
            if present.get(key) != entry.get(key)
        }
        connections[name] = {'state': 'flexible', **as_before}
        kind = base.machine['parts'][entry['part']]['kind'] if 'part' in entry else ''
        if kind in ('', 'shaft'):
            key = 'stiffness_nm_rad' if part.rotary else 'stiffness_n_m'
            connections[name][key] = part.stiffness / softer
        else:
            direction = entry.get('direction', '')
            for key, value in softer_part(base, entry['part'], direction, softer).items():
                changed.setdefault(entry['part'], {})[key] = value
        if kind == 'shaft':
            # No metal has a torsion and a bending stiffness that follow each other at will.
            gone = {key: None for key in ('part', 'direction') if key in present}
            own = (part.loss_factor or 0.0) / float(entry.get('damping_factor', 1.0))
            connections[name] |= {**gone, 'loss_factor': own}
    found: dict[str, Any] = {'connections': connections}
    return {**found, 'parts': changed} if changed else found


def softer_part(variant: Variant, name: str, direction: str, softer: float) -> dict[str, Any]:
    """Return the data of a part, in one direction of it, with `softer` times the compliance."""
    part = variant.machine['parts'][name]
    kind = part['kind']
    if kind == 'linear_bearing':
        charts = {chart: ('deflection_um', part[chart]) for chart in _GUIDE_CHARTS}
    elif kind == 'cross_roller_bearing' and direction.startswith('radial'):
        charts = {'radial': ('deflection_um', part['radial'])}
    elif kind == 'cross_roller_bearing':
        charts = {'moment': ('tilt_urad', part['moment'])}
    else:
        key = _STIFFNESS_OF[kind]
        return {key: places.plain(variant, part[key]) / softer}
    return {
        chart: {key: [value * softer for value in places.plain(variant, data[key])]}
        for chart, (key, data) in charts.items()
    }


def stage(*kinds: str) -> Group:
    """Return the group of the connections in stages of these kinds, in what the axis is driven by."""

    def group(variant: Variant, axis: str) -> tuple[str, ...]:
        return tuple(
            part.connection
            for transmission in variant.description.transmissions.values()
            for part in transmission.stages
            if part.kind in kinds
            and part.connection is not None
            and places.moves_with(variant, axis, transmission.driven)
        )

    return group


def belt_force(variant: Variant, axis: str) -> float:
    """Return the force in the belt of a drive when the axis speeds up as programmed, N."""
    holding, moving = places.usual_currents(variant, axis)
    torque = (moving - holding) * places.force_per_ampere(variant, axis)
    return next(
        torque / part.lever
        for transmission in variant.description.transmissions.values()
        if places.moves_with(variant, axis, transmission.driven)
        for part in transmission.stages
        if part.kind == 'belt'
    )


def tilting_guide(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what holds the angles in the guide of a linear axis."""
    if places.rotary(variant, axis):
        return ()
    return _holding(variant, axis, lambda freedom: freedom.revolute, lambda kind: True)


def tilting_bearing(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what holds the angles in the bearing of a rotary axis."""
    if not places.rotary(variant, axis):
        return ()
    return _holding(variant, axis, lambda freedom: freedom.revolute, lambda kind: True)


def shifting_bearing(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what holds the shifts in the bearing of a rotary axis, without its shaft."""
    if not places.rotary(variant, axis):
        return ()
    return _holding(
        variant, axis, lambda freedom: not freedom.revolute, lambda kind: kind != 'shaft'
    )


def bending_shaft(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what bends in the shaft of a rotary axis."""
    if not places.rotary(variant, axis):
        return ()
    return _holding(
        variant, axis, lambda freedom: not freedom.revolute, lambda kind: kind == 'shaft'
    )


def twisting_shaft(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what twists about a rotary axis, beyond its bearing."""
    if not places.rotary(variant, axis):
        return ()
    about = places.direction_of(variant, axis)
    own = places.joint_of(variant, axis)
    carried = places.carried_bodies(variant, axis)
    return tuple(
        name
        for joint in variant.description.joints.values()
        if joint is not own and joint.child in carried
        for freedom in joint.freedoms
        if freedom.revolute and abs(freedom.axis @ about) > 0.999
        for name in freedom.connections
    )


def tilting_counterweight(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return what holds the angles in the guides of what a cable from the axis drives."""
    driven = {
        transmission.driven
        for transmission in variant.description.transmissions.values()
        if transmission.pulls_only and places.moves_with(variant, axis, transmission.driving)
    }
    return tuple(
        name
        for joint in variant.description.joints.values()
        if any(freedom.name in driven for freedom in joint.freedoms)
        for freedom in joint.freedoms
        if freedom.revolute
        for name in freedom.connections
    )


def _holding(
    variant: Variant,
    axis: str,
    freedom_counts: Callable[[Freedom], bool],
    kind_counts: Callable[[str], bool],
) -> tuple[str, ...]:
    """Return the connections that hold the other freedoms in the joint of an axis."""
    joint = places.joint_of(variant, axis)
    assert joint is not None
    entries = variant.machine.get('connections', {})
    parts = variant.machine.get('parts', {})
    return tuple(
        name
        for freedom in joint.freedoms
        if freedom_counts(freedom)
        for name in freedom.connections
        if kind_counts(parts[entries[name]['part']]['kind'] if 'part' in entries[name] else '')
    )
