# SPDX-License-Identifier: Apache-2.0
"""
Screening: every effect of the library on every axis, fitted linearly to what is left over.

The signature of an effect, what a little of it changes in the residuals, comes from the simulation
itself, so a new effect needs no formula of its own here. The plant takes steps of the encoders'
cycle for it (`Problem.quick`). Signatures are found once, with the causes that were known then; a
later round finds anew only those that look most likely.

An effect that changes the structure of a machine as soon as there is any of it, and only then
grows in proportion, begins where there is a little: the linear problem is about the model with that
little, with its own noise.

An effect with a threshold changes nothing while there is little of it. It is tried on a
`threshold_grid`, and its signature is the whole of what it changes there, as it is or fitted with a
factor; so is that of an effect whose size the logs show themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.repetition import can_repeat, repeats_in
from waferbot_twin.diagnosis.proposals.threshold_grid import rungs
from waferbot_twin.effects.effect import Effect, Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain, log_occam
from waferbot_twin.estimation.gauss_newton import least_squares_within
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    away_from_bounds,
    changed_by,
    evaluate,
    in_quick_steps,
    lets_go,
    log_likelihood_ratios,
    parameters_of,
    signature,
    whole_change,
)
from waferbot_twin.estimation.size_prior import (
    away_from_neutral,
    posterior_covariance,
    precision_at,
    scales_of,
)
from waferbot_twin.estimation.stacked_least_squares import (
    Signature,
    by_channel,
    fit_jointly,
    side_by_side,
)
from waferbot_twin.noise_model.gram import spanning
from waferbot_twin.noise_model.leverage import Leverage, sums_of
from waferbot_twin.noise_model.power import Power, WholePower
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import (
    log_likelihood_ratios_in,
    powers_along,
    together,
)
from waferbot_twin.residuals.problem import PRIOR, Cause, Problem
from waferbot_twin.residuals.record import Array

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much is done and how much there is."""


def stage(what: str, causes: Sequence[Cause]) -> str:
    """Return the name of what is being done beside causes that were found by then, for who waits."""
    count = len(causes)
    return f'{what} beside {count} cause{"s" * (count > 1)}' if count else what


PARTS = 4
"""In how many parts each worker takes candidates: to send the logs takes as long as to simulate some."""


Values = tuple[str, tuple[tuple[str, float], ...]]
"""A cause by name and values: an effect that went to a worker and back is not the same any more."""


@dataclass(frozen=True)
class Change:
    """
    What a candidate changes in the residuals: a `signature` by block, as in `stacked_least_squares`.

    Of one that begins where there is a little, `begun` is the model with that, about which the
    signature is, with its own noise: a part that lets go changes what an observer follows. `gained`
    is by how much, in 2 ln L, each channel (block and number) is likelier than in the model without.
    Where all are likelier together that is no work of the candidate, and left out
    (`hypothesis.with_next_to_none`). Of most there is none.

    `own` is what one that lets a part go gains as it is, in the noise that is left with it, beside the
    causes `beside`; or a tone at `value`, which without it is the colour of the noise.
    """

    signature: Signature
    begun: Hypothesis | None = None
    gained: Mapping[tuple[str, int], float] = field(default_factory=dict)
    own: Gain | None = None
    beside: tuple[Values, ...] = ()
    value: Array | None = None


@dataclass(frozen=True)
class Screened:
    """
    A candidate with its linear fit.

    `score` is ln BF against none of it; `value` the change of its parameters from where they are.
    `likelihood` is ln BF in noise whose power is known: it ranks candidates of which all are
    beyond doubt.
    """

    cause: Cause
    score: float
    value: Array
    likelihood: float


