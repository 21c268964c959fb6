# SPDX-License-Identifier: Apache-2.0
"""Diagnosis: which physical causes a model lacks, how sure that is, and what stays unexplained."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from waferbot.logs import Log, records_of
from waferbot.model import Model
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis import report, wording
from waferbot_twin.diagnosis.diagnose import Diagnosis as Details
from waferbot_twin.diagnosis.diagnose import FoundCause
from waferbot_twin.diagnosis.diagnose import diagnose as diagnose_records
from waferbot_twin.diagnosis.findings import no_findings
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.reference import contradictions, reference_of
from waferbot_twin.effects import find
from waferbot_twin.identification.least_squares import LeastSquares
from waferbot_twin.library.known import read_known
from waferbot_twin.logs.names import names_of
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import finite
from waferbot_twin.titles import with_titles
from waferbot_twin.workers import number_of


@dataclass(frozen=True)
class Diagnosis:
    """
    The result of a diagnosis.

    `sentence` says in at most 40 words what explains most of the error; `verdict` is `explained`
    (causes, nothing unexplained), `partly`, `unexplained` or `consistent` (the model explains the logs).
    `extended_model` is the model with the causes, to be run and saved. The tables are empty, with the
    same columns, where nothing was found.
    """

    model: Model
    extended_model: Model
    sentence: str
    verdict: str
    notes: tuple[str, ...]
    details: Details = field(repr=False)
    reference: LeastSquares | None = field(default=None, repr=False)
    """Inverse-dynamics least squares of the same logs; None where no axis can be fitted so."""

    @property
    def causes(self) -> pd.DataFrame:
        """
        One row for each cause, the one that explains most first.

        `cause` (`effect:axis`), `words`, `share` (of the mean square error of its axis that goes with
        it alone, 0 to 1), `probability`, `credible_set` (a dict from `effect:axis` to the probability of
        each candidate, which together hold the cause with 95 %), `parameter`, `value`, `low95`,
        `high95`, `unit` (of its first parameter; `parameters` has all).
        """
        return self._table(self.details.causes)

    @property
    def possible(self) -> pd.DataFrame:
        """The same of causes that are possible, but not named nor in the extended model."""
        return self._table(self.details.possible)

    def _table(self, causes: Sequence[FoundCause]) -> pd.DataFrame:
        rows = [
            {
                'cause': found.cause.name,
                'words': wording.in_words(self.model.variant, found.cause, no_findings(found)),
                'share': found.share,
                'probability': found.probability,
                'credible_set': {item.cause.name: item.probability for item in found.credible_set},
                **{key: value for key, value in _rows_of(found)[0].items() if key != 'cause'},
            }
            for found in causes
        ]
        columns = ['cause', 'words', 'share', 'probability', 'credible_set', *_VALUES]
        return pd.DataFrame(rows, columns=columns)

    @property
    def parameters(self) -> pd.DataFrame:
        """
        One row for each parameter of each cause.

        `cause`, `parameter`, `value`, `low95`, `high95`, `unit`. The ends of the 95 % interval are NaN
        for one that was chosen from a few.
        """
        rows = [row for found in self.details.causes for row in _rows_of(found)]
        return pd.DataFrame(rows, columns=['cause', *_VALUES])

    @property
    def credible_sets(self) -> pd.DataFrame:
        """One row for each candidate for each cause: `cause`, `candidate`, `words`, `probability`."""
        rows = [
            {
                'cause': found.cause.name,
                'candidate': item.cause.name,
                'words': wording.in_words(self.model.variant, item.cause),
                'probability': item.probability,
            }
            for found in self.details.causes
            for item in found.credible_set
        ]
        return pd.DataFrame(rows, columns=['cause', 'candidate', 'words', 'probability'])

    @property
    def corrections(self) -> pd.DataFrame:
        """
        One row for each parameter that is a little different from the model's, but no cause.

        And for each axis whose acceleration per ampere is another one, as mass and force constant are.
        `parameter`, `unit`, `nominal`, `found`, `low`, `high`: the ends of the 95 % interval.
        """
        details = self.details
        several = (*details.corrections, *details.accelerations)
        rows = [dataclasses.asdict(item) for item in several]
        return pd.DataFrame(rows, columns=['parameter', 'unit', 'nominal', 'found', 'low', 'high'])

    @property
    def unexplained(self) -> pd.DataFrame:
        """One row for what no cause explains: `axis`, `block`, `share` (0 to 1), `with_what`."""
        rows = [dataclasses.asdict(item) for item in self.details.unexplained]
        return pd.DataFrame(rows, columns=['axis', 'block', 'share', 'with_what'])

    @property
    def gains(self) -> pd.DataFrame:
        """
        One row for each validation log and axis: what the extended model gains over the nominal one.

        `log`, `axis`, `unit`, `rms_before`, `rms_after` (RMS error in `unit`), `improvement_percent`.
        """
        columns = ['log', 'axis', 'unit', 'rms_before', 'rms_after', 'improvement_percent']
        rows = [{name: getattr(item, name) for name in columns} for item in self.details.gains]
        return pd.DataFrame(rows, columns=columns)

    def to_dataframe(self) -> pd.DataFrame:
        """Return `causes`."""
        return self.causes

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, as `report.json` has them."""
        return finite(report.as_dict(self.details, self.reference))

    def save(self, folder: str | Path, force: bool = False) -> Path:
        """
        Write report.html, report.json and extended.yaml to a folder, and return it.

        Raises `UserError` if it exists, unless it holds a report and `force` is given.
        """
        path = Path(folder)
        with OutputFolder(path, force) as output:
            report.write(self.details, output.folder, self.reference)
        return path


