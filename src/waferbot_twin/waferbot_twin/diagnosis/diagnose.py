# SPDX-License-Identifier: Apache-2.0
"""
A diagnosis from beginning to end: logs in, causes, what they gain, what stays unexplained.

The posterior over causes is that of all logs together (`inference.single_effects`). What is
reported as gain is from logs that were not used for the fit: the same causes are fitted to the
estimation data alone, and the extended model is simulated in the validation data. With a single
log its last part validates. A cause that the validation data refute, or without which the extended
model is nearer to them, is withdrawn (`validation.holdout`).

The extended model has what is named and the small corrections, fitted anew without what is not sure
enough for a name: a user is promised no gain by anything that has none. What is then no longer evident,
as it only went together with that, goes as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis import notes as said
from waferbot_twin.diagnosis.accelerations import accelerations
from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy, is_physical, tables
from waferbot_twin.diagnosis.inference.elimination import as_evident
from waferbot_twin.diagnosis.inference.exactness import as_likely_as_not_where_inexact, inexact
from waferbot_twin.diagnosis.inference.model_average import rivals_of
from waferbot_twin.diagnosis.inference.nuisance import (
    corrections,
    nuisance,
    prior_groups,
)
from waferbot_twin.diagnosis.inference.parameter_constancy import as_sure_as_constant
from waferbot_twin.diagnosis.inference.prediction import Prediction
from waferbot_twin.diagnosis.inference.refit import to_the_end
from waferbot_twin.diagnosis.inference.search import infer
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Follows, Posterior
from waferbot_twin.diagnosis.inference.unexplained import (
    Unexplained,
    follows_command,
    unexplained,
)
from waferbot_twin.diagnosis.known_before import with_known
from waferbot_twin.diagnosis.proposals.offered import offered_effects
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.effects import library
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, standard_errors
from waferbot_twin.estimation.intervals import Intervals, Rival, intervals_95
from waferbot_twin.estimation.known_values import Known
from waferbot_twin.estimation.noise_of_currents import without_noise_of_currents
from waferbot_twin.estimation.usual_spread import with_usual_spread
from waferbot_twin.residuals.from_measured_log import sized_by
from waferbot_twin.residuals.observer_bandwidth import with_observers
from waferbot_twin.residuals.problem import UNITS, Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record
from waferbot_twin.residuals.windows import Windows, in_windows
from waferbot_twin.validation.gain import AxisGain
from waferbot_twin.validation.holdout import extension_that_wins, fitted_to, without_refuted

HELD_OUT = 0.4
"""Share of a single log that validates what was found in the rest."""

SHORTEST_S = 0.2


@dataclass(frozen=True)
class Alternative:
    """A member of a credible set: a candidate with its values, and its posterior probability."""

    cause: Cause
    probability: float


@dataclass(frozen=True)
class FoundCause:
    """
    A cause with what is known of it.

    inclusion       posterior probability that there is such a cause at all, this one or another member
                    of the credible set, 0 to 1
    probability     posterior probability that this is the cause, 0 to 1
    credible_set    the fewest candidates that hold the cause with 95 %, the most probable first, this
                    one among them
    unnamed         posterior probability that it is none of these, but a force or small corrections
                    without a known cause, as far as that is needed for the 95 %, 0 to 1
    intervals_95    ends of the 95 % interval of each parameter; one chosen from a few has none
    log_evidence    ln of the Bayes factor against none of it
    share           share of what the nominal model gets wrong on the cause's axis, mean square beyond
                    noise in the block where it shows most, that goes with it alone, 0 to 1
    """

    cause: Cause
    parameters: tuple[Parameter, ...]
    intervals_95: Intervals
    inclusion: float
    probability: float
    credible_set: tuple[Alternative, ...]
    log_evidence: float
    share: float
    unnamed: float = 0.0

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """The other members of the credible set."""
        return tuple(item for item in self.credible_set if item.cause.name != self.cause.name)


@dataclass
class Diagnosis:
    """
    The result of a diagnosis.

    `verdict` is `explained` (causes, nothing unexplained), `partly`, `unexplained` or `consistent`
    (the model explains the logs). `possible` are causes that are at least as probable as not, but not so
    probable that they are named: as they were beside the others, and not in the extended model.
    `residual_rms` has by block and channel what the nominal model leaves over. `problem` holds the logs
    as they were compared, estimation data first. `corrections` are parameters a little different from
    the model's, which are no causes; `accelerations` what they make of an ampere, where the logs tell
    that rather than them (`diagnosis.accelerations`).
    """

    nominal: Variant
    extended: Variant
    verdict: str
    causes: list[FoundCause]
    possible: list[FoundCause]
    withdrawn: list[Cause]
    unexplained: list[Unexplained]
    gains: list[AxisGain]
    residual_rms: dict[str, dict[str, float]]
    estimation: list[str]
    validation: list[str]
    settings: Settings
    before: Hypothesis
    after: Hypothesis
    channels: dict[str, list[str]]
    problem: Problem
    tried: int
    runtime_s: float = 0.0
    notes: list[str] = field(default_factory=list)
    corrections: list[Correction] = field(default_factory=list)
    accelerations: list[Correction] = field(default_factory=list)


def diagnose(
    nominal: Variant,
    estimation: Sequence[Record],
    validation: Sequence[Record],
    progress: Progress,
    workers: int = 1,
    without: Sequence[str] = (),
    settings: Settings | None = None,
    known: Mapping[str, Known] | None = None,
) -> Diagnosis:
    """
    Diagnose logs against a model.

    `without` names effects that are left out of the library. `known` are values from other logs of this
    machine, by path (`known_before`). Raises `UserError` if the logs are
    too short or the nominal model does not run in their motions.
    """
    begun_s = time.perf_counter()
    settings = settings or Settings()
    notes = []
    if not validation:
        estimation, validation = _divide(estimation)
        notes.append(said.ONE_LOG)
    sized = sized_by([*estimation, *validation], nominal)
    windows = [*in_windows(estimation, nominal), *in_windows(validation, nominal)]
    windows, quiet = without_noise_of_currents(sized, windows, windows, workers)
    estimation, validation = (
        [part for one in some for part in one.records]
        for some in (windows[: len(estimation)], windows[len(estimation) :])
    )
    records = [*estimation, *validation]
    if not all(record.is_imported or record.closes_loop for record in records):
        notes.append(said.NO_CONTROLLER)
    notes += list(dict.fromkeys(n for record in records for n in record.notes))
    notes += quiet
    nominal = sized_by(records, nominal)
    dense, numbers = nuisance(nominal, records, settings)
    groups = prior_groups(numbers)
    scales = settings.prior_scales, settings.unrated_scales

    def pool_of(followed: Sequence[Record]) -> CandidatePool:
        problem = Problem(nominal, followed).with_prior(groups, *scales)
        effects = [*offered_effects(problem, without), *tables(nominal, records), *dense]
        return CandidatePool(problem, effects, settings, progress, workers)

    pool, posterior = _searched(nominal, records, pool_of)
    problem = pool.problem
    records = list(problem.records)
    estimation, validation = records[: len(estimation)], records[len(estimation) :]
    to_estimate = Problem(nominal, estimation).with_prior(groups, *scales)
    estimated = fitted_to(to_estimate, posterior.found.causes, workers)
    prediction = Prediction(
        (problem, posterior.found), (to_estimate, estimated), settings, workers
    )
    refuted = without_refuted(
        Problem(nominal, validation).with_coloured_forces(),
        estimated.causes,
        settings.refutation_level,
        prediction.log_ratio,
    )
    posterior = posterior.without(problem, refuted, workers)
    posterior = as_likely_as_not_where_inexact(problem, posterior, settings)
    posterior = as_sure_as_constant(pool, posterior)
    possible: list[FoundCause] = []
    models = list(posterior.models)
    while unnamed := _without_a_name(posterior, settings):
        rivals = rivals_of(pool, posterior.found, models, [one.name for one in refuted])
        possible += _found_causes(problem, posterior, settings, unnamed, rivals)
        models.append(posterior.found)
        posterior = as_evident(pool, posterior.without(problem, unnamed, workers))
    extension = extension_that_wins(
        nominal,
        _in_the_model(fitted_to(to_estimate, posterior.found.causes, workers)),
        estimation,
        validation,
        settings.tolerated_loss,
        {one.best.cause.name: one.log_odds for one in posterior.effects},
    )
    posterior = posterior.without(problem, extension.withdrawn, workers)
    withdrawn = [cause for cause in (*refuted, *extension.withdrawn) if is_physical(cause)]
    notes += [said.refuted(nominal, cause) for cause in refuted if is_physical(cause)]
    notes += [said.worse_with(nominal, cause) for cause in extension.withdrawn]
    if extension.loses(settings.tolerated_loss):
        notes.append(said.LOSES)
    with_gain = {gain.log for gain in extension.gains}
    notes += [said.no_gain(one.name) for one in validation if one.name not in with_gain]
    gone = [one.name for one in (*refuted, *extension.withdrawn)]
    rivals = rivals_of(pool, posterior.found, models, gone)
    problem, posterior = _in_fine_steps(problem, posterior, workers)
    posterior = replace(posterior, found=with_usual_spread(problem, posterior.found))
    updated, told = with_known(problem, posterior.found, known or {}, numbers)
    posterior = replace(posterior, found=updated)
    follows = follows_command(problem, posterior, settings)
    left = unexplained(problem, posterior, follows)
    found = posterior.found
    causes = _found_causes(problem, posterior, settings, found.causes, rivals, follows)
    extended = apply_all(nominal, _in_the_model(posterior.found))
    notes += [
        *told,
        *(said.not_exact(nominal, block, axis) for block, axis in inexact(problem, posterior)),
        *_stands_for(extended, [item.cause for item in causes]),
        *(_used(one, nominal, extended) for one in windows if one.spans_s),
    ]
    return Diagnosis(
        nominal,
        extended,
        _verdict(causes, left),
        causes,
        possible,
        withdrawn,
        left,
        extension.gains,
        _residual_rms(problem, posterior.nothing),
        [record.name for record in estimation],
        [record.name for record in validation],
        settings,
        posterior.nothing,
        posterior.found,
        {
            block: problem.channel_names(block)
            for block in posterior.nothing.residuals
            if block in UNITS
        },
        problem,
        posterior.tried,
        time.perf_counter() - begun_s,
        notes,
        corrections(problem, posterior.found, numbers, rivals),
        accelerations(problem, posterior.found, rivals),
    )


def _in_fine_steps(
    problem: Problem, posterior: Posterior, workers: int
) -> tuple[Problem, Posterior]:
    """
    Return the values of causes in fine steps of the plant, where something gives and may ring.

    Of logs of a machine alone: the twin's own come of the steps in which they are simulated.
    """
    found = apply_all(problem.nominal, posterior.found.causes)
    gives = any(item.flexible for item in found.description.connections.values())
    alone = found.is_machine_alone and all(record.is_imported for record in problem.records)
    if not (gives and alone):
        return problem, posterior
    fine = problem.fine()
    try:
        begun = evaluate(fine, posterior.found.causes)
    except UserError:
        return problem, posterior
    return fine, replace(posterior, found=to_the_end(fine, begun, workers))


def _divide(records: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Divide every log into a part for estimation and one for validation."""
    estimation, validation = [], []
    for record in records:
        if record.duration_s < SHORTEST_S:
            raise UserError(
                f'{record.name} is {record.duration_s:.3f} s long; a diagnosis needs '
                f'{SHORTEST_S} s at least'
            )
        border_s = (1.0 - HELD_OUT) * record.duration_s
        estimation.append(record.part(0.0, border_s))
        validation.append(record.part(border_s, record.duration_s))
    return estimation, validation


