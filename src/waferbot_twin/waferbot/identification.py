# SPDX-License-Identifier: Apache-2.0
"""Identification of named parameters of a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from waferbot.logs import Log, records_of
from waferbot.model import Model
from waferbot_twin.identification import report
from waferbot_twin.identification.identify import Identification as Details
from waferbot_twin.identification.identify import identify as identify_records
from waferbot_twin.identification.named_parameters import parse_all
from waferbot_twin.library.known import read_known
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import finite
from waferbot_twin.workers import number_of


@dataclass(frozen=True)
class Identification:
    """The result of an identification; `remarks` say what the logs leave open."""

    model: Model
    identified_model: Model
    remarks: tuple[str, ...]
    details: Details = field(repr=False)

    @property
    def parameters(self) -> pd.DataFrame:
        """
        One row for each parameter.

        `parameter` (its path), `start` (in the model), `value`, `low95`, `high95` (ends of the 95 %
        interval), `unit`, `identified`: False, and no interval, for what the logs leave open.
        """
        found = report.as_dict(self.details)['parameters']
        rows = [{'parameter': name, **row} for name, row in found.items()]
        columns = ['parameter', 'start', 'value', 'low95', 'high95', 'unit', 'identified']
        return pd.DataFrame(rows, columns=columns)

    def to_dataframe(self) -> pd.DataFrame:
        """Return `parameters`."""
        return self.parameters

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, as `report.json` has them."""
        return finite(report.as_dict(self.details))

    def save(self, folder: str | Path, force: bool = False) -> Path:
        """
        Write report.html, report.json and identified.yaml to a folder, and return it.

        Raises `UserError` if it exists, unless it holds a report and `force` is given.
        """
        path = Path(folder)
        with OutputFolder(path, force) as output:
            report.write(self.details, output.folder)
        return path


def identify(
    model: Model,
    logs: Sequence[Log],
    parameters: Sequence[str],
    validation: Sequence[Log] = (),
    progress: Callable[[int, int], None] | None = None,
    library: str | Path | None = None,
    machine: str = '',
    workers: int | None = None,
) -> Identification:
    """
    Fit named parameters of a model to logs.

    `parameters` are paths, `bodies.carriage.mass_kg`, `pmac.y_linear.Ixx30`, each with a range if it
    has another than ten times smaller or larger, `...=low:high`. `validation` are logs with another
    motion in which the gain is measured. `library` is a file of `waferbot library`: what it knows of
    `machine` takes part. So many `workers` simulate side by side, as there are cores by default. Raises
    `UserError` for an unknown path, and if the logs show none of them.
    """
    details = identify_records(
        model.variant,
        records_of(logs, model),
        records_of(validation, model),
        parse_all(parameters, model.variant),
        progress or _silent,
        read_known(None if library is None else Path(library), machine),
        number_of(workers),
    )
    remarks = tuple(report.remarks(details))
    return Identification(model, Model(details.identified), remarks, details)


def _silent(done: int, total: int) -> None:
    """Tell nothing."""