def candidates(
    problem: Problem,
    effects: Iterable[Effect],
    axes_of: Callable[[Effect, Variant], Sequence[str]] = Effect.distinct_axes,
) -> list[Cause]:
    """
    Return every effect on every axis where the logs could show it, with none of it yet.

    `axes_of` says on which axes of the nominal model an effect is tried: where no other effect does
    exactly the same, if nothing else is said.
    """
    found: list[Cause] = []
    for effect in effects:
        for axis in axes_of(effect, problem.nominal):
            if not problem.touched(effect, axis):
                continue
            parameters = effect.parameters(problem.nominal, axis)
            held = tuple(item.name for item in parameters if item.fixed)
            for trial in effect.trials(problem.nominal, axis):
                values = {
                    item.name: trial.get(
                        item.name,
                        item.typical
                        if item.shape
                        else item.neutral + effect.begins_at * (item.typical - item.neutral),
                    )
                    for item in parameters
                }
                cause = Cause(effect, axis, values, held)
                if not (can_repeat(problem, cause) and repeats_in(problem, cause)):
                    continue
                sized = any(not item.shape and item.name in trial for item in parameters)
                found += rungs(problem, cause) if effect.threshold and not sized else [cause]
                found += at_its_sizes(parameters, cause)
    return found


def indistinct_axes(effect: Effect, variant: Variant) -> tuple[str, ...]:
    """Return the axes where other effects do exactly what this one does, for `candidates`."""
    distinct = effect.distinct_axes(variant)
    return tuple(axis for axis in effect.axes(variant) if axis not in distinct)


def at_its_sizes(parameters: Sequence[Parameter], cause: Cause) -> Iterator[Cause]:
    """Give an effect that the model has none of in the sizes at which it is tried."""
    for times in cause.effect.tried_at:
        values = {
            item.name: min(item.typical * times, item.high)
            for item in parameters
            if item.neutral == 0.0 and not item.shape
        }
        if values:
            yield cause.with_values(values)


def signatures(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    workers: int,
    progress: Progress,
) -> list[Change | None]:
    """
    Return what every rival changes beside the causes of `base`.

    None for one with which the simulation blows up.
    """
    quick, begun = in_quick_steps(problem, base)
    size = math.ceil(len(rivals) / (PARTS * workers)) or 1
    chunks = [rivals[first : first + size] for first in range(0, len(rivals), size)]
    found: list[Change | None] = []
    pool = Parallel(n_jobs=workers, return_as='generator')
    for part in pool(delayed(_signatures)(quick, begun, chunk) for chunk in chunks):
        found += part
        progress(stage('screening', base.causes), len(found), len(rivals))
    return found


def _signatures(
    problem: Problem, base: Hypothesis, rivals: Sequence[Cause]
) -> list[Change | None]:
    found: list[Change | None] = []
    for rival in rivals:
        causes = (*base.causes, rival)
        try:
            change = _change(problem, base, causes)
        except UserError:
            found.append(None)
            continue
        sound = all(np.isfinite(matrix).all() for matrix in change.signature.values())
        found.append(change if sound else None)
    return found


def _change(problem: Problem, base: Hypothesis, causes: tuple[Cause, ...]) -> Change:
    """Return what the last of `causes` changes; raises `UserError` if the simulation blows up."""
    rival = causes[-1]
    blocks = problem.touched(rival.effect, rival.axis)
    if _tried_as_a_whole(problem, rival):
        change = whole_change(problem, base, causes)
        if not lets_go(problem, base.causes, rival):
            return Change(change)
        return Change(
            change,
            own=_in_own_noise(problem, base, change),
            beside=that_touch(problem, base.causes, blocks),
        )
    if rival.effect.begins_at == 0.0:
        slopes = signature(problem, base, causes, len(causes) - 1)
        return _as_a_tone(problem, base, slopes) if rival.narrow else Change(slopes)
    begun = evaluate(problem, causes)
    # The residuals of `base` are those of longer steps, its noise is not.
    judged = problem.judge({block: base.residuals[block] for block in blocks})
    without = replace(base, fits={**base.fits, **judged})
    gained = {
        (block, number): 2.0 * ratio
        for block in blocks
        for number, ratio in enumerate(log_likelihood_ratios(begun, without, block))
    }
    return Change(
        signature(problem, begun, causes, len(causes) - 1),
        begun,
        gained if sum(gained.values()) < 0.0 else {},
    )


