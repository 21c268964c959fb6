# SPDX-License-Identifier: Apache-2.0
"""
Mapping files: which column of a log is which signal, in which unit.

The grammar is `mapping.schema.json`; docs/log_mapping.md explains every key. Errors name file, line
and key.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping as Items
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jsonschema

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED
from waferbot_lockstep.marked_yaml import Document, Key, first_complaint, parse, read
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.logs.columns import Where
from waferbot_twin.logs.kinds import KINDS, OTHER_QUANTITIES, SAME_KIND, UNITS, is_linear
from waferbot_twin.logs.machine import Machine, load_constants
from waferbot_twin.logs.units import (
    COUNT_UNITS,
    SERVO_CYCLE,
    TIME_UNITS,
    UNITS_IN_LOGS,
    Unit,
)

Column = str | int

_COUNTED = {
    'counts': ('position', 'motor_position', 'commanded_position', 'following_error'),
    'counts/s': ('velocity',),
    'counts/servo_cycle': ('velocity',),
}


@dataclass(frozen=True)
class TimeSource:
    """
    Where times come from: a column, or the number of the sample times `sample_time_s`.

    `unit_s` is the length of one unit of the column in s; `wraps_at` is where its counter starts
    again, in its unit. With a column, `sample_time_s` is only what the user expects of it.
    """

    column: Column | None = None
    unit_s: float = 1.0
    wraps_at: float | None = None
    sample_time_s: float | None = None


@dataclass(frozen=True)
class SignalSource:
    """
    Where one signal comes from.

    SI value = factor * sign * (scale * column / divide_by + offset) + shift, where factor and shift are
    those of the unit (`conversion`); `wraps_at` and `resolution` are in the unit as given. `hold` and
    `counting` are as in `measured.Signal`. `where` says which rows are the signal's, None for all.
    """

    column: Column
    kind: str
    axis: str
    unit: str
    conversion: Unit
    sign: float = 1.0
    scale: float = 1.0
    divide_by: float = 1.0
    offset: float = 0.0
    wraps_at: float | None = None
    resolution: float | None = None
    hold: str = ''
    counting: str = ''
    delay_s: float = 0.0
    time: TimeSource | None = None
    in_companion: bool = False
    where: Where | None = None

    @property
    def si_unit(self) -> str:
        """Return the unit that the signal has in the log."""
        return UNITS[self.conversion.quantity]


@dataclass(frozen=True)
class LogMapping:
    """A whole mapping file, checked. `text` is what was read; `options` as in the grammar."""

    name: str
    format: str
    time: TimeSource
    signals: tuple[SignalSource, ...]
    options: Items[str, Any] = field(default_factory=dict)
    gather: Items[str, Any] = field(default_factory=dict)
    companion: tuple[str, str] | None = None
    part: int | None = None
    text: str = ''
    source: str = ''
    machine: Machine | None = None

    def of_part(self, part: int | None) -> LogMapping:
        """Return the mapping with another number for `$part`; raises `UserError` if it has none."""
        if part is None:
            return self
        if self.part is None:
            raise UserError(f'{self.source}: has no key part, so --part says nothing')
        return replace(self, part=part)

    def of_span(self, start_s: float | None, end_s: float | None) -> LogMapping:
        """Return the mapping with other ends, in the log's own time; raises `UserError`."""
        given = {
            key: value
            for key, value in (('start_s', start_s), ('end_s', end_s))
            if value is not None
        }
        for key, value in given.items():
            if not math.isfinite(value):
                raise UserError(f'--{key.removesuffix("_s")} is {value:g} s; it must be a time')
        options = {**self.options, **given}
        if options.get('end_s', math.inf) <= options.get('start_s', -math.inf):
            raise UserError(
                f'--end {options["end_s"]:g} must be later than --start {options["start_s"]:g}'
            )
        return replace(self, options=options) if given else self

    def choosing_columns(self) -> list[Column]:
        """Return the columns that say of which signal a row is."""
        chosen = [source.where.column for source in self.signals if source.where is not None]
        return list(dict.fromkeys(chosen))

    def column(self, column: Column) -> Column:
        """Return a column with `$part` replaced by its number."""
        return column.replace('$part', str(self.part)) if isinstance(column, str) else column


