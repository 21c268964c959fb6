# SPDX-License-Identifier: Apache-2.0
"""Logs of a machine: recordings with the contract's topics, and logs brought in by `waferbot import`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from waferbot.model import Model
from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_twin.logs.bags import is_bag
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
        return load_record(self.path, model.variant)

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
        for place, name in enumerate(ENCODERS):
            if name not in description.encoders:
                continue
            encoder = description.encoders[name]
            units[name] = 'rad' if description.revolute[encoder.coordinate] else 'm'
            columns[f'{name}_{units[name]}'] = record.reading[:, place] / encoder.counts_per_unit
        if record.commanded is not None:
            servo_s = np.arange(len(record.commanded)) / record.timing.servo_hz
            held = np.clip(np.searchsorted(servo_s, time_s, side='right') - 1, 0, None)
            for place, axis in enumerate(AXES):
                encoder_name = ENCODERS[place]
                if encoder_name in units and axis in model.axes:
                    per_unit = description.encoders[encoder_name].counts_per_unit
                    columns[f'{axis}_commanded_{units[encoder_name]}'] = (
                        record.commanded[held, place] / per_unit
                    )
        return pd.DataFrame(columns, index=pd.Index(time_s, name='time_s'))


def load_logs(paths: str | Path | Iterable[str | Path]) -> list[Log]:
    """
    Return logs by their folders or files, in their order; one path gives a list of one.

    Raises `UserError` if one does not exist. Logs of other formats (CSV) have to be imported first.
    """
    several = [paths] if isinstance(paths, (str, Path)) else list(paths)
    logs = [Log(Path(path)) for path in several]
    for log in logs:
        if not log.path.exists() or is_bag(log.path):
            recording_files(log.path)
    return logs


def records_of(logs: Sequence[Log], model: Model) -> list[Record]:
    """Return the signals of logs; raises `UserError` for one that cannot be used."""
    return load_records([log.path for log in logs], model.variant)
