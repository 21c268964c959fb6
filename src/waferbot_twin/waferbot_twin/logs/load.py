# SPDX-License-Identifier: Apache-2.0
"""Reads any measured log: an imported one, a recording, text, arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import description_source
from waferbot_twin.logs.archive import is_archive, read_archive, write_archive
from waferbot_twin.logs.arrays import read_npy, read_variables
from waferbot_twin.logs.bags import BagColumns, is_bag, joint_state_sources, read_bag
from waferbot_twin.logs.build import Collected, build, finish
from waferbot_twin.logs.columns import Columns
from waferbot_twin.logs.contract_signals import ContractSignals
from waferbot_twin.logs.findings import Finding, names_text
from waferbot_twin.logs.gather import read_gather
from waferbot_twin.logs.json_lines import read_json
from waferbot_twin.logs.machine import controls_of, load_constants, machine_of
from waferbot_twin.logs.mapping import LogMapping, TimeSource, load_mapping
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.logs.parquet import read_parquet
from waferbot_twin.logs.text import read_list, read_text
from waferbot_twin.models import Model, load_model, recorded_model
from waferbot_twin.recording.reader import Content, recording_files, recording_of

ARRAYS = ('.npy', '.npz', '.mat')
JSON = ('.jsonl', '.ndjson', '.json')


def load_log(
    path: Path | str,
    mapping: Path | str | LogMapping | None = None,
    model: str | Model | None = None,
    machine: str | None = None,
    part: int | None = None,
    name: str | None = None,
    span_s: tuple[float | None, float | None] = (None, None),
) -> MeasuredLog:
    """
    Return the measured log at `path`.

    `mapping` is a mapping file (or the name of a shipped one); text and arrays need it, recordings
    with the contract's topics or joint states do not. `model` gives the settings behind the
    contract's topics: by name or file also where the recording holds others, a `Model` only where it
    holds none. `machine` gives the description behind counts and names of joints. `part` replaces that
    of the mapping, `span_s` its ends in the log's own time, `name` the log's own.

    Raises `UserError` if nothing usable is left; see `build.finish`.
    """
    path = Path(path)
    if not path.exists():
        raise UserError(f'{path} does not exist')
    constants = load_constants(machine) if machine else None
    if mapping is not None and not isinstance(mapping, LogMapping):
        mapping = load_mapping(mapping, constants)
    if mapping is not None:
        mapping = mapping.of_part(part).of_span(*span_s)
    elif span_s != (None, None):
        raise UserError(f'{path}: --start and --end belong to a mapping (--map)')
    if is_bag(path) and not (mapping and mapping.format not in ('', 'bag')):
        return _from_bag(path, mapping, model, machine, name)
    if mapping is None:
        raise UserError(
            f'{path}: say what its columns are: --map FILE (docs/log_mapping.md shows how to write one)'
        )
    if path.is_dir():
        raise UserError(f'{path} is a folder; a log of format {mapping.format} is a file')
    log = _read(path, mapping)
    companion, remarks = _companion(path, mapping)
    collected = build(mapping, log, companion)
    collected.findings += remarks
    return finish(collected, _header(path, [path], mapping, name))


def import_log(
    path: Path,
    out: Path,
    mapping: Path | str | LogMapping | None = None,
    model: str | None = None,
    machine: str | None = None,
    part: int | None = None,
    name: str | None = None,
    force: bool = False,
    span_s: tuple[float | None, float | None] = (None, None),
) -> MeasuredLog:
    """
    Read a log as `load_log` does, keep it in the folder `out`, and return it.

    Raises `UserError` as `load_log` does, and if `out` is there and `force` is not given, or would
    replace the log.
    """
    written, source = out.resolve(), path.resolve()
    if written == source or written in source.parents:
        raise UserError(f'{out} would replace the log itself; choose another folder')
    log = load_log(path, mapping, model, machine, part, name, span_s)
    write_archive(log, out, force)
    return log


def _read(path: Path, mapping: LogMapping) -> Columns:
    """Return the columns of a file of text, arrays, JSON or Parquet."""
    if mapping.format == 'pmac_gather':
        return read_gather(path, mapping.gather)
    if mapping.format == 'array' or (not mapping.format and path.suffix in ARRAYS):
        if path.suffix in ('.npz', '.mat'):
            return read_variables(path)
        return read_npy(path, mapping.options.get('samples_along'))
    if mapping.format == 'json' or (not mapping.format and path.suffix in JSON):
        return read_json(path, mapping.options.get('encoding'))
    if mapping.format == 'parquet' or (not mapping.format and path.suffix == '.parquet'):
        return read_parquet(path)
    choosing = mapping.choosing_columns()
    if choosing:
        return read_list(path, mapping.options, choosing)
    return read_text(path, mapping.options)


def _companion(path: Path, mapping: LogMapping) -> tuple[Columns | None, list[Finding]]:
    """Return the columns of the second file, None and why if there is none."""
    if mapping.companion is None:
        return None, []
    old, new = mapping.companion
    signals = ', '.join(
        f'{source.axis}.{source.kind}' for source in mapping.signals if source.in_companion
    )
    if old not in path.name:
        reason = f'{old!r} is not in its name, so it has no companion; without {signals}'
        return None, [Finding(str(path), reason)]
    other = path.with_name(path.name.replace(old, new))
    try:
        return _read(other, mapping), []
    except UserError as error:
        return None, [Finding(str(other), f'{error}; without {signals}')]


def _from_bag(
    path: Path,
    mapping: LogMapping | None,
    model: str | Model | None,
    machine: str | None,
    name: str | None,
) -> MeasuredLog:
    content = read_bag(path)
    if is_archive(content):
        if mapping is not None:
            raise UserError(f'{path} has been imported already; it needs no mapping')
        log = read_archive(path, content)
        return replace(log, name=name) if name else log
    collected, peak_current = _from_contract(path, content, model)
    bag = BagColumns(path, content)
    own = {(signal.axis, signal.kind) for signal in collected.signals}
    if mapping is None and not own:
        mapping = _joint_states(bag, machine)
    if mapping is not None:
        mapped = build(mapping, bag, None)
        mapped.origin_ns = mapped.origin_ns or bag.origin_ns
        if own and mapped.origin_ns:
            raise UserError(
                f"{path}: the contract's topics count time from zero, the mapped topics are on a "
                'calendar clock; import them as two logs'
            )
        # What the user maps replaces what the topics say.
        chosen = {(signal.axis, signal.kind) for signal in mapped.signals}
        mapped.signals += [s for s in collected.signals if (s.axis, s.kind) not in chosen]
        mapped.findings += collected.findings
        collected = mapped
    if not content.closed:
        collected.findings.insert(0, _cut_off(path, content))
    if not collected.signals:
        raise UserError(
            f'{path}: holds no topic of the contract and no joint state of an axis; say with --map '
            f'which topics are what (topics: {names_text(content.messages)})'
        )
    return finish(collected, _header(path, recording_files(path), mapping, name), peak_current)


def _from_contract(
    path: Path, content: Content, model: str | Model | None
) -> tuple[Collected, dict[str, float]]:
    """Return the signals in the contract's topics, and the drives' peak currents."""
    recording = recording_of(path, recording_files(path)[0], content)
    if not any(len(array) for array in recording.topics.values()):
        return Collected([], []), {}
    if model is None and 'model.yaml' not in recording.attachments:
        raise UserError(
            f'{path}: does not hold the settings of controller and amplifiers, without which counts '
            'and phase currents cannot be turned into metres and force; give --model'
        )
    if isinstance(model, str):
        chosen = load_model(model)
    elif model is None or 'model.yaml' in recording.attachments:
        chosen = recorded_model(recording)
    else:
        chosen = model
    controls = controls_of(chosen, recording.timing, str(path))
    taken = ContractSignals(recording, controls)
    limits = controls.amplifier['peak_limit'].tolist()
    peaks = dict(zip(controls.machine.layout.axes, limits, strict=True))
    return Collected(taken.signals, taken.findings), peaks


def _joint_states(bag: BagColumns, machine: str | None) -> LogMapping | None:
    """Return what joint states there are as a mapping, None if there are none."""
    joints = {axis: axis for axis in SHIPPED.axes}
    constants = None
    if machine:
        description = load_description(description_source(machine))
        joints = {axis: axis for axis in description.layout.axes}
        constants = machine_of(description)
        joints |= {coordinate: axis for axis, coordinate in description.axes.items()}
    sources = joint_state_sources(bag, joints, constants)
    return LogMapping('', 'bag', TimeSource(), sources) if sources else None


def _cut_off(path: Path, content: Content) -> Finding:
    last_ns = max((times[-1] for times in content.log_times_ns.values() if times), default=0)
    how = f' ({content.trouble})' if content.trouble else ''
    return Finding(
        f'{path}, after {last_ns / 1e9:.6f} s',
        f'the recording is cut off or damaged from there on{how}',
    )


def _header(
    path: Path, files: Iterable[Path], mapping: LogMapping | None, name: str | None
) -> MeasuredLog:
    """Return a log without signals: only where it comes from."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    own = mapping.name if mapping and mapping.name else path.stem
    if mapping is not None and mapping.part is not None:
        own = f'{own} {mapping.part}'
    text = mapping.text if mapping else ''
    return MeasuredLog(
        name or own, (), (), source=str(path), digest=digest.hexdigest(), mapping=text
    )
