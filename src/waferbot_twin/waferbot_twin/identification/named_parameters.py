# SPDX-License-Identifier: Apache-2.0
"""
A parameter of a model by its name, made into something that a fit can move.

Names are paths: into the machine's description (`bodies.carriage.mass_kg`, `motors.x_rotate.
back_emf_lead_to_lead_v_s_rad`, `bodies.carriage.centre_of_gravity_m[0]`), to a setting of the controller
(`pmac.y_linear.Ixx30`) or of an amplifier (`copley.y_linear.motor_resistance`). The stiffness of a
connection, `connections.cable.stiffness_n_m`, can be named also where it follows from the data of its
part; these are then changed in proportion, and a connection that the model holds rigid gives.

A fit moves a **scaled** value x, zero where it starts, so that one unit of every parameter means about
the same. With v the value and v0 that of the model,

    x = ln(v / v0)                  where the range lies on one side of zero: 0.01 is 1 %,
    x = (v - v0) / half the range   otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from waferbot_copley.settings import settings_of as amplifier_settings
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.marked_yaml import Key
from waferbot_lockstep.parameters import Parameter as Setting
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant.parameters_page import unit_of
from waferbot_pmac.i_variables import axis_parameters as controller_settings
from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import with_compliance
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.residuals.problem import Cause

USUAL_RANGE = 10.0
"""Where no range is given, a value may become this many times larger or smaller."""

SETTINGS: dict[str, Callable[[str, Layout], tuple[Setting, ...]]] = {
    'pmac': controller_settings,
    'copley': amplifier_settings,
}
"""The first word of a path that leads to a setting, and what declares it."""

STIFFNESSES = ('stiffness_n_m', 'stiffness_nm_rad')

SCALED = 'scaled'
MODEL = 'model'
"""The only parameter, and the only place, of the effect that a named parameter is made into."""


@dataclass(frozen=True)
class NamedParameter:
    """
    A parameter that is to be identified.

    `start` is its value in the model, between `low` and `high`, all in `unit`; `whole` tells whether the
    device holds whole numbers; `overlay(variant, value)` sets it.
    """

    path: str
    unit: str
    start: float
    low: float
    high: float
    whole: bool
    overlay: Callable[[Variant, float], Overlay]

    @property
    def logarithmic(self) -> bool:
        """Whether the scaled value is a logarithm."""
        return self.low * self.high > 0.0

    @property
    def scaled_range(self) -> tuple[float, float]:
        """The bounds, scaled, the lower one first."""
        low, high = sorted((self.scaled(self.low), self.scaled(self.high)))
        return low, high

    @property
    def half_range(self) -> float:
        """Half the distance between the bounds, scaled."""
        low, high = self.scaled_range
        return 0.5 * (high - low)

    def scaled(self, value: float) -> float:
        """Return the scaled value."""
        if self.logarithmic:
            return math.log(value / self.start)
        return (value - self.start) / (0.5 * (self.high - self.low))

    def value(self, scaled: float) -> float:
        """Return the value in its unit, a whole number where the device holds one."""
        if self.logarithmic:
            value = self.start * math.exp(scaled)
        else:
            value = self.start + scaled * 0.5 * (self.high - self.low)
        value = min(max(value, self.low), self.high)
        return float(round(value)) if self.whole else value

    @property
    def resolution(self) -> float:
        """Smallest change of the scaled value that makes any difference; 0 if it is continuous."""
        if not self.whole:
            return 0.0
        return abs(self.scaled(self.start + (1.0 if self.start < self.high else -1.0)))

    def cause(self, scaled: float) -> Cause:
        """Return the parameter at a scaled value as a cause that the diagnosis' machinery takes."""
        parameter = Parameter(
            SCALED, '', 0.0, 0.1 * self.half_range, *self.scaled_range, self.path, False,
            self.resolution,
        )  # fmt: skip
        effect = Effect(
            self.path,
            Block.PLANT,
            'a parameter by its name',
            lambda variant: (MODEL,),
            lambda variant, axis: (parameter,),
            lambda variant, axis, values: self.overlay(variant, self.value(values[SCALED])),
        )
        low, high = self.scaled_range
        return Cause(effect, MODEL, {SCALED: min(max(scaled, low), high)})


