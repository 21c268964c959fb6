# SPDX-License-Identifier: Apache-2.0
"""
Named parameters, fitted through the simulation of the blocks.

The residuals of the blocks (`residuals.problem`) are made white as what is left of them tells
(`noise_model.residual_spectrum`), and the sum of their squares is made as small as can be; then
the colour is found anew, and so on. Added to it is a square for how far each parameter is from the
model's value, in half ranges. It is as nothing beside what signals say, and where they say nothing,
parameters stay where the model has them.

The covariance is that of the linear problem at the end (`conditioning`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.estimation.known_values import Known, disagree, together
from waferbot_twin.identification.conditioning import Conditioning, conditioning
from waferbot_twin.identification.named_parameters import MODEL, NamedParameter
from waferbot_twin.identification.solving import least_squares
from waferbot_twin.noise_model.residual_spectrum import Whitening
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

STEP = 2e-3
"""Step of the difference quotients, in scaled values."""

ROUNDS = 6
"""Most often that the whitening is found anew."""

SETTLED = 0.1
"""Change, in standard errors, below which another round is not worth its time."""

EVALUATIONS = 12
"""Most simulations of one fit with the same whitening, those for derivatives not counted."""

TOLERANCE = 1e-7
"""Relative change of squares or values at which one fit is done."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Estimate:
    """
    Fitted parameters.

    `scaled` values (k,), what the signals say about them, and the model `before` and `after` with its
    residuals. `blocks` are those in which the parameters show.
    """

    parameters: tuple[NamedParameter, ...]
    scaled: Array
    conditioning: Conditioning
    blocks: tuple[str, ...]
    before: Hypothesis
    after: Hypothesis
    settled: bool

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The parameters as what is laid over the model."""
        return _causes(self.parameters, self.scaled)

    def variant(self, nominal: Variant) -> Variant:
        """Return the model with the fitted values."""
        return apply_all(nominal, self.causes)


def estimate(
    problem: Problem,
    parameters: Sequence[NamedParameter],
    progress: Progress,
    workers: int = 1,
) -> Estimate:
    """
    Return the parameters that make the logs most likely; so many simulations run side by side.

    Raises `UserError` if nothing in the logs shows any of them, or if the model cannot be simulated
    with the values that it begins with.
    """
    scaled: Array = np.zeros(len(parameters))
    before = after = evaluate(problem, _causes(parameters, scaled), workers)
    settled = False
    for done in range(ROUNDS):
        progress(done, ROUNDS)
        better, errors = _Fitting(problem, parameters, after, workers).least_squares(scaled)
        settled = bool(np.all(np.abs(better - scaled) < SETTLED * errors))
        scaled = better
        after = evaluate(problem, _causes(parameters, scaled), workers)
        if settled:
            break
    fitting = _Fitting(problem, parameters, after, workers)
    return Estimate(
        tuple(parameters),
        scaled,
        fitting.conditioning(scaled),
        fitting.blocks,
        before,
        after,
        settled,
    )


def with_known(
    problem: Problem, found: Estimate, known: Mapping[str, Known]
) -> tuple[Estimate, list[str]]:
    """
    Return an estimate with values known from other logs of the machine, by path, and what to tell.

    They take part as readings do; what differs by more than chance is left out (`known_values`). Raises
    `UserError` if the model cannot be simulated with what comes out.
    """
    covariance = found.conditioning.covariance
    places: list[int] = []
    taken: list[Known] = []
    notes: list[str] = []
    for place, parameter in enumerate(found.parameters):
        if parameter.path not in known:
            continue
        here = known[parameter.path]
        told = f'{parameter.path} was {here.value:.5g} +- {here.error:.2g} ({here.origin})'
        scaled = _scaled(parameter, here)
        if scaled is None:
            notes.append(f'{told}, out of its range here; that is left out')
        elif disagree(scaled, float(found.scaled[place]), float(covariance[place, place])):
            notes.append(
                f'{told}; these logs contradict that, so it is left out: what has changed?'
            )
        else:
            notes.append(f'{told}; that took part')
            places.append(place)
            taken.append(scaled)
    if not taken:
        return found, notes
    better, covariance = together(found.scaled, covariance, places, taken)
    values = np.array([held(*pair) for pair in zip(found.parameters, better, strict=True)])
    after = evaluate(problem, _causes(found.parameters, values))
    conditioned = replace(found.conditioning, covariance=covariance)
    return replace(found, scaled=values, conditioning=conditioned, after=after), notes


def _scaled(parameter: NamedParameter, known: Known) -> Known | None:
    """Return a known value as that of the scaled parameter; None if it is out of its range."""
    if not parameter.low <= known.value <= parameter.high:
        return None
    per_unit = (
        1.0 / abs(known.value) if parameter.logarithmic else 2.0 / (parameter.high - parameter.low)
    )
    return Known(parameter.scaled(known.value), known.error * per_unit, known.origin)


class _Fitting:
    """The least-squares problem of some parameters, with noise of the colour that a hypothesis has."""

    def __init__(
        self,
        problem: Problem,
        parameters: Sequence[NamedParameter],
        now: Hypothesis,
        workers: int,
    ) -> None:
        self.problem = problem
        self.workers = workers
        self.parameters = tuple(parameters)
        self.half_ranges = np.array([parameter.half_range for parameter in parameters])
        touched = [problem.touched(parameter.cause(0.0).effect, MODEL) for parameter in parameters]
        seen = {block for blocks in touched for block in blocks}
        self.blocks = tuple(block for block in problem.blocks if block in seen)
        if not self.blocks:
            names = ', '.join(parameter.path for parameter in parameters)
            raise UserError(f'these logs have no signal that could show {names}')
        self._touched = [[block for block in self.blocks if block in blocks] for blocks in touched]
        self._whitening = {
            block: Whitening(now.fits[block], now.residuals[block]) for block in self.blocks
        }
        self._lengths = {
            block: sum(map(len, self._whitening[block](now.residuals[block])))
            for block in self.blocks
        }

    def residual(self, scaled: Array, blocks: Sequence[str], workers: int = 1) -> Array:
        """Return the white residuals of some blocks, stacked; raises `UserError`."""
        variant = apply_all(self.problem.nominal, _causes(self.parameters, scaled))
        return np.concatenate(
            [
                white
                for block in blocks
                for white in self._whitening[block](
                    self.problem.residuals(variant, block, workers)
                )
            ]
        )

    def jacobian(self, scaled: Array, step: float) -> Array:
        """Return the derivatives of the white residuals by central differences, (N, k)."""
        ends = [
            self._ends(scaled, place, max(step, parameter.resolution))
            for place, parameter in enumerate(self.parameters)
        ]
        tasks = [(place, end) for place, both in enumerate(ends) for end in both]
        # Simulations let other threads run. To a cluster's workers the logs are sent once to each.
        parts = [tasks[first :: self.workers] for first in range(min(self.workers, len(tasks)))]
        found = Parallel(n_jobs=self.workers, prefer='threads')(
            delayed(_changed_residuals)(self, part) for part in parts
        )
        residuals = [found[task % len(parts)][task // len(parts)] for task in range(len(tasks))]
        return np.column_stack(
            [
                self._column(place, ends[place], residuals[2 * place], residuals[2 * place + 1])
                for place in range(len(ends))
            ]
        )

    def changed_residual(self, place: int, scaled: Array) -> dict[str, Array]:
        """Return the white residuals by block, of those in which a parameter shows."""
        return {block: self.residual(scaled, [block]) for block in self._touched[place]}

    def _ends(self, scaled: Array, place: int, step: float) -> tuple[Array, Array]:
        """Return the scaled values with one of them a step higher, and a step lower."""
        ahead, back = scaled.copy(), scaled.copy()
        for end, side in ((ahead, step), (back, -step)):
            end[place] = held(self.parameters[place], scaled[place] + side)
        return ahead, back

    def _column(
        self,
        place: int,
        ends: tuple[Array, Array],
        ahead: dict[str, Array],
        back: dict[str, Array],
    ) -> Array:
        """Return a column of the Jacobian: zeros in blocks in which the parameter does not show."""
        width = ends[0][place] - ends[1][place]
        return np.concatenate(
            [
                (ahead[block] - back[block]) / width
                if block in ahead
                else np.zeros(self._lengths[block])
                for block in self.blocks
            ]
        )

    def least_squares(self, scaled: Array) -> tuple[Array, Array]:
        """Return the best scaled values, and their standard errors."""

        def residual(tried: Array) -> Array:
            white = self.residual(tried, self.blocks, self.workers)
            return np.concatenate([white, tried / self.half_ranges])

        def derivative(tried: Array) -> Array:
            return np.vstack([self.jacobian(tried, STEP), np.diag(1.0 / self.half_ranges)])

        low, high = np.array([parameter.scaled_range for parameter in self.parameters]).T
        best, jacobian = least_squares(
            residual, derivative, scaled, (low, high), EVALUATIONS, TOLERANCE
        )
        found = [held(*pair) for pair in zip(self.parameters, best, strict=True)]
        return np.array(found), np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))

    def conditioning(self, scaled: Array) -> Conditioning:
        """Return what the logs say about the parameters where they are."""
        fine, coarse = (self.jacobian(scaled, step) for step in (STEP, 2.0 * STEP))
        # The error of a central difference grows with the square of its step.
        return conditioning(fine, (coarse - fine) / 3.0, list(self.half_ranges))


def _changed_residuals(
    fitting: _Fitting, tasks: Sequence[tuple[int, Array]]
) -> list[dict[str, Array]]:
    return [fitting.changed_residual(place, end) for place, end in tasks]


def held(parameter: NamedParameter, scaled: float) -> float:
    """Return the scaled value that the model can hold: within the range, whole where it must be."""
    return parameter.scaled(parameter.value(scaled))


def _causes(parameters: Sequence[NamedParameter], scaled: Array) -> tuple[Cause, ...]:
    return tuple(
        parameter.cause(float(value)) for parameter, value in zip(parameters, scaled, strict=True)
    )
