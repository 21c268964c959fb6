# SPDX-License-Identifier: Apache-2.0
"""
Which effects of the library tell two models apart: the truth where nobody has hidden one.

An effect of the nominal model is **in the list of what differs** if what it changes there is different
on the real machine:

- a connection that is rigid in the nominal model, and gives on the real one, in no other way (no gap);
- a mass, an inertia or a centre of gravity, a motor's constant, a setting: the same entry differs; mass
  and inertia are those that move with the axis;
- friction: the resistance that the real machine has more on that coordinate, as a curve over speed, does
  what the effect's own curve does: it has a value at rest, rises, falls;
- damping: the real machine has more of it on that coordinate, or its friction rises with speed;
- a delay of readings: the real machine's is longer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from diagnosis_matrix.deviations import itself
from waferbot_copley.settings import settings_of as amplifier_settings
from waferbot_pmac.i_variables import axis_parameters as controller_settings
from waferbot_twin.effects import library, places
from waferbot_twin.effects.effect import Effect
from waferbot_twin.effects.variant import Overlay, Variant

CURVE = ('coordinate', 'speed_m_s', 'speed_rad_s', 'force_n', 'torque_nm')
"""Keys of a friction that is a curve over speed and nothing else."""

SPEEDS = np.concatenate(([0.0], np.geomspace(1e-3, 10.0, 40)))
"""Speeds at which curves are compared, m/s or rad/s."""

SMALL = 1e-6
"""Relative difference below which two numbers of a model are the same."""


def same_names(variant: Variant) -> dict[str, str]:
    """Return `effect:axis` of effects that do exactly what another one does in a model, and which."""
    return {
        f'{name}:{axis}': f'{effect.same_as[0]}:{axis}'
        for name, effect in library().items()
        if len(effect.same_as) == 1
        for axis in effect.axes(variant)
        if axis not in effect.distinct_axes(variant)
    }


def differing(nominal: Variant, real: Variant) -> list[str]:
    """Return `effect:axis` of every effect that is in the list of what differs between two models."""
    nominal, real = itself(nominal), itself(real)
    return [
        f'{name}:{axis}'
        for name, effect in library().items()
        for axis in effect.axes(nominal)
        if _differs(effect, axis, nominal, real)
    ]


def _differs(effect: Effect, axis: str, nominal: Variant, real: Variant) -> bool:
    if effect.name == 'wrong_inertia':
        return _unlike(places.moving_inertia(nominal, axis), places.moving_inertia(real, axis))
    overlay = effect.overlay(nominal, axis, effect.typical(nominal, axis))
    settings = [*_of_settings(overlay.pmac), *_of_settings(overlay.copley)]
    if settings:
        return all(_setting_differs(nominal, real, *item) for item in settings)
    if 'delay_s' in str(overlay.machine) and 'encoders' in overlay.machine:
        return real.description.encoder_delay > nominal.description.encoder_delay
    return _machine_differs(overlay, nominal, real)


def _machine_differs(overlay: Overlay, nominal: Variant, real: Variant) -> bool:
    """Return whether all that an overlay changes of a machine differs on the real one."""
    machine = overlay.machine
    if 'connections' in machine:
        # The part's data are those of a connection that gives: what is new is that it does.
        return all(
            not nominal.description.connections[name].flexible
            and _has(real.machine['connections'][name], entry)
            for name, entry in machine['connections'].items()
        ) and machine.keys() <= {'connections', 'parts'}
    if 'frictions' in machine:
        return all(_friction_differs(one, nominal, real) for one in machine['frictions'].values())
    if 'dampers' in machine:
        return all(
            _damping(real, one['coordinate']) > _damping(nominal, one['coordinate'])
            or _shape(_more(nominal, real, one['coordinate']))[1]
            for one in machine['dampers'].values()
        )
    leaves = list(_leaves(machine))
    both = [(_at(nominal, path), _at(real, path)) for path, _ in leaves]
    return bool(both) and all(
        None not in pair and _unlike(places.plain(nominal, pair[0]), places.plain(real, pair[1]))
        for pair in both
    )


def _of_settings(overlay: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    for axis, settings in overlay.items():
        for name in settings:
            yield axis, name


def _setting_differs(nominal: Variant, real: Variant, axis: str, name: str) -> bool:
    """Return whether a setting of the controller or the amplifier is another one on the machine."""

    def value(variant: Variant) -> float:
        if name in {item.name for item in amplifier_settings(axis)}:
            return variant.amplifier_setting(axis, name)
        declared = next(item for item in controller_settings(axis) if item.name == name)
        return float(variant.pmac.get(axis, {}).get(name, declared.default))

    return value(nominal) != value(real)


def _has(entry: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Return whether a connection has all that makes an effect: a gap, a limit, a spring of its own."""
    return all(
        key in entry and (key != 'state' or entry[key] == value)
        for key, value in wanted.items()
        if key != 'loss_factor'
        and not (key.startswith('stiffness') or key in ('part', 'direction'))
    )


def _friction_differs(entry: Mapping[str, Any], nominal: Variant, real: Variant) -> bool:
    """Return whether the real machine has more friction of the kind of a friction's entry."""
    if not entry.keys() <= set(CURVE):
        return False
    speeds = entry.get('speed_m_s', entry.get('speed_rad_s'))
    own = np.interp(SPEEDS, speeds, entry.get('force_n', entry.get('torque_nm')))
    wanted = _shape(own)
    there = _shape(_more(nominal, real, entry['coordinate']))
    return any(wanted) and all(has for has, want in zip(there, wanted, strict=True) if want)


def _shape(curve: np.ndarray) -> tuple[bool, bool, bool]:
    """Return whether a curve over speed has a value at rest, rises, falls."""
    smallest = SMALL * max(float(np.abs(curve).max()), 1e-12)
    steps = np.diff(curve)
    return bool(curve[0] > smallest), bool(steps.max() > smallest), bool(steps.min() < -smallest)


def _more(nominal: Variant, real: Variant, coordinate: str) -> np.ndarray:
    """Return the resistance at `SPEEDS` that the real machine has more on a coordinate."""
    return _resistance(real, coordinate) - _resistance(nominal, coordinate)


def _resistance(variant: Variant, coordinate: str) -> np.ndarray:
    curve = np.zeros_like(SPEEDS)
    for friction in variant.description.frictions.values():
        if friction.coordinate == coordinate:
            curve += np.interp(SPEEDS, friction.speeds, friction.resistances)
    return curve


def _damping(variant: Variant, coordinate: str) -> float:
    """Return the damping that a description itself has on a coordinate, N s/m or Nm s/rad."""
    dampers = variant.description.dampers
    return sum(
        dampers[name].damping
        for name in (variant.machine.get('dampers') or {})
        if name in dampers and dampers[name].coordinate == coordinate
    )


def _leaves(data: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _leaves(value, (*path, key))
    else:
        yield path, data


def _at(variant: Variant, path: tuple[str, ...]) -> Any:
    """Return the plain value at a path of a description; None if there is none."""
    value: Any = variant.machine
    for key in path:
        value = places.plain(variant, value)
        if not isinstance(value, Mapping) or key not in value:
            return None
        value = value[key]
    return value


def _unlike(one: Any, other: Any) -> bool:
    """Return whether two numbers, or any two numbers of two lists, differ."""
    pairs = zip(np.atleast_1d(one).ravel(), np.atleast_1d(other).ravel(), strict=True)
    return any(not math.isclose(a, b, rel_tol=SMALL, abs_tol=1e-15) for a, b in pairs)