def _as_a_tone(problem: Problem, base: Hypothesis, slopes: Signature) -> Change:
    """
    Return what a tone changes, with its size in the noise that is left with it.

    A tone is predictable, so the noise of the model without has its colour, and hides most of it.
    """
    value = fit_jointly(problem, base.residuals, slopes).value
    change = {block: (matrix @ value)[:, None] for block, matrix in slopes.items()}
    beside = that_touch(problem, base.causes, slopes)
    return Change(slopes, own=_in_own_noise(problem, base, change), beside=beside, value=value)


def _in_own_noise(problem: Problem, base: Hypothesis, change: Signature) -> Gain:
    """Return what a change gains where the model with it, and the one without, have their own noise."""
    nothing = {block: np.zeros_like(part) for block, part in change.items()}
    # The residuals of `base` are those of longer steps, its noise is not.
    without, as_it_is = (changed_by(problem, base.residuals, one) for one in (nothing, change))
    return Gain(gain(as_it_is, without), gain(as_it_is, without, power_known=True))


def values_of(cause: Cause) -> Values:
    """Return a cause by name and values."""
    return cause.name, tuple(sorted(cause.values.items()))


def that_touch(
    problem: Problem, causes: Iterable[Cause], blocks: Iterable[str]
) -> tuple[Values, ...]:
    """Return those of some causes that change any of some blocks."""
    blocks = set(blocks)
    return tuple(
        values_of(cause)
        for cause in causes
        if not blocks.isdisjoint(problem.touched(cause.effect, cause.axis))
    )


def screen(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    of_rivals: Sequence[Change | None],
    of_base: Sequence[Signature],
    scales: Sequence[float],
    workers: int = 1,
) -> list[Screened]:
    """
    Return the evidence for every rival beside the causes of `base`, in a linear problem; best
    first.

    `scales` are those of the prior of sizes (`estimation.evidence`).
    """
    alike: dict[tuple[str, ...], list[tuple[Cause, Change]]] = {}
    for rival, change in zip(rivals, of_rivals, strict=True):
        if change is not None:
            alike.setdefault(tuple(change.signature), []).append((rival, change))
    # What is known in some blocks is prepared once for all candidates that a worker takes.
    chunks = [
        asked[first::workers]
        for asked in alike.values()
        for first in range(min(workers, len(asked)))
    ]
    pool = Parallel(n_jobs=workers if len(chunks) > 1 else 1)
    parts = pool(delayed(_screen)(problem, base, chunk, of_base, scales) for chunk in chunks)
    found = [item for part in parts for item in part]
    return sorted(found, key=lambda item: (-item.likelihood, item.cause.name))


@dataclass(frozen=True)
class Beside:
    """
    What the known causes of a model can still change beside a candidate, side by side.

    The signatures of parameters that are `free` either way, and of those at a bound (`held`), turned so
    that a positive value leads away from it.
    """

    free: Signature
    held: Signature

    @classmethod
    def of(cls, problem: Problem, base: Hypothesis, of_base: Sequence[Signature]) -> Beside:
        """Take what the causes of `base` change."""
        counts = [len(parameters_of(problem, cause)) for cause in base.causes]
        way = away_from_bounds(problem, base.causes)
        at_bound = way != 0.0
        together = side_by_side(of_base, counts)
        return cls(
            {block: matrix[:, ~at_bound] for block, matrix in together.items()},
            {block: matrix[:, at_bound] * way[at_bound] for block, matrix in together.items()},
        )


