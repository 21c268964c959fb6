# SPDX-License-Identifier: Apache-2.0
"""
Rounds of screening: all candidates, again and again, beside the causes that are known by then.

What a candidate promises depends on the blocks that it changes and on the causes known there, on nothing
else: a wrong gain leaves what the plant leaves over as it was. So each candidate is screened, and each
line in the spectrum tried, once for the causes of its blocks, however many rounds there are.

Signatures are found once, beside the causes known at first. In blocks where others are known by then,
those of the most promising candidates are found anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from waferbot_twin.diagnosis.hypothesis import Hypothesis, signature
from waferbot_twin.diagnosis.jointly import Signature
from waferbot_twin.diagnosis.position_tones import at_periods
from waferbot_twin.diagnosis.problem import PLANT, Cause, Problem
from waferbot_twin.diagnosis.resonances import screen_lines
from waferbot_twin.diagnosis.screening import Change, Progress, Screened, screen, signatures
from waferbot_twin.diagnosis.tones import at_tones

ANEW = 30
"""How many signatures are found anew once a cause is known."""

_Values = tuple[str, tuple[tuple[str, float], ...]]
"""A cause by name and values."""

_Asked = tuple[bool, _Values, tuple[_Values, ...]]
"""A candidate, whether its signature was found anew, and the causes known in the blocks it changes."""


class Rounds:
    """The candidates of a search, with all that has been found out about them."""

    def __init__(
        self,
        problem: Problem,
        base: Hypothesis,
        candidates: Sequence[Cause],
        progress: Progress,
        workers: int,
    ) -> None:
        """Find what every candidate changes beside the causes of `base`."""
        self._problem, self._progress, self._workers = problem, progress, workers
        self._candidates = candidates
        self._beside = base.causes
        self._changes = dict(
            zip(
                map(_values, candidates),
                signatures(problem, base, candidates, workers, progress),
                strict=True,
            )
        )
        self._screened: dict[_Asked, Screened | None] = {}
        self._of_base: dict[tuple[_Values, ...], list[Signature]] = {}
        self._at_lines: dict[tuple[_Values, ...], list[Screened]] = {}

    def screen(self, base: Hypothesis) -> list[Screened]:
        """Return what is not yet among the causes of `base`, each with its linear fit, best first."""
        problem = self._problem
        taken = {cause.name for cause in base.causes}
        rivals = [cause for cause in self._candidates if cause.name not in taken]
        screened = self._promises(base, rivals, self._as_found_at_first, anew=False)
        changed = self._changed(base.causes)
        stale = {
            item.cause.name
            for item in screened
            if changed.intersection(problem.touched(item.cause.effect, item.cause.axis))
        }
        kept = [item for item in screened if item.cause.name not in stale]
        again = [item.cause for item in screened if item.cause.name in stale][:ANEW]

        def found_anew(causes: Sequence[Cause]) -> list[Change | None]:
            return signatures(problem, base, causes, self._workers, self._progress)

        tuned = [*at_tones(problem, base, rivals), *at_periods(problem, base, rivals)]
        return _best_first(
            [
                *self._promises(base, again, found_anew, anew=True),
                *kept,
                *self._promises(base, tuned, found_anew, anew=True),
                *(item for item in self._lines(base, rivals) if item.cause.name not in taken),
            ]
        )

    def _promises(
        self,
        base: Hypothesis,
        rivals: Sequence[Cause],
        changes_of: Callable[[Sequence[Cause]], list[Change | None]],
        anew: bool,
    ) -> list[Screened]:
        """Return rivals with their linear fits beside the causes of `base`, best first."""
        asked = [(anew, _values(rival), self._known_beside(base, rival)) for rival in rivals]
        unknown = {
            key: rival
            for key, rival in zip(asked, rivals, strict=True)
            if key not in self._screened
        }
        if unknown:
            causes = list(unknown.values())
            found = screen(
                self._problem, base, causes, changes_of(causes), self._signatures_of(base)
            )
            by_values = {_values(item.cause): item for item in found}
            self._screened |= {key: by_values.get(_values(unknown[key])) for key in unknown}
        known = (self._screened[key] for key in asked)
        return _best_first(item for item in known if item is not None)

    def _signatures_of(self, base: Hypothesis) -> list[Signature]:
        """Return what the causes of `base` themselves change."""
        key = tuple(map(_values, base.causes))
        if key not in self._of_base:
            self._of_base[key] = [
                signature(self._problem, base, base.causes, place)
                for place in range(len(base.causes))
            ]
        return self._of_base[key]

    def _as_found_at_first(self, causes: Sequence[Cause]) -> list[Change | None]:
        return [self._changes[_values(cause)] for cause in causes]

    def _lines(self, base: Hypothesis, rivals: Sequence[Cause]) -> list[Screened]:
        """Return what may have made the lines in what the plant leaves over."""
        key = self._known_in(base, {PLANT})
        if key not in self._at_lines:
            self._at_lines[key] = screen_lines(self._problem, base, rivals, self._workers)
        return self._at_lines[key]

    def _known_beside(self, base: Hypothesis, rival: Cause) -> tuple[_Values, ...]:
        return self._known_in(base, set(self._problem.touched(rival.effect, rival.axis)))

    def _known_in(self, base: Hypothesis, blocks: set[str]) -> tuple[_Values, ...]:
        """Return the causes of `base` that change any of some blocks."""
        return tuple(
            _values(cause)
            for cause in base.causes
            if blocks.intersection(self._problem.touched(cause.effect, cause.axis))
        )

    def _changed(self, causes: Sequence[Cause]) -> set[str]:
        """Return the blocks in which other causes are known now than at first."""
        then, now = ({cause.name: cause for cause in some} for some in (self._beside, causes))
        others = [(then | now)[name] for name in sorted(then.keys() ^ now.keys())]
        return {
            block for cause in others for block in self._problem.touched(cause.effect, cause.axis)
        }


def _values(cause: Cause) -> _Values:
    return cause.name, tuple(sorted(cause.values.items()))


def _best_first(items: Iterable[Screened]) -> list[Screened]:
    return sorted(items, key=lambda item: (-item.score, item.cause.name))