def example_mappings() -> dict[str, Path]:
    """Return the shipped mapping files by name."""
    folder = package_data('waferbot_twin', 'config', 'examples')
    return {path.stem: path for path in sorted(folder.glob('*.yaml'))}


def load_mapping(name_or_path: str | Path, machine: Machine | None = None) -> LogMapping:
    """
    Read and check a mapping: a file, or one that is shipped, by name.

    `machine` is used for counts in place of what the file names. Raises `UserError` with file, line
    and key.
    """
    path = Path(name_or_path)
    if path.suffix not in ('.yaml', '.yml') and not path.exists():
        known = example_mappings()
        if str(name_or_path) not in known:
            raise UserError(
                f'there is no mapping {str(name_or_path)!r}{did_you_mean(str(name_or_path), known)} '
                f'(shipped: {", ".join(known)}; or give a YAML file)'
            )
        path = known[str(name_or_path)]
    return mapping_of(read(path), path.read_text('utf-8'), path.parent, machine)


def mapping_text(text: str, source: str = 'mapping', machine: Machine | None = None) -> LogMapping:
    """Return the mapping in a text; paths in it are relative to the working folder."""
    return mapping_of(parse(text, source), text, Path(), machine)


def mapping_of(
    document: Document, text: str, folder: Path, machine: Machine | None = None
) -> LogMapping:
    """Check a document and return the mapping in it."""
    _check_grammar(document)
    data = document.data
    if machine is None and 'machine' in data:
        machine = _machine(document, data['machine'], folder)
    time, cycle_s = _time(document, data.get('time', {}))
    part = data.get('part')
    signals = tuple(
        _signal(document, place, signal, machine, cycle_s)
        for place, signal in enumerate(data['signals'])
    )
    for place, signal in enumerate(signals):
        for other in signals[:place]:
            if (signal.axis, signal.kind) == (other.axis, other.kind):
                raise document.error(
                    ('signals', place), f'{signal.axis} {signal.kind} is given twice'
                )
        if signal.in_companion and 'companion' not in data:
            raise document.error(('signals', place, 'in'), 'there is no key companion')
        if isinstance(signal.column, str) and '$part' in signal.column and part is None:
            raise document.error(('signals', place, 'column'), '$part needs the key part')
    if data.get('format') == 'pmac_gather' and 'gather' not in data:
        raise document.error(('format',), 'pmac_gather needs the key gather with its sources')
    options = data.get('options', {})
    if options.get('end_s', float('inf')) <= options.get('start_s', -float('inf')):
        raise document.error(('options', 'end_s'), 'must be later than start_s')
    delimiter = options.get('delimiter', ';')
    if len(delimiter) > 1 and delimiter != 'space':
        raise document.error(('options', 'delimiter'), 'must be one character, or: space')
    if delimiter == options.get('decimal', '.'):
        raise document.error(('options', 'delimiter'), 'cannot be the decimal sign too')
    companion = data.get('companion')
    return LogMapping(
        name=data.get('name', ''),
        format=data.get('format', 'pmac_gather' if 'gather' in data else ''),
        time=time,
        signals=signals,
        options=options,
        gather=data.get('gather', {}),
        companion=(companion['replace'], companion['by']) if companion else None,
        part=part,
        text=text,
        source=document.place(),
        machine=machine,
    )


def _machine(document: Document, name: str, folder: Path) -> Machine:
    try:
        beside = folder / name
        return load_constants(beside if beside.is_file() else name)
    except UserError as error:
        raise document.error(('machine',), str(error)) from None