def _screen(
    problem: Problem,
    base: Hypothesis,
    asked: Sequence[tuple[Cause, Change]],
    of_base: Sequence[Signature],
    scales: Sequence[float],
) -> list[Screened]:
    together = Beside.of(problem, base, of_base)
    known: dict[tuple[str, ...], _Known] = {}
    found = []
    for rival, change in asked:
        shown = {block: matrix for block, matrix in change.signature.items() if matrix.any()}
        if not shown:
            continue
        blocks = tuple(
            dict.fromkeys([*shown, *(name for name in (PRIOR,) if name in together.free)])
        )
        if change.begun is not None:
            beside = _Known.of(change.begun, together, blocks)
        elif blocks in known:
            beside = known[blocks]
        else:
            beside = known[blocks] = _Known.of(base, together, blocks)
        linear = _Linear.of(beside, _white(change.begun or base, shown), change.gained)
        now = change.beside == that_touch(problem, base.causes, change.signature)
        if _tried_as_a_whole(problem, rival):
            item = linear.as_a_whole(rival, change.own if now else None)
        else:
            if now:
                linear = linear.as_a_tone(change)
            item = linear.with_values(problem, rival, scales)
        if item is not None:
            found.append(item)
    return found


ROUNDS = 8
"""How often the prior of a candidate's sizes is found about what they are with it."""

ALIKE = 0.5
"""Share of what a cause gains that a candidate gains in its place, to be what may be there instead."""


def alike(
    base: Hypothesis,
    own: Sequence[Signature],
    rivals: Sequence[tuple[Cause, Change]],
    beside: Beside,
) -> list[list[Cause]]:
    """
    Return which of the rivals can stand for each of some causes that change `own`, as a whole.

    With r the white residual without the cause, d what it takes away, and what known causes (`beside`)
    could explain taken out of both: those of whose signature the projection P makes at least a share of
    the cause's gain, and only without the cause,

        |P r|^2 - |P (r - d)|^2  >=  ALIKE (|r|^2 - |r - d|^2).

    What gains as much beside the cause is another one that lacks, and no rival. All causes change the
    same blocks.
    """
    blocks = tuple(dict.fromkeys([*own[0], *(name for name in (PRIOR,) if name in beside.free)]))
    known = _Known.of(base, beside, blocks)
    taken = [np.vstack(_in_places(known.places, known.before, _white(base, one))) for one in own]
    left = known.left[:, None]
    each = np.hstack([left, left - _without(np.hstack(taken), known.columns)])
    squares = np.sum(each**2, axis=0)
    least = ALIKE * (squares[0] - squares[1:])
    found: list[list[Cause]] = [[] for _ in own]
    for rival, change in rivals:
        signature = {block: part for block, part in change.signature.items() if block in own[0]}
        if not any(part.any() for part in signature.values()):
            continue
        rows = np.vstack(_in_places(known.places, known.before, _white(base, signature)))
        alone = _without(rows, known.columns)
        alone /= np.maximum(np.linalg.norm(alone, axis=0), 1e-300)
        moments = alone.T @ each
        sizes = np.linalg.lstsq(alone.T @ alone, moments, rcond=1e-10)[0]
        gained = np.sum(moments * sizes, axis=0)
        for place in np.flatnonzero((least > 0.0) & (gained[0] - gained[1:] >= least)):
            found[place].append(rival)
    return found


def similar(
    base: Hypothesis, own: Sequence[Signature], rivals: Sequence[tuple[Cause, Change]]
) -> list[Cause]:
    """
    Return which of the rivals do in one direction what a cause may do, by any of its signatures `own`.

    The largest cosine c between what the two can change, white as the residuals of `base` are, has

        c^2 >= ALIKE.

    What other causes could do of it is not taken out: so these are more than are `alike`.
    """
    blocks = tuple(own[0])
    spans = [_spanned(base, one, blocks) for one in own]
    found = []
    for rival, change in rivals:
        span = _spanned(base, change.signature, blocks)
        if any(np.linalg.norm(one.T @ span, 2) ** 2 >= ALIKE for one in spans if span.size):
            found.append(rival)
    return found