def parse(text: str, variant: Variant) -> NamedParameter:
    """
    Return the parameter that `PATH` or `PATH=low:high` names.

    Raises `UserError` for a path that leads nowhere or to no number, and for a range that is none or
    does not hold the model's value.
    """
    path, equals, limits = text.partition('=')
    path = path.strip()
    found = at_path(path, variant)
    if equals:
        return _between(found, text, limits)
    if found.start == 0.0:
        raise UserError(f'{path} is 0 in the model; say between what it may lie: {path}=low:high')
    usual = sorted((found.start / USUAL_RANGE, found.start * USUAL_RANGE))
    return _with_range(found, max(found.low, usual[0]), min(found.high, usual[1]))


def at_path(path: str, variant: Variant) -> NamedParameter:
    """Return the parameter of a path, with all values that it can have; raises `UserError`."""
    return _setting(path, variant) if path.split('.')[0] in SETTINGS else _quantity(path, variant)


def parse_all(texts: Sequence[str], variant: Variant) -> tuple[NamedParameter, ...]:
    """Return all named parameters; raises `UserError`, also for one that is named twice."""
    found: dict[str, NamedParameter] = {}
    for text in texts:
        one = parse(text, variant)
        if one.path in found:
            raise UserError(f'--parameter {one.path} is given twice')
        found[one.path] = one
    return tuple(found.values())


def _with_range(found: NamedParameter, low: float, high: float) -> NamedParameter:
    return NamedParameter(
        found.path, found.unit, found.start, low, high, found.whole, found.overlay
    )


def _between(found: NamedParameter, text: str, limits: str) -> NamedParameter:
    """Return the parameter with the range that the user gave."""
    try:
        low, high = (float(limit) for limit in limits.split(':'))
    except ValueError:
        raise UserError(f'--parameter {text}: the range is {limits!r}; give low:high') from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UserError(f'--parameter {text}: {low:g} must be less than {high:g}')
    if not low <= found.start <= high:
        raise UserError(
            f'--parameter {text}: the model has {found.start:g} {found.unit}, out of this range'
        )
    if low < found.low or high > found.high:
        raise UserError(
            f'--parameter {text}: {found.path} can be {found.low:g} to {found.high:g} {found.unit}'
        )
    return _with_range(found, low, high)


def _setting(path: str, variant: Variant) -> NamedParameter:
    """Return a setting of the controller or of an amplifier: `pmac.AXIS.NAME`, `copley.AXIS.NAME`."""
    device, *rest = path.split('.')
    if len(rest) != 2:
        raise UserError(f'{path}: a setting is named {device}.AXIS.NAME')
    axis, name = rest
    layout = variant.layout
    if axis not in layout.axes:
        raise UserError(f'{path}: no axis {axis!r}{did_you_mean(axis, layout.axes)}')
    known = {setting.name: setting for setting in SETTINGS[device](axis, layout)}
    if name not in known:
        raise UserError(f'{path}: no setting {name!r}{did_you_mean(name, known)}')
    own = (variant.pmac if device == 'pmac' else variant.copley).get(axis, {})
    setting = known[name]

    def overlay(variant: Variant, value: float) -> Overlay:
        held = {axis: {name: int(value) if setting.integer else value}}
        return Overlay(pmac=held) if device == 'pmac' else Overlay(copley=held)

    start = float(own.get(name, setting.default))
    return NamedParameter(
        path, setting.unit, start, setting.low, setting.high, setting.integer, overlay
    )


