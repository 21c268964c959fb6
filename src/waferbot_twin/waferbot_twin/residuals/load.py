# SPDX-License-Identifier: Apache-2.0
"""Records of logs on disk: recordings with the contract's topics, and imported logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.bags import is_bag, read_bag
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.logs.names import names_of
from waferbot_twin.recording.reader import recording_files, recording_of
from waferbot_twin.residuals.from_measured_log import aligned_records
from waferbot_twin.residuals.from_recording import record_of
from waferbot_twin.residuals.record import Record


def load_records(paths: Sequence[Path], nominal: Variant, moved: bool = True) -> list[Record]:
    """
    Return the records of logs, in their order, with names that tell them apart (`names_of`).

    Imported logs are aligned in time all together: how late a channel stands is the logger's, not the
    motion's; `moved` as in `aligned_records`. Raises `UserError` for a log that cannot be used.
    """
    found: dict[int, Record] = {}
    imported: dict[int, MeasuredLog] = {}
    for place, (path, name) in enumerate(zip(paths, names_of(paths), strict=True)):
        if path.exists() and not is_bag(path):
            raise UserError(
                f'{path} is no recording; import it first: '
                f'waferbot import {path} --map MAP.yaml --out DIR (docs/logs.md)'
            )
        content = read_bag(path)
        recording = recording_of(path, recording_files(path)[0], content)
        if any(len(array) for array in recording.topics.values()):
            found[place] = replace(record_of(recording, path, nominal), name=name)
        else:
            imported[place] = load_log(path, machine=nominal.machine_text, name=name)
    if imported:
        aligned = aligned_records(list(imported.values()), nominal, moved)
        found |= zip(imported, aligned, strict=True)
    return [found[place] for place in range(len(paths))]


def load_record(path: Path, nominal: Variant, moved: bool = True) -> Record:
    """Return the record of one log; raises as `load_records`."""
    (record,) = load_records([path], nominal, moved)
    return record
