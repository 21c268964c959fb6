# SPDX-License-Identifier: Apache-2.0
"""
A diagnosis from beginning to end: logs in, causes, what they gain, what stays unexplained.

Logs are divided into those for finding and those for judging; with a single log its last part
judges. `roles` says what causes they show, and what is left over that no effect of the library
explains; the gain is measured on the judging logs alone (`gain`), and an extension that does not win
there is withdrawn.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.alike import Alike, alike, confidence_in, weighed_by_evidence
from waferbot_twin.diagnosis.left_over import LeftOver
from waferbot_twin.diagnosis.proposals.offered import offered_effects
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.diagnosis.roles import shown
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.effects import library
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis, standard_errors
from waferbot_twin.estimation.intervals import Intervals, intervals_95
from waferbot_twin.logs.bags import is_bag, read_bag
from waferbot_twin.logs.load import load_log
from waferbot_twin.recording.reader import recording_files, recording_of
from waferbot_twin.residuals.from_measured_log import aligned_record, sized_by
from waferbot_twin.residuals.from_recording import record_of
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record
from waferbot_twin.validation.gain import AxisGain, gains

HELD_OUT = 0.4
"""Share of a single log that judges what was found in the rest."""

UNFINISHED = 0.8
"""Confidence at most in a cause on an axis on which something is left unexplained: likely, not more."""

DOUBTFUL = 0.5
"""
Confidence at most in a cause that leaves some over in a block where a right one leaves nothing, or on
whose values the logs disagree.
"""


@dataclass(frozen=True)
class FoundCause:
    """
    A cause with its evidence: gain, and what it cannot be told from.

    `intervals_95` are the ends of the 95 % interval of each parameter; one that was chosen from a few
    has none.
    """

    cause: Cause
    parameters: tuple[Parameter, ...]
    intervals_95: Intervals
    delta_bic: float
    confidence: float
    alike: tuple[Alike, ...]

    @property
    def cannot_tell_from(self) -> tuple[str, ...]:
        """Names of the causes that explain the logs as well."""
        return tuple(item.cause.name for item in self.alike)

    @property
    def evidence(self) -> str:
        """The gain as text; it is infinite where the model without the cause blows up."""
        return f'{self.delta_bic:.0f}' if math.isfinite(self.delta_bic) else 'needed'


@dataclass
class Diagnosis:
    """The result of a diagnosis."""

    nominal: Variant
    extended: Variant
    verdict: str
    causes: list[FoundCause]
    withdrawn: list[Cause]
    unexplained: Sequence[Cause]
    unexplained_where: list[str]
    gains: list[AxisGain]
    where: dict[str, dict[str, float]]
    finding: list[str]
    judging: list[str]
    search: Search
    runtime_s: float = 0.0
    notes: list[str] = field(default_factory=list)


def load_records(paths: Sequence[Path], nominal: Variant) -> list[Record]:
    """Return the records of logs; raises `UserError` for one that cannot be used."""
    return [load_record(path, nominal) for path in paths]


def load_record(path: Path, nominal: Variant) -> Record:
    """
    Return the record of a recording with the contract's topics, else of a measured log.

    Raises `UserError` for a log that cannot be used.
    """
    if path.exists() and not is_bag(path):
        raise UserError(
            f'{path} is no recording; import it first: '
            f'waferbot import {path} --map MAP.yaml --out DIR (docs/logs.md)'
        )
    content = read_bag(path)
    recording = recording_of(path, recording_files(path)[0], content)
    if any(len(array) for array in recording.topics.values()):
        return record_of(recording, path, nominal)
    return aligned_record(load_log(path, machine=nominal.machine_text, name=path.name), nominal)


def diagnose(
    nominal: Variant,
    finding: Sequence[Record],
    judging: Sequence[Record],
    progress: Progress,
    workers: int = 1,
    without: Sequence[str] = (),
) -> Diagnosis:
    """
    Diagnose logs against a model.

    Logs for finding and for judging may change roles (`roles`): nothing is fitted to those that judge,
    and the gain is measured on them.

    `without` names effects that are left out of the library. Raises `UserError` if the logs are too
    short.
    """
    begun_s = time.perf_counter()
    notes = []
    if not judging:
        finding, judging = _divide(finding)
        notes.append('one log only: its last part judged what was found in the rest')
    if any(record.commanded is None for record in (*finding, *judging)):
        notes.append(
            'the controller was not looked at: that takes a recording with servo_state and '
            'current_command, and a model that has a controller'
        )
    notes += list(dict.fromkeys(n for record in (*finding, *judging) for n in record.notes))
    nominal = sized_by(finding, nominal)
    problem, judge = Problem(nominal, finding), Problem(nominal, judging)
    effects = offered_effects(problem, without)
    result = shown(problem, judge, effects, progress, workers)
    problem, judge, found, rest = result.problem, result.judge, result.found, result.rest
    notes += result.notes
    causes = (*found.found.causes, *rest.tables)
    extended = apply_all(nominal, causes)
    axis_gains = gains(nominal, extended, judge.records)
    notes += _stands_for(extended, found.found.causes)
    notes += _out_of_step(found.found.causes, axis_gains)
    where = _where(problem, found)
    found_causes = _found_causes(problem, judge, found, rest)
    return Diagnosis(
        nominal,
        extended,
        _verdict(found_causes, rest.axes),
        found_causes,
        list(result.withdrawn),
        rest.tables,
        rest.axes,
        axis_gains,
        where,
        [record.name for record in problem.records],
        [record.name for record in judge.records],
        found,
        time.perf_counter() - begun_s,
        notes,
    )


def _stands_for(variant: Variant, causes: Sequence[Cause]) -> list[str]:
    """Say of each cause what else does exactly the same in this model."""
    return [
        f'in this model {effect.name} does the same on {cause.axis}: {cause.effect.name} stands for both'
        for cause in causes
        for effect in library().values()
        if effect.same_as == cause.effect.name
        and cause.axis in set(effect.axes(variant)) - set(effect.distinct_axes(variant))
    ]


def _out_of_step(causes: Sequence[Cause], axis_gains: Sequence[AxisGain]) -> list[str]:
    """Say of each cause that is evident from the readings if the positions do not show its gain."""
    lost = {item.axis for item in axis_gains if item.improvement_percent < 0.0}
    return [
        f'{cause.name} stands in the readings themselves; the RMS error does not show it, where machine '
        'and model hunt on the steps of the encoder, but not in step with one another'
        for cause in causes
        if cause.effect.evident and cause.axis in lost
    ]


def _divide(records: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Divide every log into a part for finding and one for judging."""
    finding, judging = [], []
    for record in records:
        if record.duration_s < 0.2:
            raise UserError(
                f'{record.name} is {record.duration_s:.3f} s long; a diagnosis needs 0.2 s at least'
            )
        border_s = (1.0 - HELD_OUT) * record.duration_s
        finding.append(record.part(0.0, border_s))
        judging.append(record.part(border_s, record.duration_s))
    return finding, judging