def _quantity(path: str, variant: Variant) -> NamedParameter:
    """Return a quantity of the description."""
    key = _key(path)
    if len(key) == 3 and key[0] == 'connections' and key[2] in STIFFNESSES:
        return _stiffness(path, key, variant)
    start = _number_at(path, key, variant)
    words = [part for part in key if isinstance(part, str)]
    unit = next((unit_of(word) for word in reversed(words) if unit_of(word)), '')

    def overlay(variant: Variant, value: float) -> Overlay:
        return Overlay(_changed(variant, variant.machine, key, value))

    return NamedParameter(path, unit, start, -math.inf, math.inf, False, overlay)


def _stiffness(path: str, key: Key, variant: Variant) -> NamedParameter:
    """Return the stiffness of a connection, wherever it comes from."""
    connections = variant.description.connections
    if key[1] not in connections:
        raise UserError(f'{path}: no connection {key[1]!r}{did_you_mean(key[1], connections)}')
    part = connections[key[1]]
    wanted = STIFFNESSES[part.rotary]
    if key[2] != wanted:
        raise UserError(f'{path}: its unit is that of connections.{key[1]}.{wanted}')

    def overlay(variant: Variant, value: float) -> Overlay:
        return Overlay(with_compliance(variant, (part,), part.stiffness / value))

    return NamedParameter(
        path, unit_of(wanted), part.stiffness, 0.0, math.inf, False, overlay
    )  # fmt: skip


def _key(path: str) -> Key:
    """Return `bodies.arm.centre_of_gravity_m[0]` as a key of a document."""
    key: list[Any] = []
    for word in path.split('.'):
        match = re.fullmatch(r'([^\[\]]+)((?:\[\d+\])*)', word)
        if match is None:
            raise UserError(f'{path}: {word!r} is neither a name nor name[place]')
        key += [match[1], *(int(place) for place in re.findall(r'\d+', match[2]))]
    return tuple(key)


def _number_at(path: str, key: Key, variant: Variant) -> float:
    """Return the number that a key of the description leads to; raises `UserError`."""
    node: Any = variant.machine
    for place, part in enumerate(key):
        node = places.plain(variant, node)
        where = f'{path}: ' + ('.'.join(map(str, key[:place])) or 'the model')
        if isinstance(node, Mapping) and isinstance(part, str):
            if part not in node:
                known = [*node, *SETTINGS] if place == 0 else list(node)
                raise UserError(
                    f'{where} has no {part!r}{did_you_mean(part, map(str, known))} '
                    f'(there: {", ".join(map(str, known))})'
                )
        elif isinstance(node, list) and isinstance(part, int):
            if part >= len(node):
                raise UserError(f'{where} has {len(node)} values, numbered from [0]')
        else:
            raise UserError(f'{where} has nothing below it that is called {part!r}')
        node = node[part]
    node = places.plain(variant, node)
    if isinstance(node, bool) or not isinstance(node, int | float):
        inside: list[str] = []
        if isinstance(node, list):
            inside = [f'{path}[{place}]' for place in range(len(node))]
        elif isinstance(node, Mapping):
            inside = [f'{path}.{name}' for name in node]
        raise UserError(
            f'{path} is not a number' + (f'; one of {", ".join(inside)}?' if inside else '')
        )
    return float(node)


def _changed(variant: Variant, node: Any, key: Key, value: float, whole: bool = False) -> Any:
    """
    Return the part of a description that sets one number in it.

    Lists, and values with their provenance, are replaced as a whole when descriptions are laid over one
    another; so what stands beside the number there is repeated.
    """
    if not key:
        return value
    inner = places.plain(variant, node)
    whole = whole or inner is not node
    if isinstance(inner, list):
        return [
            _changed(variant, item, key[1:], value, True) if place == key[0] else item
            for place, item in enumerate(inner)
        ]
    change = {key[0]: _changed(variant, inner[key[0]], key[1:], value, whole)}
    return {**inner, **change} if whole else change