def _time(document: Document, data: Items[str, Any]) -> tuple[TimeSource, float | None]:
    """Return where times come from, and the length of a servo cycle if it is said."""
    cycle_s = data.get('servo_cycle_s')
    if 'I10' in data:
        if cycle_s is not None:
            raise document.error(('time', 'I10'), 'give I10 or servo_cycle_s, not both')
        cycle_s = data['I10'] / 8388608.0 * 1e-3
    sample_time_s = data.get('sample_time_s')
    if 'I5049' in data:
        if cycle_s is None:
            raise document.error(('time', 'I5049'), 'needs I10 or servo_cycle_s')
        if sample_time_s is not None:
            raise document.error(('time', 'I5049'), 'give I5049 or sample_time_s, not both')
        sample_time_s = data['I5049'] * cycle_s
    if 'column' not in data:
        for key in ('unit', 'wraps_at'):
            if key in data:
                raise document.error(('time', key), 'belongs to a time column; give column')
        return TimeSource(sample_time_s=sample_time_s), cycle_s
    unit = data.get('unit')
    if unit is None:
        raise document.error(('time', 'column'), 'give the unit of the time column too')
    if unit == SERVO_CYCLE and cycle_s is None:
        raise document.error(('time', 'unit'), 'servo_cycle needs I10 or servo_cycle_s')
    unit_s = cycle_s if unit == SERVO_CYCLE else TIME_UNITS[unit]
    assert unit_s is not None
    return TimeSource(data['column'], unit_s, data.get('wraps_at'), sample_time_s), cycle_s


def _signal(
    document: Document,
    place: int,
    data: Items[str, Any],
    machine: Machine | None,
    cycle_s: float | None,
) -> SignalSource:
    key: Key = ('signals', place)
    axis, given_kind = data['axis'], data['kind']
    kind = SAME_KIND.get(given_kind, given_kind)
    if kind not in KINDS:
        names = [*KINDS, *SAME_KIND]
        raise document.error(
            (*key, 'kind'),
            f'there is no kind {given_kind!r}{did_you_mean(given_kind, names)} '
            f'(kinds: {", ".join(names)})',
        )
    axes = machine.layout.axes if machine else SHIPPED.axes
    if axis not in axes:
        hint = '' if machine else '; of a machine with axes of its own, name it: machine: FILE'
        raise document.error(
            (*key, 'axis'),
            f'there is no axis {axis!r}{did_you_mean(axis, axes)} (axes: {", ".join(axes)}{hint})',
        )
    linear = is_linear(axis, machine.linear if machine else None)
    if given_kind == 'torque' and linear:
        raise document.error((*key, 'kind'), f'{axis} slides, so it has a force, no torque')
    if 'counting' in data and kind not in ('position', 'motor_position'):
        raise document.error(
            (*key, 'counting'), f'{kind} is not counted; it belongs to a position'
        )
    time = None
    if 'sample_time_s' in data or 'time_column' in data:
        if 'sample_time_s' in data and 'time_column' in data:
            raise document.error((*key, 'time_column'), 'give this or sample_time_s, not both')
        unit_s = TIME_UNITS.get(document.data.get('time', {}).get('unit', 's'), cycle_s or 1.0)
        time = TimeSource(data.get('time_column'), unit_s, None, data.get('sample_time_s'))
    unit = str(data['unit'])
    where = data.get('where')
    return SignalSource(
        column=data['column'],
        kind=kind,
        axis=axis,
        unit=unit,
        conversion=_conversion(document, key, unit, axis, kind, linear, machine, cycle_s),
        sign=float(data.get('sign', 1)),
        scale=float(data.get('scale', 1.0)),
        divide_by=float(data.get('divide_by', 1.0)),
        offset=float(data.get('offset', 0.0)),
        wraps_at=data.get('wraps_at'),
        resolution=data.get('resolution'),
        hold=data.get('hold', ''),
        counting=data.get('counting', ''),
        delay_s=float(data.get('delay_s', 0.0)),
        time=time,
        in_companion=data.get('in', 'log') == 'companion',
        where=Where(where['column'], str(where['is'])) if where else None,
    )