def _spanned(base: Hypothesis, signature: Signature, blocks: Sequence[str]) -> Array:
    """Return an orthonormal basis (N, r) of what a signature can change in some blocks."""
    places = [(name, n) for name in blocks for n in range(len(base.fits[name].whitened))]
    before = [base.fits[name].whitened[n] for name, n in places]
    own = {name: rows for name, rows in signature.items() if name in blocks}
    rows = np.vstack(_in_places(places, before, _white(base, own)))
    return np.asarray(rows @ spanning(rows.T @ rows))


_White = dict[str, list[Array]]
"""By block, the white signature of every channel: (N, k)."""


def _white(base: Hypothesis, signature: Signature) -> _White:
    """Return a signature filtered by the noise model of `base`."""
    return {
        block: in_deviations(base.fits[block].colours, by_channel(matrix, base.residuals[block]))
        for block, matrix in signature.items()
    }


@dataclass(frozen=True)
class _Known:
    """
    What is known in some blocks before a candidate is asked: white residuals of every channel.

    `places` are block and number of each channel, `before` its residual as it is, `left` that of all
    channels behind one another without what the known causes could explain: without its projection
    on their orthonormal `columns` (N, k). `held` (N, h) is what those at a bound could change beside
    these, each away from it only.
    """

    places: list[tuple[str, int]]
    colours: list[Colour]
    before: list[Array]
    left: Array
    columns: Array
    held: Array

    @classmethod
    def of(cls, about: Hypothesis, beside: Beside, blocks: tuple[str, ...]) -> _Known:
        """Take what a hypothesis leaves over, and what its causes change (`beside`)."""
        fits = [about.fits[block] for block in blocks]
        before = [white for fit in fits for white in fit.whitened]
        places = [(b, n) for b in blocks for n in range(len(about.fits[b].whitened))]

        def rows(signature: Signature) -> Array:
            own = {block: signature[block] for block in blocks if block in signature}
            return np.vstack(_in_places(places, before, _white(about, own)))

        def spanned(system: Array) -> Array:
            return np.asarray(system @ spanning(system.T @ system))

        columns, held = spanned(rows(beside.free)), rows(beside.held)
        residual = np.concatenate(before)
        moves = _away(_without(residual, columns), _without(held, columns))
        if moves.any():  # it was fitted roughly, and they are not at their bounds by right
            columns = spanned(np.hstack([columns, held[:, moves]]))
        colours = [one for fit in fits for one in fit.colours]
        return cls(
            places,
            colours,
            before,
            _without(residual, columns),
            columns,
            _without(held[:, ~moves], columns),
        )

    def giving_way(self, alone: Array) -> Array:
        """
        Return an orthonormal basis (N, j) of what is held, and moves away from its bound beside `alone`.

        `alone` (N, m) is what a candidate changes that the known causes could not.
        """
        if not self.held.shape[1]:
            return self.held
        moving = self.held[:, _away(self.left, self.held, alone)]
        return np.asarray(moving @ spanning(moving.T @ moving))

    def powers_along(self, left: Sequence[Array], changes: Sequence[Array]) -> list[Power]:
        """
        Return the power of the noise along changes, channel by channel, beside what is `left` over.

        Of usual deviations there are few, and how large they are follows from themselves
        (`residuals.prior_block`, equation (2)).
        """
        powers = powers_along(left, changes, self.colours, self.leverages)
        return [
            WholePower.of(one) if block == PRIOR else power
            for (block, _), one, power in zip(self.places, left, powers, strict=True)
        ]

    @cached_property
    def leverages(self) -> list[Leverage]:
        """Those of the known causes in every channel."""
        parts = self.split(self.columns)
        return [
            Leverage(sums_of(part, colour.block), colour.block)
            for part, colour in zip(parts, self.colours, strict=True)
        ]

    def split(self, rows: Array) -> list[Array]:
        """Return rows (N,) or (N, k) channel by channel."""
        return np.split(rows, np.cumsum([len(one) for one in self.before])[:-1])