def _verdict(causes: Sequence[FoundCause], left_over: Sequence[str]) -> str:
    if causes:
        return 'partly' if left_over else 'explained'
    return 'unexplained' if left_over else 'consistent'


def _found_causes(
    problem: Problem, judge: Problem, found: Search, rest: LeftOver
) -> list[FoundCause]:
    """Return the causes with their evidence, the strongest first."""
    errors = standard_errors(found.found)
    result, first = [], 0
    for place, cause in enumerate(found.found.causes):
        own = errors[first : first + cause.free]
        first += cause.free
        weighed = weighed_by_evidence(problem, judge, found, place)
        confidence = confidence_in(weighed, len(found.found.causes))
        if cause.axis in rest.axes:
            confidence = min(confidence, UNFINISHED)
        if rest.in_doubt(cause, problem):
            confidence = min(confidence, DOUBTFUL)
        result.append(
            FoundCause(
                cause,
                cause.effect.parameters(problem.nominal, cause.axis),
                intervals_95(problem, found.found, place, own, found.trials.get(cause.name, [])),
                float(found.gains.get(cause.name, 0.0)),
                confidence,
                tuple(alike(problem, found, cause, weighed)),
            )
        )
    return sorted(result, key=lambda item: -item.delta_bic)


def _where(problem: Problem, found: Search) -> dict[str, dict[str, float]]:
    """Return the RMS residual of every block and channel with the nominal model."""
    return {
        block: _channel_rms(problem, found.nothing, block)
        for block, parts in problem.blocks.items()
        if parts
    }


def _channel_rms(problem: Problem, hypothesis: Hypothesis, block: str) -> dict[str, float]:
    squares: dict[str, list[float]] = {}
    for axis, residual in zip(
        problem.channel_names(block), hypothesis.residuals[block], strict=True
    ):
        squares.setdefault(axis, []).append(float(np.mean(residual**2)))
    return {axis: math.sqrt(float(np.mean(values))) for axis, values in squares.items()}
