# SPDX-License-Identifier: Apache-2.0
"""Logs of a machine: recordings with the contract's topics, and logs that were brought in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from waferbot.model import Model
from waferbot_twin.logs.bags import is_bag
from waferbot_twin.logs.hold import evidence
from waferbot_twin.logs.load import import_log as import_measured
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.recording.reader import recording_files
from waferbot_twin.residuals.load import load_record, load_records
from waferbot_twin.residuals.record import Record


@dataclass(frozen=True)
class Log:
    """A log on disk; its signals are read when they are needed, as a model's machine has them."""

    path: Path

    @property
    def name(self) -> str:
        """The name of the folder or file."""
        return self.path.name

    def record(self, model: Model) -> Record:
        """Return the signals as the diagnosis takes them; raises `UserError` for unusable ones."""
        return load_record(self.path, model.variant, moved=False)

    def measured(self, model: Model) -> MeasuredLog:
        """Return the signals at the times at which they were measured; raises `UserError`."""
        variant = model.variant
        return load_log(
            self.path, model=variant.model(), machine=variant.machine_text, name=self.name
        )

    def to_dataframe(self, model: Model) -> pd.DataFrame:
        """
        Return positions and commanded positions, one row for each reading of the encoders.

        The index is the time in s. A column for each encoder of the model, NaN where it was not read,
        and one `..._commanded` for each axis of which the command is in the log; `_m` or `_rad` says the
        unit.
        """
        record = self.record(model)
        description = model.variant.description
        time_s = np.arange(len(record.reading)) / record.timing.encoder_hz
        columns: dict[str, np.ndarray] = {}
        units: dict[str, str] = {}
        for place, name in enumerate(description.layout.encoders):
            if name not in description.encoders:
                continue
            encoder = description.encoders[name]
            units[name] = 'rad' if description.revolute[encoder.coordinate] else 'm'
            columns[f'{name}_{units[name]}'] = record.reading[:, place] / encoder.counts_per_unit
        if record.commanded is not None:
            servo_s = np.arange(len(record.commanded)) / record.timing.servo_hz
            held = np.clip(np.searchsorted(servo_s, time_s, side='right') - 1, 0, None)
            for place, axis in enumerate(description.layout.axes):
                encoder_name = description.position_encoder(axis)
                if encoder_name in units and axis in model.axes:
                    per_unit = description.encoders[encoder_name].counts_per_unit
                    columns[f'{axis}_commanded_{units[encoder_name]}'] = (
                        record.commanded[held, place] / per_unit
                    )
        return pd.DataFrame(columns, index=pd.Index(time_s, name='time_s'))


def load_logs(paths: str | Path | Iterable[str | Path]) -> list[Log]:
    """
    Return logs by their folders or files, in their order; one path gives a list of one.

    Raises `UserError` if one does not exist. `import_log` brings in other formats (CSV).
    """
    several = [paths] if isinstance(paths, (str, Path)) else list(paths)
    logs = [Log(Path(path)) for path in several]
    for log in logs:
        if not log.path.exists() or is_bag(log.path):
            recording_files(log.path)
    return logs


@dataclass(frozen=True)
class Imported:
    """
    A log that was brought in, and what was found in it.

    `details` has the samples as they are: `details['x_rotate', 'position'].value`, with `time_s` of
    their own, in SI units.
    """

    log: Log
    details: MeasuredLog = field(repr=False)

    @property
    def signals(self) -> pd.DataFrame:
        """
        One row for each signal.

        `axis`, `kind`, `unit`, `samples`, `rate_hz`, `start_s`, `end_s`, `lowest`, `highest`,
        `resolution` (its smallest step), `gaps` (how many stretches without a sample), `held` (whether a
        value stands until the next sample).
        """
        columns = ['axis', 'kind', 'unit', 'samples', 'rate_hz', 'start_s', 'end_s', 'lowest',
                   'highest', 'resolution', 'gaps', 'held']  # fmt: skip
        return pd.DataFrame(self.details.describe()['signals'], columns=columns)

    @property
    def findings(self) -> tuple[str, ...]:
        """What was left out, put in order, or looks wrong, and how the drive goes between samples."""
        return tuple(str(one) for one in (*self.details.findings, *evidence(self.details)))

    def to_dataframe(self) -> pd.DataFrame:
        """Return `signals`."""
        return self.signals


def import_log(
    file: str | Path,
    out: str | Path,
    mapping: str | Path | None = None,
    *,
    machine: str | Path | None = None,
    part: int | None = None,
    name: str | None = None,
    force: bool = False,
    span_s: tuple[float | None, float | None] = (None, None),
) -> Imported:
    """
    Bring in a measured log, as `waferbot import` does, and keep it in the new folder `out`.

    `file` is a text file (CSV, a drive's trace), an array, Parquet, JSON or a recording; `mapping` says
    which column is which signal (docs/log_mapping.md), `machine` is the description behind counts and
    names of joints, `part` stands for `$part` in the columns of the mapping, `span_s` is where in the
    log's own time it begins and ends. Raises `UserError` if
    nothing usable is in it, or the folder exists and `force` is not given.
    """
    details = import_measured(
        Path(file),
        Path(out),
        mapping,
        machine=None if machine is None else str(machine),
        part=part,
        name=name,
        force=force,
        span_s=span_s,
    )
    return Imported(Log(Path(out)), details)


def records_of(logs: Sequence[Log], model: Model, moved: bool = True) -> list[Record]:
    """
    Return the signals of logs, drives with a plain skew `moved` to where they belong, if that is wanted.

    Raises `UserError` for a log that cannot be used.
    """
    return load_records([log.path for log in logs], model.variant, moved)