def _away(left: Array, held: Array, alone: Array | None = None) -> NDArray[np.bool_]:
    """
    Return which columns of `held` (N, h) are more than zero in the fit to `left` (N,) by least squares.

    Of those with no value below zero, and of `alone` with any:

        min over x >= 0, w of |left + held x + alone w|^2.
    """
    system = held if alone is None else np.hstack([held, alone])
    products, count = system.T @ system, held.shape[1]
    directions = spanning(products)
    low = np.where(np.arange(len(products)) < count, 0.0, -np.inf)
    found = least_squares_within(
        directions.T @ products,
        -(directions.T @ (system.T @ left)),
        low,
        np.full(len(products), np.inf),
    )
    return np.asarray(found[:count] > 0.0)


def _in_places(
    places: Sequence[tuple[str, int]], channels: Sequence[Array], signature: _White
) -> list[Array]:
    """Return the rows of a signature in every channel; zeros in blocks that it does not change."""
    count = max((part.shape[1] for parts in signature.values() for part in parts), default=0)
    return [
        signature[block][number] if block in signature else np.zeros((len(channel), count))
        for (block, number), channel in zip(places, channels, strict=True)
    ]


def _without(rows: Array, columns: Array) -> Array:
    return np.asarray(rows - columns @ (columns.T @ rows))


@dataclass(frozen=True)
class Gain:
    """What a change gains in ln L, and in noise whose power is known (`Screened`)."""

    score: float
    likelihood: float

    @classmethod
    def of(
        cls,
        known: _Known,
        before: list[Array],
        left: list[Array],
        change: list[Array],
        already: Sequence[float],
    ) -> Gain:
        """Take what is left over without and with the change, and what had been gained before."""
        return cls.beside(known.powers_along(left, change), before, left, already)

    @classmethod
    def beside(
        cls,
        powers: Sequence[Power],
        before: list[Array],
        left: list[Array],
        already: Sequence[float],
    ) -> Gain:
        """Take the power of the noise along the change as well."""
        squares = [
            more + float(one @ one) - float(two @ two)
            for more, one, two in zip(already, before, left, strict=True)
        ]
        return cls(
            sum(log_likelihood_ratios_in(powers, squares)),
            sum(log_likelihood_ratios_in([power.as_if_known for power in powers], squares)),
        )

    def screened(self, rival: Cause, value: Array, occam: float) -> Screened:
        """Return a candidate with its evidence."""
        return Screened(rival, self.score + occam, value, self.likelihood + occam)