def _conversion(
    document: Document,
    key: Key,
    unit: str,
    axis: str,
    kind: str,
    linear: bool,
    machine: Machine | None,
    cycle_s: float | None,
) -> Unit:
    """Return how a unit becomes SI; a unit that does not fit the kind is an error."""
    quantity = KINDS[kind].quantity(linear)
    if unit in COUNT_UNITS:
        if kind not in _COUNTED[unit]:
            raise document.error((*key, 'unit'), f'wrong unit: {kind} has none in {unit}')
        if machine is None:
            raise document.error(
                (*key, 'unit'), f'{unit} need the machine: give the key machine, or --machine'
            )
        if unit == 'counts/servo_cycle' and cycle_s is None:
            raise document.error((*key, 'unit'), f'{unit} needs time.I10 or time.servo_cycle_s')
        try:
            factor = 1.0 / machine.counts(axis, kind)
        except UserError as error:
            raise document.error((*key, 'unit'), str(error)) from None
        per_second = 1.0 / cycle_s if unit == 'counts/servo_cycle' and cycle_s else 1.0
        return Unit(quantity, factor * per_second)
    quantities = [quantity, *OTHER_QUANTITIES.get(kind, ())]
    fitting = [name for name, entry in UNITS_IN_LOGS.items() if entry.quantity in quantities]
    if unit not in UNITS_IN_LOGS:
        hint = did_you_mean(unit, [*fitting, *COUNT_UNITS])
        raise document.error(
            (*key, 'unit'), f'there is no unit {unit!r}{hint} (for {kind}: {", ".join(fitting)})'
        )
    found = UNITS_IN_LOGS[unit]
    if found.quantity not in quantities:
        moves = 'slides' if linear else 'turns'
        raise document.error(
            (*key, 'unit'),
            f'wrong unit: {unit} is for {found.quantity}, but {kind} of {axis} (which {moves}) is '
            f'in units of {quantity}: {", ".join(fitting)}',
        )
    return found


_GRAMMAR = json.loads(package_data('waferbot_twin.logs', 'mapping.schema.json').read_text('utf-8'))


def _whole_number(checker: object, value: object) -> bool:
    """Return whether a value is a whole number; 1.0, which JSON takes for one, is not."""
    return isinstance(value, int) and not isinstance(value, bool)


_VALIDATOR = jsonschema.validators.extend(
    jsonschema.Draft202012Validator,
    type_checker=jsonschema.Draft202012Validator.TYPE_CHECKER.redefine('integer', _whole_number),
)(_GRAMMAR)


def _check_grammar(document: Document) -> None:
    """Turn the first complaint of the JSON schema into one line for the user."""
    if not isinstance(document.data, dict):
        raise document.error((), 'a mapping file is a mapping of keys to values')
    error = first_complaint(_VALIDATOR.iter_errors(document.data))
    if error is None:
        return
    key = tuple(error.absolute_path)
    if error.validator == 'additionalProperties':
        known = error.schema['properties']
        unknown = sorted(map(str, set(error.instance) - set(known)))[0]
        raise document.error(
            (*key, unknown),
            f'unknown key{did_you_mean(unknown, known)} (keys here: {", ".join(known)})',
        )
    if error.validator == 'required':
        missing = [name for name in error.validator_value if name not in error.instance]
        raise document.error(key, f'{" and ".join(missing)} missing')
    texts = {
        'exclusiveMinimum': 'must be greater than {}',
        'minimum': 'must be at least {}',
        'type': 'must be of type {}',
        'enum': 'must be one of {}',
        'not': 'must not be zero',
        'anyOf': 'must be a name or a number',
        'minItems': 'must have at least {} entry',
        'minProperties': 'must have at least {} key',
        'minLength': 'must not be empty',
        'pattern': 'must be like $80008B',
    }
    rule = error.validator_value
    rule = ', '.join(map(str, rule)) if isinstance(rule, list) else rule
    text = texts.get(str(error.validator), 'is nothing that may stand there').format(rule)
    raise document.error(key, f'is {error.instance!r}; it {text}')
