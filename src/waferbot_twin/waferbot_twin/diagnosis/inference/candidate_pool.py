# SPDX-License-Identifier: Apache-2.0
"""
Rounds of screening: all candidates, again and again, beside the causes that are known by then.

What a candidate promises depends on the blocks that it changes and on the causes known there, on nothing
else: a wrong gain leaves what the plant leaves over as it was. So each candidate is screened once for
the causes of its blocks, however many rounds there are, and lines in the spectrum are tried once while
they stay where they are.

Signatures are found once, beside the causes with which a search begins. In blocks where others are known
by then, that of the most promising trial of every name is found anew, and those of all that let a part
go: with one of these every other cause does something else. A search that begins with other causes
finds only those anew whose blocks these change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.nuisance import (
    each_once,
    in_place_of_bounds,
    is_nuisance,
)
from waferbot_twin.diagnosis.inference.refit import Refits, fitted
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect
from waferbot_twin.diagnosis.proposals.cogging_orders import (
    at_orders,
    has_orders,
    log_prior_of_orders,
)
from waferbot_twin.diagnosis.proposals.compliance_scan import held_rigid, screen_damped
from waferbot_twin.diagnosis.proposals.encoder_orders import at_periods
from waferbot_twin.diagnosis.proposals.periodogram import at_tones
from waferbot_twin.diagnosis.proposals.rings import Rings
from waferbot_twin.diagnosis.proposals.screening import (
    Beside,
    Change,
    Progress,
    Screened,
    Values,
    alike,
    candidates,
    indistinct_axes,
    screen,
    signatures,
    similar,
    that_touch,
    values_of,
)
from waferbot_twin.effects.effect import Effect
from waferbot_twin.estimation.conditional import conditional_errors
from waferbot_twin.estimation.gauss_newton import all_signatures
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    in_quick_steps,
    lets_go,
    parameters_of,
)
from waferbot_twin.estimation.noise_of_currents import LEAST_SQUARES
from waferbot_twin.estimation.stacked_least_squares import Signature
from waferbot_twin.residuals.problem import PLANT, Cause, Problem, apply_all

KEPT = 2
"""Of how many hypotheses the signatures are kept: tens of megabytes each in long logs."""

_Beside = tuple[Values, ...]
"""The causes that are known in the blocks that a candidate changes."""

_Asked = tuple[Values, _Beside, _Beside]
"""A candidate, what was known when its signature was found, and what is known now."""


@dataclass(frozen=True)
class Judged:
    """
    What the causes of one hypothesis are judged by, without any other candidate: for another process.

    `signatures` are those of its causes in their order, `priors` ln of their prior odds by name, of
    those with orders whatever these are.
    """

    problem: Problem
    settings: Settings
    priors: Mapping[str, float]
    signatures: Sequence[Signature]
    workers: int = 1

    def log_prior(self, cause: Cause) -> float:
        """Return ln of the prior odds of a cause against none."""
        return self.priors[cause.name] + log_prior_of_orders(self.problem.nominal, cause)

    def signatures_of(self, found: Hypothesis) -> Sequence[Signature]:
        """Return what the causes of the hypothesis change."""
        return self.signatures


class CandidatePool:
    """
    The candidates in logs, with all that has been found out about them.

    `names` has every `effect:axis` among the candidates for a cause, once; `dense` is the effect of
    many small deviations, which is fitted each time: a linear problem says little of so many. `revised`
    are the effects that were asked for anew, each with the names of the causes beside it, and
    `asked_beside` those beside which one effect more was asked for, with what was answered where that
    was not included; `rivals` are models that were weighed against the one that was found.
    """

    def __init__(
        self,
        problem: Problem,
        effects: Sequence[Effect],
        settings: Settings,
        progress: Progress,
        workers: int = 1,
    ) -> None:
        """Take the logs of `problem`, and every one of `effects` that they could show."""
        self.problem, self.effects, self.settings = problem, effects, settings
        self.progress, self.workers = progress, workers
        self.refits = Refits(problem, progress, workers)
        every = candidates(problem, effects)
        self.dense = [cause for cause in every if is_nuisance(cause)]
        self._candidates = [cause for cause in every if not is_nuisance(cause)]
        self._indistinct = candidates(problem, effects, indistinct_axes)
        self.names: list[str] = list(dict.fromkeys(cause.name for cause in self._candidates))
        ways: dict[str, set[tuple[float, ...]]] = {}
        for cause in self._candidates:
            ways.setdefault(cause.name, set()).add(
                tuple(cause.values[name] for name in cause.held)
            )
        # One way more is that it is none of them: what is held is then fitted.
        self._ways = {name: len(own) + (own != {()}) for name, own in ways.items()}
        largest = {cause.name: cause for cause in self._candidates}
        self._letting_go = {name for name, cause in largest.items() if lets_go(problem, (), cause)}
        self._beside: Sequence[Cause] = ()
        self._changes: dict[tuple[Values, _Beside], Change | None] = {}
        self._screened: dict[_Asked, Screened | None] = {}
        self._of_base: dict[frozenset[Hashable], dict[str, Signature]] = {}
        self._rings = Rings(problem, settings.most_refits, workers)
        self._damped: dict[_Beside, list[Screened]] = {}
        self.revised: set[tuple[str, frozenset[str]]] = set()
        self.asked_beside: dict[frozenset[str], SingleEffect | None] = {}
        self.rivals: list[Hypothesis] = []

    def log_prior(self, cause: Cause) -> float:
        """
        Return ln of the prior odds of a candidate against none.

        `expected_causes` over the number of candidates, and over the ways in which this one may be
        made (teeth, poles, a turn: one of its orders is true; or some of all that are looked for); even
        odds that a machine is a little off in everything.
        """
        return self._of_any_order(cause) + log_prior_of_orders(self.problem.nominal, cause)

    def _of_any_order(self, cause: Cause) -> float:
        """Return `log_prior` of a cause whatever orders it has."""
        if is_nuisance(cause):
            return 0.0
        ways = self._ways.get(cause.name, 1)
        return math.log(self.settings.expected_causes / (len(self.names) * ways))

    def begin(self, base: Hypothesis) -> None:
        """
        Find what every candidate changes beside the causes of `base`, as far as that is not known.

        What could not be more probable than none, whatever it changed, is left out.
        """
        self._beside = base.causes
        exact = set(self.problem.exact_blocks)
        # No cause can leave less than nothing over in a block that follows to the last bit.
        most = {
            block: 0.5 * sum(self.problem.less_likely_than_nothing(block, left).values())
            for block, left in base.residuals.items()
            if block in exact
        }

        def may_gain(cause: Cause) -> bool:
            blocks = self.problem.touched(cause.effect, cause.axis)
            return (
                not exact.issuperset(blocks)
                or sum(most[block] for block in blocks) + self.log_prior(cause) > 0.0
            )

        self._candidates = [cause for cause in self._candidates if may_gain(cause)]
        unknown = {
            key: candidate
            for candidate in (*self._candidates, *self.dense)
            if (key := self._at_first(candidate)) not in self._changes
        }
        found = signatures(self.problem, base, list(unknown.values()), self.workers, self.progress)
        self._changes |= zip(unknown, found, strict=True)

    def note_noise_of(self, found: Hypothesis) -> None:
        """Let every model have the noise of this one, too."""
        self.problem = self.problem.with_noise_of(found.fits)
        self.refits.problem = self._rings.problem = self.problem

    def leave_out(self, name: str) -> None:
        """Take a candidate out: what was asked for may be another one without it."""
        self.asked_beside.clear()
        self.rivals.clear()
        self._candidates = [cause for cause in self._candidates if cause.name != name]
        self._indistinct = [cause for cause in self._indistinct if cause.name != name]
        self.dense = [cause for cause in self.dense if cause.name != name]

    def usual(self) -> tuple[Cause, ...]:
        """Return the dense effect and `LEAST_SQUARES` on every axis, none of them there yet."""
        first: dict[str, Cause] = {}
        for cause in (*self.dense, *self._candidates):
            if is_nuisance(cause) or cause.effect.name in LEAST_SQUARES:
                first.setdefault(cause.name, cause)
        return tuple(first.values())

    def in_place_of_bounds(self, base: Hypothesis) -> list[Hypothesis]:
        """
        Return the causes of `base` with one more, last, for a number that is as far off as any may be.

        All fitted (`nuisance.in_place_of_bounds`); a linear problem does not see as far as they are.
        """
        first: dict[str, Cause] = {}
        for cause in self._candidates:
            first.setdefault(cause.name, cause)
        every = in_place_of_bounds(self.problem, base.causes, list(first.values()))
        pool = Parallel(n_jobs=self.workers if len(every) > 1 else 1)
        found = pool(delayed(fitted)(self.problem, causes, near=base) for causes in every)
        return [one for one in found if one is not None]

    def dense_beside(self, causes: Sequence[Cause]) -> tuple[Cause, ...]:
        """Return the dense effects that are not among some causes, without what these leave no say."""
        there = {cause.name for cause in causes}
        more = [cause for cause in self.dense if cause.name not in there]
        once = each_once(self.problem, (*causes, *more))[len(causes) :]
        return tuple(cause for cause in once if cause.free)

    def of_effect(self, name: str) -> tuple[Cause, ...]:
        """Return the candidates of an effect, one on each axis, none of them there yet."""
        own = {cause.name: cause for cause in self._candidates if cause.effect.name == name}
        return tuple(
            cause.with_values(
                {item.name: item.neutral for item in parameters_of(self.problem, cause)}
            )
            for cause in own.values()
        )

    def parts_that_may_give(self) -> tuple[Cause, ...]:
        """Return the compliances of what the model holds rigid, each as its description has it."""
        found: dict[str, Cause] = {}
        usual = [cause for cause in self._candidates if cause.effect.usual]
        for cause in held_rigid(self.problem, usual):
            sizes = {item.name: item.typical for item in parameters_of(self.problem, cause)}
            found.setdefault(cause.name, cause.with_values(sizes))
        return tuple(found.values())

    def screen_as_at_first(self, base: Hypothesis) -> list[Screened]:
        """
        Return what is not yet among the causes of `base`, each with its linear fit, best first.

        By what each changes beside the causes with which the search began: without a simulation.
        """
        rivals = self._not_among(base.causes)
        return self._promises(base, rivals, self._as_found_at_first, self._beside)

    def _not_among(self, causes: Sequence[Cause]) -> list[Cause]:
        """Return the candidates that are not among some causes."""
        taken = {cause.name for cause in causes}
        return [cause for cause in self._candidates if cause.name not in taken]

    def screen(self, base: Hypothesis) -> list[Screened]:
        """Return what is not yet among the causes of `base`, each with its linear fit, best first."""
        problem = self.problem
        taken = {cause.name for cause in base.causes}
        rivals = self._not_among(base.causes)
        screened = self.screen_as_at_first(base)
        changed = self._changed(base.causes)
        stale = {
            rival.name
            for rival in rivals
            if changed.intersection(problem.touched(rival.effect, rival.axis))
        }
        kept = [item for item in screened if item.cause.name not in stale]
        first: dict[str, Cause] = {}
        for cause in (*(item.cause for item in screened), *rivals):
            first.setdefault(cause.name, cause)
        again = [
            *(one for name, one in first.items() if name in stale - self._letting_go),
            *(one for one in rivals if one.name in stale & self._letting_go),
        ]

        def found_anew(causes: Sequence[Cause]) -> list[Change | None]:
            return signatures(problem, base, causes, self.workers, self.progress)

        told_apart = [one for one in self._told_apart(base) if one.name not in taken]
        tuned = [
            *at_tones(problem, base, rivals),
            *at_periods(problem, base, rivals),
            *at_orders(problem, base, {one.axis for one in rivals if has_orders(one)}),
        ]
        return _best_first(
            [
                *self._promises(base, again, found_anew, base.causes),
                *kept,
                *self._promises(base, [*told_apart, *tuned], found_anew, base.causes),
                *self._rings(base, rivals),
            ]
        )

    def with_orders(self, found: Hypothesis) -> list[Screened]:
        """
        Return the last cause of a hypothesis, cogging, with the orders that stand out beside the others.

        With linear fits, best first.
        """
        base = evaluate(self.problem, found.causes[:-1])
        tuned = at_orders(self.problem, base, {found.causes[-1].axis})
        changes = signatures(self.problem, base, tuned, self.workers, self.progress)
        return screen(
            self.problem,
            base,
            tuned,
            changes,
            self.signatures_of(found)[:-1],
            self.settings.prior_scales,
            self.workers,
        )

    def in_place_of(self, found: Hypothesis) -> list[Screened] | None:
        """
        Return what could be in place of the last cause of a hypothesis, with linear fits, best first.

        That is what gains what the cause does, in the linear problem beside the others
        (`screening.alike`). What each changes is found beside these, of all that may be alike: two that
        do the same there may not in the nominal model, by which that is asked first. None if the machine
        does not stand without the cause: nobody knows then.
        """
        problem, of_others = self.problem, self.signatures_of(found)[:-1]
        try:
            base = evaluate(problem, found.causes[:-1])
        except UserError:
            return None
        rivals, same = self._similar(base, found), self._same_beside(base, found.causes[-1])
        changes = signatures(problem, base, [*rivals, *same], self.workers, self.progress)
        by_rival = dict(zip(map(id, (*rivals, *same)), changes, strict=True))
        (alike,) = self._alike(base, [found], of_others, rivals, changes[: len(rivals)])
        near = [*alike, *same]
        return screen(
            problem,
            base,
            near,
            [by_rival[id(one)] for one in near],
            of_others,
            self.settings.prior_scales,
            self.workers,
        )

    def could_stand_for(self, base: Hypothesis, found: Sequence[Hypothesis]) -> list[list[Cause]]:
        """
        Return which candidates may stand for the last cause of each of some hypotheses.

        Each is `base` with one more cause, fitted; how far the others moved is taken out with what they
        could explain. As `in_place_of`, but by what they change in the nominal model, without a
        simulation.
        """
        of_others = self.signatures_of(base)
        near: list[list[Cause]] = [[] for _ in found]
        by_blocks: dict[tuple[str, ...], list[int]] = {}
        for place, one in enumerate(found):
            blocks = self.problem.touched(one.causes[-1].effect, one.causes[-1].axis)
            by_blocks.setdefault(tuple(blocks), []).append(place)
        for places in by_blocks.values():
            same = [found[place] for place in places]
            rivals = self._in_blocks_of(same[0].causes[-1], base.causes)
            changes = [self._changes[self._at_first(one)] for one in rivals]
            alike = self._alike(base, same, of_others, rivals, changes)
            for place, own in zip(places, alike, strict=True):
                last = found[place].causes[-1]
                others = [one for one in own if one.name != last.name]
                near[place] = [*others, *self._same_beside(base, last)]
        return near

    def _in_blocks_of(self, cause: Cause, there: Sequence[Cause]) -> list[Cause]:
        """Return the candidates, but what is there, that change a block which a cause changes."""
        blocks = set(self.problem.touched(cause.effect, cause.axis))
        taken = {one.name for one in there}
        return [
            one
            for one in (*self._candidates, *self.dense)
            if one.name not in taken
            and not blocks.isdisjoint(self.problem.touched(one.effect, one.axis))
        ]

    def _similar(self, base: Hypothesis, found: Hypothesis) -> list[Cause]:
        """
        Return the candidates that are `screening.similar` to the last cause of `found`.

        By what they and the cause change in the nominal model, and by what the cause changes now.
        """
        cause = found.causes[-1]
        own = [self._change_of_last(base, found)]
        for one in (*self._candidates, *self.dense):
            change = self._changes[self._at_first(one)] if one.name == cause.name else None
            if change is not None:
                own.append(change.signature)
        rivals = self._in_blocks_of(cause, found.causes)
        changes = [self._changes[self._at_first(one)] for one in rivals]
        known = [(one, did) for one, did in zip(rivals, changes, strict=True) if did is not None]
        return similar(base, own, known)

    def _change_of_last(self, base: Hypothesis, found: Hypothesis) -> Signature:
        """Return what the last cause of `found` takes away, as one column by block."""
        cause = found.causes[-1]
        return {
            block: np.concatenate(base.residuals[block])[:, None]
            - np.concatenate(found.residuals[block])[:, None]
            for block in self.problem.touched(cause.effect, cause.axis)
        }

    def _alike(
        self,
        base: Hypothesis,
        found: Sequence[Hypothesis],
        of_others: Sequence[Signature],
        rivals: Sequence[Cause],
        changes: Sequence[Change | None],
    ) -> list[list[Cause]]:
        """Return which rivals are `screening.alike` to the last cause of each `found`, beside `base`."""
        own = [self._change_of_last(base, one) for one in found]
        known = [(one, did) for one, did in zip(rivals, changes, strict=True) if did is not None]
        return alike(base, own, known, Beside.of(self.problem, base, of_others))

    def _same_beside(self, base: Hypothesis, cause: Cause) -> list[Cause]:
        """Return what does the same as a cause in the nominal model, and not beside those of `base`."""
        taken = {cause.name, *(one.name for one in base.causes)}
        return [
            one
            for one in self._told_apart(base)
            if one.axis == cause.axis
            and cause.effect.name in one.effect.same_as
            and one.name not in taken
        ]

    def _told_apart(self, base: Hypothesis) -> list[Cause]:
        """
        Return what does the same as something else in the nominal model, but not beside some causes.

        Friction and inertia before a drive are those of the axis, as long as the drive does not give.
        """
        if not self._indistinct:
            return []
        variant = apply_all(self.problem.nominal, base.causes)
        return [one for one in self._indistinct if one.axis in one.effect.distinct_axes(variant)]

    def _promises(
        self,
        base: Hypothesis,
        rivals: Sequence[Cause],
        changes_of: Callable[[Sequence[Cause]], list[Change | None]],
        beside: Sequence[Cause],
    ) -> list[Screened]:
        """
        Return rivals with their linear fits beside the causes of `base`, best first.

        What they change was found beside other causes.
        """
        asked = [
            (
                values_of(rival),
                self._that_touch(beside, rival),
                self._that_touch(base.causes, rival),
            )
            for rival in rivals
        ]
        unknown = {
            key: rival
            for key, rival in zip(asked, rivals, strict=True)
            if key not in self._screened
        }
        if unknown:
            causes = list(unknown.values())
            changes, of_base = changes_of(causes), self.signatures_of(base)
            scales = self.settings.prior_scales
            found = screen(self.problem, base, causes, changes, of_base, scales, self.workers)
            by_values = {values_of(item.cause): item for item in found}
            self._screened |= {key: by_values.get(values_of(unknown[key])) for key in unknown}
        known = (self._screened[key] for key in asked)
        return _best_first(item for item in known if item is not None)

    def signatures_of(self, base: Hypothesis) -> list[Signature]:
        """Return what the causes of `base` themselves change."""
        key = frozenset((values_of(cause), cause.held) for cause in base.causes)
        if key not in self._of_base:
            while len(self._of_base) >= KEPT:
                self._of_base.pop(next(iter(self._of_base)))
            quick, begun = in_quick_steps(self.problem, base)
            found = all_signatures(quick, begun, self.workers, errors=conditional_errors(base))
            names = [cause.name for cause in base.causes]
            self._of_base[key] = dict(zip(names, found, strict=True))
        return [self._of_base[key][cause.name] for cause in base.causes]

    def judged(self, found: Hypothesis) -> Judged:
        """Return what the causes of a hypothesis are judged by."""
        priors = {cause.name: self._of_any_order(cause) for cause in found.causes}
        return Judged(self.problem, self.settings, priors, self.signatures_of(found))

    def _as_found_at_first(self, rivals: Sequence[Cause]) -> list[Change | None]:
        return [self._changes[self._at_first(rival)] for rival in rivals]

    def _at_first(self, candidate: Cause) -> tuple[Values, _Beside]:
        return values_of(candidate), self._that_touch(self._beside, candidate)

    def damped_rings(self, base: Hypothesis) -> list[Screened]:
        """Return which compliances may make rings that no line shows, best first; slow."""
        key = self._in_plant(base)
        if key not in self._damped:
            rivals = self._not_among(base.causes)
            self._damped[key] = screen_damped(self.problem, base, rivals, self.workers)
        return _best_first(self._damped[key])

    def _in_plant(self, base: Hypothesis) -> _Beside:
        """Return the causes of `base` that change the plant alone."""
        return tuple(
            values_of(cause)
            for cause in base.causes
            if self.problem.touched(cause.effect, cause.axis) == (PLANT,)
        )

    def _that_touch(self, causes: Sequence[Cause], candidate: Cause) -> _Beside:
        """Return those of some causes that change any block that a candidate changes."""
        blocks = self.problem.touched(candidate.effect, candidate.axis)
        return that_touch(self.problem, causes, blocks)

    def _changed(self, causes: Sequence[Cause]) -> set[str]:
        """Return the blocks in which other causes are known now than at first."""
        then, now = ({cause.name: cause for cause in some} for some in (self._beside, causes))
        others = [(then | now)[name] for name in sorted(then.keys() ^ now.keys())]
        return {
            block for cause in others for block in self.problem.touched(cause.effect, cause.axis)
        }


def signatures_by_name(pool: CandidatePool | Judged, found: Hypothesis) -> dict[str, Signature]:
    """Return what the causes of a hypothesis themselves change, by their names."""
    names = [cause.name for cause in found.causes]
    return dict(zip(names, pool.signatures_of(found), strict=True))


def _best_first(items: Iterable[Screened]) -> list[Screened]:
    return sorted(items, key=lambda item: (-item.likelihood, item.cause.name))
