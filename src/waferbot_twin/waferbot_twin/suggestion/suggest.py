# SPDX-License-Identifier: Apache-2.0
"""
The experiment that tells a group of causes apart best.

Every candidate is simulated with each cause in the machine and the others fitted to it; what counts is
the smallest evidence that it gives for any pair, either way round. The best designed one is tried in
other sizes as well. If nothing gives enough, it is asked whether signals that are not logged, or the
motion of parts that no encoder follows, would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.problem import Cause, apply_all
from waferbot_twin.diagnosis.record import Array
from waferbot_twin.diagnosis.search_state import TELLS_APART
from waferbot_twin.suggestion.candidates import Candidate, changed, designed, library
from waferbot_twin.suggestion.separation import Machine, Separation, separation

Progress = Callable[[int, int], None]

SAMPLED_S = 0.01
"""How often positions are looked at that no encoder follows."""


@dataclass(frozen=True)
class Rated:
    """
    A candidate with what it is worth.

    `separations` are those of all ordered pairs (true, other); `impossible` says why it cannot be run,
    else it is empty.
    """

    candidate: Candidate
    separations: tuple[Separation, ...]
    impossible: str = ''

    @property
    def evidence(self) -> float:
        """The 2 ln L that can be relied on, whichever cause is the true one."""
        return min((item.evidence for item in self.separations), default=0.0)

    @property
    def best_case(self) -> float:
        """The 2 ln L if the cause is true that shows most."""
        return max((item.evidence for item in self.separations), default=0.0)

    @property
    def detectable(self) -> float:
        """The difference in units of the smallest that any test could detect, sqrt(2 ln L / ln N)."""
        if not self.separations:
            return 0.0
        return math.sqrt(self.evidence / math.log(self.separations[0].samples))


@dataclass(frozen=True)
class Suggestion:
    """
    What is suggested: all candidates, the best first; those that cannot be run last.

    `instead` says what else to measure if none of them separates the causes.
    """

    causes: tuple[Cause, ...]
    rated: tuple[Rated, ...]
    instead: tuple[str, ...] = field(default=())

    @property
    def best(self) -> Rated | None:
        """The best that can be run, if it gives enough."""
        possible = [item for item in self.rated if not item.impossible]
        return possible[0] if possible and possible[0].evidence >= TELLS_APART else None

    @property
    def special_case(self) -> tuple[Cause, Cause] | None:
        """A cause that the other one can imitate in every experiment, and that other one, or None."""
        if self.best is not None or len(self.causes) != 2:
            return None
        possible = [item for item in self.rated if not item.impossible]
        for place, pair in enumerate(permutations(self.causes, 2)):
            imitated = all(item.separations[place].evidence < TELLS_APART for item in possible)
            shows = any(item.separations[1 - place].evidence >= TELLS_APART for item in possible)
            if imitated and shows:
                return pair
        return None


def suggest(
    machine: Machine, causes: Sequence[Cause], progress: Progress, workers: int = 1
) -> Suggestion:
    """
    Return the experiments that tell causes apart, rated.

    Raises `UserError` if there are fewer than two, or if no experiment can be run.
    """
    if len({cause.name for cause in causes}) < 2:
        raise UserError('two different causes at least are needed to tell them apart')
    axes = [axis for axis in AXES if any(cause.axis == axis for cause in causes)]
    candidates = [
        *library(machine.variant),
        *designed(machine.variant, axes, machine.timing),
    ]
    rated = _rate_all(machine, causes, candidates, progress, workers)
    best = max(
        (item for item in rated if item.candidate.design and not item.impossible),
        key=lambda item: item.evidence,
        default=None,
    )
    if best is not None:
        rated += _rate_all(machine, causes, changed(best.candidate), progress, workers)
    rated.sort(key=lambda item: (bool(item.impossible), -item.evidence, item.candidate.label))
    if all(item.impossible for item in rated):
        raise UserError(f'no experiment can be run with these causes: {rated[0].impossible}')
    found = Suggestion(tuple(causes), tuple(rated))
    if found.best is None and found.special_case is None:
        found = replace(found, instead=tuple(_instead(machine, found)))
    return found


def _rate_all(
    machine: Machine,
    causes: Sequence[Cause],
    candidates: Sequence[Candidate],
    progress: Progress,
    workers: int,
) -> list[Rated]:
    found = []
    pool = Parallel(n_jobs=workers, return_as='generator')
    for one in pool(delayed(_rate)(machine, causes, item) for item in candidates):
        found.append(one)
        progress(len(found), len(candidates))
    return found


def _rate(machine: Machine, causes: Sequence[Cause], candidate: Candidate) -> Rated:
    try:
        found = tuple(
            separation(machine, true, other, candidate.experiment)
            for true, other in permutations(causes, 2)
        )
    except UserError as error:
        return Rated(candidate, (), str(error))
    worst = max((item.load for item in found), key=lambda load: max(load.speed, load.current))
    if not worst.possible:
        return Rated(candidate, found, f'beyond the limits of {worst.axis}')
    return Rated(candidate, found)


def _instead(machine: Machine, found: Suggestion) -> list[str]:
    """Return what else would tell the causes apart."""
    possible = [item for item in found.rated if not item.impossible]
    most = max(possible, key=lambda item: item.evidence).candidate
    said = []
    if machine.without:
        whole = _rate(replace(machine, without=()), found.causes, most)
        if whole.evidence >= TELLS_APART:
            said.append(
                f'log {", ".join(machine.without)} as well: with that, {most.label} is expected to '
                f'give 2 ln L = {whole.evidence:.0f}'
            )
    return said + [
        f'put an encoder on {name}: its motion differs by {size:.2g} {unit} rms in {most.label}'
        for name, size, unit in _unseen_motion(machine, found.causes, most)
    ]


def _unseen_motion(
    machine: Machine, causes: Sequence[Cause], candidate: Candidate
) -> list[tuple[str, float, str]]:
    """Return coordinates without an encoder that move otherwise, by more than an encoder's count."""
    description = machine.variant.description
    seen = {encoder.coordinate for encoder in description.encoders.values()}
    first, second = causes[:2]
    refitted = separation(machine, first, second, candidate.experiment).refitted
    one, other = (_positions(machine, cause, candidate) for cause in (first, refitted))
    finest = {
        turns: min(
            (
                1.0 / encoder.counts_per_unit
                for encoder in description.encoders.values()
                if description.revolute[encoder.coordinate] == turns
            ),
            default=math.inf,
        )
        for turns in (False, True)
    }
    found = []
    for name in one.keys() & other.keys() - seen:
        size = float(np.sqrt(np.mean((one[name] - other[name]) ** 2)))
        turns = bool(description.revolute[name])
        if size > finest[turns]:
            found.append((name, size, 'rad' if turns else 'm'))
    return sorted(found)


def _positions(machine: Machine, cause: Cause, candidate: Candidate) -> dict[str, Array]:
    """Return the positions of every coordinate of the machine, one every 10 ms."""
    twin = machine.twin(apply_all(machine.variant, (cause,)), candidate.experiment)
    ticks = machine.timing.ticks(SAMPLED_S)
    rows = []
    for _ in range(int(candidate.experiment.duration_s / SAMPLED_S)):
        twin.advance(ticks)
        rows.append(twin.plant_state[0]['position'].copy())
    return dict(zip(twin.machine.coordinates, np.array(rows).T, strict=True))