def _searched(
    nominal: Variant,
    records: Sequence[Record],
    pool_of: Callable[[Sequence[Record]], CandidatePool],
) -> tuple[CandidatePool, Posterior]:
    """
    Return the candidates in some logs and the posterior of the search.

    The logs are followed as fast as what the nominal model leaves over asks for. Where what was found
    leaves so little that a slower observer predicts them better, the search goes on with that
    (`residuals.observer_bandwidth`).
    """
    followed = with_observers(records, nominal, nominal)
    posterior: Posterior | None = None
    while True:
        pool = pool_of(followed)
        posterior = infer(pool, posterior)
        before = [record.observer_hz for record in followed]
        found = apply_all(nominal, posterior.found.causes)
        followed = with_observers(followed, nominal, found)
        if [record.observer_hz for record in followed] == before:
            return pool, posterior


def _verdict(causes: Sequence[FoundCause], left: Sequence[Unexplained]) -> str:
    if causes:
        return 'partly' if left else 'explained'
    return 'unexplained' if left else 'consistent'


def _in_the_model(found: Hypothesis) -> tuple[Cause, ...]:
    """Return the causes of a hypothesis that a model can have: all but the discrepancies."""
    return tuple(cause for cause in found.causes if not is_discrepancy(cause))


def _found_causes(
    problem: Problem,
    posterior: Posterior,
    settings: Settings,
    some: Sequence[Cause],
    rivals: Sequence[Rival],
    follows: Follows | None = None,
) -> list[FoundCause]:
    """Return those of some causes that have a physical name, what explains most first."""
    found = posterior.found
    errors = standard_errors(found)
    wanted = {cause.name for cause in some if is_physical(cause)}
    result, first = [], 0
    for place, (cause, effect) in enumerate(zip(found.causes, posterior.effects, strict=True)):
        own = errors[first : first + cause.free]
        first += cause.free
        if cause.name not in wanted:
            continue
        members = effect.credible_set(settings.credible_level)
        result.append(
            FoundCause(
                cause,
                cause.effect.parameters(problem.nominal, cause.axis),
                intervals_95(problem, found, place, own, rivals),
                effect.inclusion,
                effect.best.probability,
                tuple(
                    Alternative(
                        cause if one.cause.name == cause.name else one.cause, one.probability
                    )
                    for one in members
                    if is_physical(one.cause)
                ),
                effect.best.log_evidence,
                posterior.share(problem, place, follows),
                sum(one.probability for one in members if not is_physical(one.cause)),
            )
        )
    return sorted(result, key=lambda item: -item.share)


