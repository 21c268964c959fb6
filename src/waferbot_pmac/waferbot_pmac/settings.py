# SPDX-License-Identifier: Apache-2.0
"""
Settings from a file: YAML, or a plain listing as a PMAC's configuration is kept.

YAML names the axis and the variable, so that nobody has to count motors. It is a ROS 2 parameter
file with a section for the node `pmac`; sections for other nodes are passed over:

    /**/pmac:
      ros__parameters:
        y_linear: {Ixx30: 6400, Ixx31: 1600}

A listing holds what one would send to the controller. Motors are the machine's axes in their order, on
the shipped one 1 `y_linear`, 2 `x_rotate`, 3 `y_rotate`:

    I130=6400 I131=$640     ; several on a line, hexadecimal with $, comments after ; or //
    I133..135=0             ; I133, I134, I135
    I130,3,100=2000         ; three variables, 100 apart: I130, I230, I330
    I134=*                  ; the default
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.marked_yaml import Document, Key, parse
from waferbot_lockstep.parameters import Parameter, Value, check_value, did_you_mean
from waferbot_pmac.i_variables import FEEDBACK, axis_parameters

SettingsOfAxes = dict[str, dict[str, Value]]

LARGEST_I_VARIABLE = 8191
LARGEST_MOTOR = 32


@dataclass(frozen=True)
class Problem:
    """One statement of a listing that was not taken over."""

    line: int
    text: str
    reason: str

    def __str__(self) -> str:
        """Return `line 12: I199=3: reason`."""
        return f'line {self.line}: {self.text}: {self.reason}'


@dataclass
class Listing:
    """What a listing sets, axis by axis, and what in it was not taken over."""

    settings: SettingsOfAxes = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)


def load_settings(
    path: str | Path,
    encoder_addresses: Mapping[int, int] | None = None,
    layout: Layout = SHIPPED,
) -> Listing:
    """
    Read a settings file of a machine: YAML if it is called `*.yaml` or `*.yml`, else a listing.

    Raises `UserError` with file, line and key for a file that cannot be read and for any mistake
    in YAML. In a listing, statements that are unknown or out of range are collected in `problems`
    and the others hold, because a real configuration always sets more than this servo has.
    `encoder_addresses`: see `parse_listing`.
    """
    try:
        text = Path(path).read_text('utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f'settings {str(path)!r} cannot be read: {error}') from error
    if Path(path).suffix in ('.yaml', '.yml'):
        return Listing(parse_yaml(text, str(path), layout))
    return parse_listing(text, encoder_addresses, layout)


def parse_yaml(text: str, source: str, layout: Layout = SHIPPED) -> SettingsOfAxes:
    """Return the settings of YAML text; raises `UserError` with source, line and key."""
    document = parse(text, source)
    sections = _mapping(document, (), document.data)
    settings: SettingsOfAxes = {}
    for section in sections:
        if str(section).rsplit('/', 1)[-1] != 'pmac':
            continue
        path = (section, 'ros__parameters')
        content = _mapping(document, (section,), sections[section])
        if set(content) != {'ros__parameters'}:
            raise UserError(f'{document.where((section,))} must have the one key ros__parameters')
        for axis, values in _mapping(document, path, content['ros__parameters']).items():
            if axis in layout.axes:
                values = _mapping(document, (*path, axis), values)
                settings[axis] = _checked(document, (*path, axis), axis, values, layout)
    if not settings:
        raise UserError(
            f'{source}: no settings found; they stand under /**/pmac, ros__parameters and the '
            f'name of an axis ({", ".join(layout.axes)})'
        )
    return settings


def _mapping(document: Document, path: Key, value: Any) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise UserError(f'{document.where(path)} must be a mapping of names to values')
    return value


def _checked(
    document: Document, path: Key, axis: str, values: Mapping[Any, object], layout: Layout
) -> dict[str, Value]:
    known = {parameter.name: parameter for parameter in axis_parameters(axis, layout)}
    checked = {}
    for name, value in values.items():
        inner = (*path, name)
        if name not in known:
            hint = did_you_mean(str(name), known)
            raise UserError(f'{document.where(inner)} is no setting of an axis{hint}')
        checked[name] = check_value(known[name], value, f'{document.place(inner)}: {axis}')
    return checked


_ASSIGNMENT = re.compile(
    r'I\s*(?P<first>\d+)\s*'
    r'(?:\.\.\s*(?P<last>\d+)|,\s*(?P<count>\d+)\s*,\s*(?P<spacing>\d+))?'
    r'\s*=\s*'
    r'(?P<value>(?:\*|[+-]?\$[0-9A-F]+|[+-]?(?:\d+\.?\d*|\.\d+))(?=\s|$|I\s*\d)|\S+)',
    re.IGNORECASE,
)
_DECIMAL = re.compile(r'[+-]?(\d+\.?\d*|\.\d+)')
_HEXADECIMAL = re.compile(r'([+-]?)\$([0-9a-fA-F]+)')


def parse_listing(
    text: str,
    encoder_addresses: Mapping[int, int] | None = None,
    layout: Layout = SHIPPED,
) -> Listing:
    """
    Read the assignments to I-variables out of a listing.

    Anything else, an expression as a value, a variable that this servo does not have, or a value
    out of its range is put into `problems` with its line, text and reason, and changes nothing.
    (The controller itself would fold a value that is out of range back into it without a word.) A
    later assignment replaces an earlier one.

    Ixx03 and Ixx04 hold addresses of the controller's encoder conversion table. Which encoder is
    behind an address only its owner knows: `encoder_addresses` maps address -> place of the
    encoder in `layout`. The places themselves are understood as well.
    """
    listing = Listing()
    for number, line in enumerate(text.splitlines(), start=1):
        statement = re.split(r';|//', line, maxsplit=1)[0]
        end = 0
        for match in _ASSIGNMENT.finditer(statement):
            _report_unknown(listing, number, statement[end : match.start()])
            end = match.end()
            _assign(listing, number, match, encoder_addresses or {}, layout)
        _report_unknown(listing, number, statement[end:])
    return listing


def _report_unknown(listing: Listing, line: int, text: str) -> None:
    if text.strip():
        listing.problems.append(
            Problem(line, text.strip(), 'is no assignment of a constant to an I-variable')
        )


def _assign(
    listing: Listing,
    line: int,
    match: re.Match[str],
    encoder_addresses: Mapping[int, int],
    layout: Layout,
) -> None:
    text = match.group().strip()
    try:
        value = _constant(match['value'])
        numbers = _numbers(match)
    except UserError as error:
        listing.problems.append(Problem(line, text, str(error)))
        return
    reasons = []
    for number in numbers:
        try:
            axis, parameter = _meaning(number, layout)
            checked = _value(axis, parameter, value, encoder_addresses, layout)
        except UserError as error:
            reasons.append(str(error))
        else:
            listing.settings.setdefault(axis, {})[parameter.name] = checked
    if reasons:
        more = f' (and {len(reasons) - 1} more of these variables)' if len(reasons) > 1 else ''
        listing.problems.append(Problem(line, text, reasons[0] + more))


def _value(
    axis: str,
    parameter: Parameter,
    value: int | float | None,
    encoder_addresses: Mapping[int, int],
    layout: Layout,
) -> Value:
    """Return the checked value of one variable; None stands for its default."""
    if value is None:
        return parameter.default
    if parameter.name in FEEDBACK:
        value = _encoder(value, encoder_addresses, layout.encoders)
    return check_value(parameter, value, axis)


def _constant(text: str) -> int | float | None:
    """Return the number that a value stands for, None for `*`, the default."""
    if text == '*':
        return None
    hexadecimal = _HEXADECIMAL.fullmatch(text)
    if hexadecimal:
        return int(hexadecimal[1] + hexadecimal[2], 16)
    if not _DECIMAL.fullmatch(text):
        raise UserError('only constants are read, not expressions')
    return float(text) if '.' in text else int(text)


def _numbers(match: re.Match[str]) -> Iterable[int]:
    """Return the numbers of the I-variables that an assignment sets."""
    first = int(match['first'])
    if match['last'] is not None:
        numbers = range(first, int(match['last']) + 1)
    elif match['count'] is not None:
        spacing = int(match['spacing'])
        if spacing < 1:
            raise UserError('the distance between the variables must be 1 or more')
        numbers = range(first, first + int(match['count']) * spacing, spacing)
    else:
        numbers = range(first, first + 1)
    if not numbers or numbers[-1] > LARGEST_I_VARIABLE:
        raise UserError(f'I-variables go from I0 to I{LARGEST_I_VARIABLE}, the first one first')
    return numbers


def _meaning(number: int, layout: Layout) -> tuple[str, Parameter]:
    """Return axis and declaration of an I-variable."""
    motor, index = divmod(number, 100)
    if not 1 <= motor <= LARGEST_MOTOR:
        raise UserError(f'I{number} belongs to no motor; it is not used here')
    axes = layout.axes
    if motor > len(axes):
        raise UserError(
            f'motor {motor} is not used here; motors 1 to {len(axes)} are {", ".join(axes)}'
        )
    axis = axes[motor - 1]
    for parameter in axis_parameters(axis, layout):
        if parameter.name == f'Ixx{index:02d}':
            return axis, parameter
    raise UserError(f'Ixx{index:02d} is not part of this servo; it is not used here')


def _encoder(
    value: int | float, encoder_addresses: Mapping[int, int], encoders: Sequence[str]
) -> int | float:
    if value in encoder_addresses:
        return encoder_addresses[int(value)]
    if 0 <= value < len(encoders):
        return value
    raise UserError(
        f'${int(value):X} is an address of the encoder conversion table; say which encoder it is '
        f'({", ".join(f"{place} {name}" for place, name in enumerate(encoders))})'
    )