@dataclass(frozen=True)
class _Linear:
    """
    Least squares of white residuals on a candidate's signature beside that of the known causes.

    `value` (k,) of the candidate's parameters, what the logs say of them (`information`, (k, k)) in
    noise of the power along what the fit changes; what that `gains`, and what the candidate's signature
    as large as it is; `square` that of the whole signature over its power.
    """

    value: Array
    information: Array
    square: float
    fitted: Gain
    as_it_is: Gain

    @classmethod
    def of(cls, known: _Known, own: _White, gained: Mapping[tuple[str, int], float]) -> _Linear:
        """
        Fit `own` beside what is known, about a hypothesis which has `gained` so much already.

        By the theorem of Frisch, Waugh and Lovell: what known causes could explain is taken out of both
        sides, once for all candidates.
        """
        rows = np.vstack(_in_places(known.places, known.before, own))
        alone = _without(rows, known.columns)
        # What a candidate takes over lets parameters go back from the bounds that they have gone to.
        away = known.giving_way(alone)
        alone, left = _without(alone, away), _without(known.left, away)
        scale = np.linalg.norm(alone, axis=0)
        scale[scale == 0.0] = 1.0
        products = (alone / scale).T @ (alone / scale)
        inverse = np.linalg.pinv(products, rcond=1e-10, hermitian=True)
        value = -inverse @ ((alone / scale).T @ left) / scale
        after = left + alone @ value
        # Not what known causes could explain on their own, far from their best values.
        change = known.split(known.left - after)
        rest = known.split(after)
        powers = known.powers_along(rest, change)
        power = together(powers, change)
        first = [part[:, 0] for part in known.split(rows)]
        moved = [one + part for one, part in zip(known.before, first, strict=True)]
        already = [gained.get(place, 0.0) for place in known.places]
        return cls(
            value,
            products * np.outer(scale, scale) / power.value,
            sum(float(part @ part) for part in first) / power.value,
            Gain.beside(powers, known.split(known.left), rest, already),
            Gain.of(known, known.before, moved, first, [0.0] * len(moved)),
        )

    def as_a_whole(self, rival: Cause, own: Gain | None) -> Screened | None:
        """
        Return the evidence for a candidate whose signature is all that it changes at its values.

        `own` is its gain as it is in the noise that it leaves (`Change`).
        """
        as_it_is = max(self.as_it_is, own or self.as_it_is, key=lambda one: one.likelihood)
        better = as_it_is.likelihood > self.fitted.likelihood
        if self.value[0] <= 0.0 and not better:
            return None
        # Half of the steps that readings show themselves is not to be had.
        gained = as_it_is if better or rival.effect.evident else self.fitted
        return gained.screened(rival, np.zeros(rival.free), -0.5 * math.log1p(self.square))

    def as_a_tone(self, change: Change) -> _Linear:
        """Return the problem in the noise that is left with a tone (`Change`), where that gains more."""
        if change.value is None or change.own is None:
            return self
        if change.own.likelihood <= self.fitted.likelihood:
            return self
        return replace(self, value=change.value, fitted=change.own)

    def with_values(
        self, problem: Problem, rival: Cause, scales: Sequence[float]
    ) -> Screened | None:
        """
        Return the evidence for a candidate whose signature are slopes over its parameters.

        None if it asks for nothing that the bounds allow. That is asked of the values with the prior: of
        two of which the logs tell a difference only, without it both may be anywhere.
        """
        parameters = parameters_of(problem, rival)
        shown = [place for place in range(len(parameters)) if self.information[place, place] > 0.0]
        seen, known = (
            [parameters[place] for place in shown],
            self.information[np.ix_(shown, shown)],
        )
        found, begun = self.value[shown], away_from_neutral(rival, seen)
        pull, value = known @ found, self.value.copy()

        def at(change: Array) -> Cause:
            return rival.with_values(
                {
                    item.name: rival.values[item.name] + float(more)
                    for item, more in zip(seen, change, strict=True)
                }
            )

        scales = scales_of(problem, rival, scales)
        occam = log_occam(at(found), seen, known, scales)
        for _ in range(ROUNDS):
            prior = precision_at(at(found), seen, scales)
            found = posterior_covariance(known, prior) @ (pull - prior * begun)
        value[shown] = found
        return (
            self.fitted.screened(rival, value, occam) if _possible(problem, rival, value) else None
        )


def untempered(rival: Cause, evidence: float) -> Screened:
    """Return a candidate at its values with ln BF in noise as the noise model has it."""
    return Screened(rival, evidence, np.zeros(rival.free), evidence)


def _tried_as_a_whole(problem: Problem, rival: Cause) -> bool:
    """Return whether there is something of a candidate already, as a trial or on a rung."""
    return rival.effect.begins_at == 0.0 and any(
        not item.shape and rival.values[item.name] != item.neutral
        for item in rival.effect.parameters(problem.nominal, rival.axis)
    )


def _possible(problem: Problem, rival: Cause, value: Array) -> bool:
    """Return whether a linear estimate asks for anything that the bounds of the effect allow."""
    parameters = parameters_of(problem, rival)
    return any(
        not item.shape
        and np.clip(rival.values[item.name] + change, item.low, item.high) != item.neutral
        for item, change in zip(parameters, value, strict=True)
    )
