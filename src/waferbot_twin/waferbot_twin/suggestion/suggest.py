# SPDX-License-Identifier: Apache-2.0
"""
The experiment that tells a group of causes apart best.

Every candidate is simulated with each cause in the machine and the others fitted to it; what counts is
the smallest evidence that it gives for any pair, either way round. A pair that no candidate tells apart
does not count: there one cause can do whatever the other does. A candidate that fails where others tell
is given up. The best designed one is tried in other sizes as well. If nothing gives enough, it is asked
whether signals that are not logged, or the motion of parts that no encoder follows, would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.residuals.problem import Cause, apply_all
from waferbot_twin.residuals.record import Array
from waferbot_twin.suggestion.candidates import Candidate, changed, designed, library
from waferbot_twin.suggestion.separation import TELLS_APART, Machine, Separation, separations

Progress = Callable[[int, int], None]

Pair = tuple[str, str]
"""The cause that is in the machine and one that is fitted to it, by their names."""

SAMPLED_S = 0.01
"""How often positions are looked at that no encoder follows."""


@dataclass(frozen=True)
class Rated:
    """
    A candidate with what it is worth.

    `separations` are those of ordered pairs (true, rival); pairs are lacking where the candidate was
    given up. `impossible` says why it cannot be run, else it is empty.
    """

    candidate: Candidate
    separations: Mapping[Pair, Separation]
    impossible: str = ''

    def tells(self, pair: Pair) -> bool:
        """Whether a diagnosis of such a log would tell the true cause from the rival."""
        return pair in self.separations and self.separations[pair].evidence >= TELLS_APART

    def evidence(self, pairs: Collection[Pair]) -> float:
        """The least 2 ln L for any of these pairs."""
        return min(
            (one.evidence for pair, one in self.separations.items() if pair in pairs), default=0.0
        )

    def detectable(self, pairs: Collection[Pair]) -> float:
        """The difference in units of the smallest that any test could detect, sqrt(2 ln L / ln N)."""
        if not self.separations:
            return 0.0
        samples = next(iter(self.separations.values())).samples
        return math.sqrt(self.evidence(pairs) / math.log(samples))


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
    def possible(self) -> tuple[Rated, ...]:
        """The candidates that can be run."""
        return tuple(item for item in self.rated if not item.impossible)

    @property
    def told(self) -> tuple[Pair, ...]:
        """The ordered pairs that some experiment tells apart."""
        return tuple(
            pair for pair in _pairs(self.causes) if any(item.tells(pair) for item in self.possible)
        )

    @property
    def imitated(self) -> tuple[Pair, ...]:
        """The ordered pairs of which the second can do whatever the first does, however it moves."""
        told = self.told
        return tuple(pair for pair in _pairs(self.causes) if pair not in told)

    @property
    def counted(self) -> tuple[Pair, ...]:
        """The pairs that rate an experiment: those that can be told apart at all, else all."""
        return self.told or self.imitated

    @property
    def best(self) -> Rated | None:
        """The first that tells apart whatever can be."""
        told = self.told
        return next(
            (item for item in self.possible if told and all(item.tells(pair) for pair in told)),
            None,
        )

    def best_for(self, pair: Pair) -> Rated:
        """The experiment that tells this pair best."""
        return max(self.possible, key=lambda item: item.evidence((pair,)))


def suggest(
    machine: Machine, causes: Sequence[Cause], progress: Progress, workers: int = 1
) -> Suggestion:
    """
    Return the experiments that tell causes apart, rated.

    Raises `UserError` if there are fewer than two, or if no experiment can be run.
    """
    if len({cause.name for cause in causes}) < max(2, len(causes)):
        raise UserError('two different causes at least are needed to tell them apart, none twice')
    axes = [
        axis for axis in machine.variant.layout.axes if any(cause.axis == axis for cause in causes)
    ]
    candidates = [
        *library(machine.variant),
        *designed(machine.variant, axes, machine.timing),
    ]
    rated = _rate_all(machine, causes, candidates, progress, workers)
    found = _in_order(causes, rated)
    best = next((item for item in found.possible if item.candidate.design), None)
    if best is not None:
        sizes = changed(best.candidate)
        rated += _rate_all(machine, causes, sizes, progress, workers)
        found = _in_order(causes, rated)
    if not found.possible:
        raise UserError(f'no experiment can be run with these causes: {rated[0].impossible}')
    if found.best is None:
        found = replace(found, instead=tuple(_instead(machine, found)))
    return found


def _pairs(causes: Sequence[Cause]) -> tuple[Pair, ...]:
    return tuple((true.name, rival.name) for true, rival in permutations(causes, 2))


def _in_order(causes: Sequence[Cause], rated: Sequence[Rated]) -> Suggestion:
    """Return candidates by how many of the pairs that count they were asked, then by evidence."""
    counted = Suggestion(tuple(causes), tuple(rated)).counted

    def place(item: Rated) -> tuple[bool, int, float, str]:
        asked = sum(pair in item.separations for pair in counted)
        return bool(item.impossible), -asked, -item.evidence(counted), item.candidate.label

    return Suggestion(tuple(causes), tuple(sorted(rated, key=place)))


def _rate_all(
    machine: Machine,
    causes: Sequence[Cause],
    candidates: Sequence[Candidate],
    progress: Progress,
    workers: int,
) -> list[Rated]:
    """
    Return the candidates, rated; the same for any number of workers.

    One cause after another is the true one. After each, candidates are given up that do not tell it from
    a rival from which others tell it, unless nothing would be left. Where the others do not tell it from
    a rival, those given up are asked, too.
    """
    found = [Rated(item, {}) for item in candidates]
    alive = list(range(len(found)))
    pool = Parallel(n_jobs=workers, return_as='generator')
    finished = 0

    def ask(
        places: Sequence[int], true: Cause, rivals: Sequence[Cause], later: int
    ) -> list[Cause]:
        """Rate candidates; return the rivals from which none of them tells the true cause."""
        nonlocal finished
        jobs = (delayed(_rate)(machine, true, rivals, found[place]) for place in places)
        end = finished + len(places)
        for place, one in zip(places, pool(jobs), strict=True):
            found[place] = one
            finished += 1
            progress(finished, end + later)
        return [
            rival
            for rival in rivals
            if not any(
                found[place].tells((true.name, rival.name))
                for place in places
                if not found[place].impossible
            )
        ]

    for number, true in enumerate(causes):
        rivals = [rival for rival in causes if rival is not true]
        trues_left = len(causes) - number - 1
        untold = ask(alive, true, rivals, trues_left * len(alive))
        given_up = [
            place for place, item in enumerate(found) if place not in alive and not item.impossible
        ]
        if untold and given_up:
            ask(given_up, true, untold, trues_left * len(alive))
        alive = [place for place in alive if not found[place].impossible]
        told = [(true.name, rival.name) for rival in rivals if rival not in untold]
        alive = [
            place for place in alive if all(found[place].tells(pair) for pair in told)
        ] or alive
    return found


def _rate(machine: Machine, true: Cause, rivals: Sequence[Cause], rated: Rated) -> Rated:
    """Return a candidate that was asked about these rivals, too."""
    try:
        new = separations(machine, true, rivals, rated.candidate.experiment)
    except UserError as error:
        return replace(rated, impossible=str(error))
    named = {(true.name, rival.name): one for rival, one in zip(rivals, new, strict=True)}
    limit = '' if new[0].load.possible else f'beyond the limits of {new[0].load.axis}'
    return replace(rated, separations={**rated.separations, **named}, impossible=limit)


def _instead(machine: Machine, found: Suggestion) -> list[str]:
    """Return what else would tell the causes apart."""
    most = found.possible[0].candidate
    said = []
    if machine.without:
        whole = replace(machine, without=())
        pairs = _pairs(found.causes)
        rated = _rate_all(whole, found.causes, [most], lambda done, total: None, 1)
        evidence = rated[0].evidence(pairs)
        if evidence >= TELLS_APART:
            said.append(
                f'log {", ".join(machine.without)} as well: with that, {most.label} is expected to '
                f'give 2 ln L = {evidence:.0f}'
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
    refitted = separations(machine, first, [second], candidate.experiment)[0].refitted
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
        rows.append(twin.plant_state[0]['position'][: len(twin.machine.coordinates)].copy())
    return dict(zip(twin.machine.coordinates, np.array(rows).T, strict=True))