_VALUES = ['parameter', 'value', 'low95', 'high95', 'unit']


def _rows_of(found: FoundCause) -> list[dict[str, Any]]:
    return [
        {
            'cause': found.cause.name,
            'parameter': item.name,
            'value': found.cause.values[item.name],
            'low95': found.intervals_95.get(item.name, report.NO_INTERVAL)[0],
            'high95': found.intervals_95.get(item.name, report.NO_INTERVAL)[1],
            'unit': item.unit,
        }
        for item in found.parameters
    ]


def diagnose(
    model: Model,
    logs: Sequence[Log],
    validation: Sequence[Log] = (),
    *,
    without: Sequence[str] = (),
    settings: Settings | None = None,
    workers: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    library: str | Path | None = None,
    machine: str = '',
) -> Diagnosis:
    """
    Find what a model gets wrong in logs, and why.

    Causes, probabilities and intervals are those of all logs together. The gain is that in `validation`,
    logs with another motion, of the same causes fitted to `logs` alone; what loses there is withdrawn.
    Without `validation` it is measured in the last part of each log. `without` names effects that are
    left out of the library of effects. `library` is a file of `waferbot library`: what it knows of
    `machine` from earlier logs takes part. `workers` is a number of processes, all cores by default;
    `progress` is told what is done, how much of it, and of how much. Raises `UserError` if logs
    are too short or lack signals, or if the model does not run in their motions.
    """
    for name in without:
        find(name)
    if not logs:
        raise UserError('give one log at least')
    workers = number_of(workers)
    records = records_of([*logs, *validation], model, moved=False)
    details = diagnose_records(
        model.variant,
        records[: len(logs)],
        records[len(logs) :],
        progress or _silent,
        workers,
        without,
        settings,
        read_known(None if library is None else Path(library), machine),
    )
    reference = _reference(model, logs, validation, details)
    if reference is not None:
        details.notes += contradictions(reference, details.settings.tolerated_loss)
    return Diagnosis(
        model,
        Model(details.extended),
        wording.sentence(details),
        details.verdict,
        tuple(with_titles(note, details.nominal.titles) for note in details.notes),
        details,
        reference,
    )


def _reference(
    model: Model, logs: Sequence[Log], validation: Sequence[Log], details: Details
) -> LeastSquares | None:
    """Return the least squares of logs; none where they cannot be read so, a diagnosis stands alone."""
    several = [*logs, *validation]
    names = names_of([log.path for log in several])
    try:
        measured = [
            dataclasses.replace(log.measured(model), name=name)
            for log, name in zip(several, names, strict=True)
        ]
        return reference_of(
            measured[: len(logs)], measured[len(logs) :], details.nominal, details.extended
        )
    except UserError:
        return None


def _silent(what: str, done: int, total: int) -> None:
    """Tell nothing."""