def _without_a_name(posterior: Posterior, settings: Settings) -> list[Cause]:
    """Return the causes that are not sure enough for a name."""
    return [
        cause
        for cause, effect in zip(posterior.found.causes, posterior.effects, strict=True)
        if is_physical(cause) and effect.inclusion < settings.named_from
    ]


def _stands_for(variant: Variant, causes: Sequence[Cause]) -> list[str]:
    """Say of the causes of each axis what else does exactly the same in this model."""
    names = {cause.name for cause in causes}
    return [
        said.stands_for(variant, effect.name, axis, effect.same_as)
        for effect in library().values()
        for axis in effect.axes(variant)
        if effect.same_as
        and axis not in effect.distinct_axes(variant)
        and all(f'{name}:{axis}' in names for name in effect.same_as)
    ]


def _used(windows: Windows, nominal: Variant, extended: Variant) -> str:
    """Say which windows of a log were used, and what the extended model leaves over in the rest."""
    try:
        errors = windows.rms_errors(nominal, extended)
    except UserError:
        errors = {}
    return said.in_windows(windows.record, windows.spans_s, nominal, errors)


def _residual_rms(problem: Problem, hypothesis: Hypothesis) -> dict[str, dict[str, float]]:
    """Return the RMS residual of every block and channel, all logs together."""
    found: dict[str, dict[str, float]] = {}
    for block, residuals in hypothesis.residuals.items():
        if block not in UNITS:
            continue
        parts: dict[str, list[np.ndarray]] = {}
        for name, residual in zip(problem.channel_names(block), residuals, strict=True):
            parts.setdefault(name, []).append(residual)
        found[block] = {
            name: float(np.sqrt(np.mean(np.concatenate(own) ** 2))) for name, own in parts.items()
        }
    return found
