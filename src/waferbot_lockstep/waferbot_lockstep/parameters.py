# SPDX-License-Identifier: Apache-2.0
"""
A setting declared once, and what is made from that declaration.

An I-variable or an amplifier setting is one `Parameter`. From it come the ROS 2 parameter with its
description and range (`waferbot_lockstep.node`), the check of a configuration file
(`check_value`) and the documentation. Nobody writes a range twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError

Value = bool | int | float


@dataclass(frozen=True)
class Parameter:
    """
    One setting of a controller, an amplifier or a node.

    `low` and `high` are inclusive. `integer` settings hold whole numbers, as the device does.
    `fixed` settings cannot change while the loop is closed, because the device forbids it.
    """

    name: str
    default: Value
    unit: str
    low: float
    high: float
    description: str
    integer: bool = False
    fixed: bool = False

    def range_text(self) -> str:
        """Return the range with its unit, for messages: `0 to 32767 DAC bits`."""
        unit = f' {self.unit}' if self.unit else ''
        return f'{self.low:g} to {self.high:g}{unit}'


def check_value(parameter: Parameter, value: object, where: str) -> Value:
    """
    Return `value` as the parameter's type, or say what is wrong with it.

    Raises `UserError` that names `where` (file, line, axis: whatever the caller knows), the setting,
    its range and the value. Whole numbers are accepted where a real one is wanted, not the reverse.
    """
    name = f'{where}: {parameter.name}' if where else parameter.name
    wanted = 'a whole number' if parameter.integer else 'a number'
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UserError(f'{name} is {value!r}; it must be {wanted}, {parameter.range_text()}')
    if parameter.integer and math.isfinite(value) and value != int(value):
        raise UserError(f'{name} is {value!r}; it must be a whole number')
    if not math.isfinite(value) or not parameter.low <= value <= parameter.high:
        raise UserError(f'{name} is {value!r}; the range is {parameter.range_text()}')
    return int(value) if parameter.integer else float(value)


def check_settings(
    parameters: Iterable[Parameter], settings: Mapping[str, object], where: str
) -> dict[str, Value]:
    """
    Return every parameter's value: from `settings` where given, else its default.

    Raises `UserError` for an unknown name (with the nearest known one) or a value out of range.
    """
    known = {parameter.name: parameter for parameter in parameters}
    for name in settings:
        if name not in known:
            raise UserError(f'{where}: unknown setting {name!r}{did_you_mean(name, known)}')
    return {
        name: check_value(parameter, settings.get(name, parameter.default), where)
        for name, parameter in known.items()
    }


def known_name(name: str, known: Iterable[str], where: str) -> str:
    """Return a name that is among those known; raises `UserError` that begins with `where`."""
    names = list(known)
    if name not in names:
        raise UserError(
            f'{where}: there is no {name!r}{did_you_mean(name, names)} (there are: {", ".join(names)})'
        )
    return name


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """
    Return `; did you mean 'x'?` for the nearest of the `known` names, or nothing.

    A name that only looks the same (O for 0, l for 1, large for small) is nearer than any other.
    """
    import difflib

    text, names = str(name), list(known)
    looks = str.maketrans('oli', '011')
    shape = text.casefold().translate(looks)
    nearest = [one for one in names if one.casefold().translate(looks) == shape]
    nearest = nearest or difflib.get_close_matches(text, names, n=1)
    return f'; did you mean {nearest[0]!r}?' if nearest else ''
