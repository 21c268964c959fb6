# SPDX-License-Identifier: Apache-2.0
"""
How well an experiment would tell two causes apart, found by simulating it.

The machine is simulated with cause A, once with noise, which gives its colour and size in every
signal, and once without, which is what an endless repetition would show. To that, cause B is fitted as
well as it can be. What is left then is laid on the noise, and how much likelier the noise alone is than
that is judged as the diagnosis does (`estimation.evidence.gain`). So twice this is the 2 ln L that a
diagnosis of such a log can be expected to find.

The other way round, with B in the machine, it is another number; only the smaller one can be relied on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import Experiment, commanded_positions
from waferbot_pmac.experiments.evaluation import MILLISECONDS
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.identification.solving import least_squares
from waferbot_twin.noise_model.prediction_error import Fit, prediction_errors
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array, Record
from waferbot_twin.synthesis import with_noise

Channels = dict[str, list[Array]]
"""Residuals of the channels of every block."""

TELLS_APART = 10.0
"""Difference in 2 ln L from which on an experiment tells two causes apart."""

ROUNDS = 2
"""How often the rival is fitted, each time with the whitening of what the last one left."""

STEP = 0.02
"""Step of the difference quotients of a fit, in shares of a parameter's typical value."""

EVALUATIONS = 8
"""Most simulations of one fit, those for derivatives not counted."""

MOST_SPEED, MOST_CURRENT = 1.1, 0.95
"""Shares of speed limit (a full stroke overshoots it a little) and peak current that may be used."""

TOLERANCE = 1e-4
"""Relative change of squares or values at which a fit is done."""

NOTHING_LEFT = 1.0
"""Sum of squares of what is left, in variances of the noise, below which no test could see anything."""


@dataclass(frozen=True)
class Machine:
    """
    What is to be found out about: a model, with what is known to be in it, and the noise of its logs.

    `variant` has room for the causes (`effects.host`), `level` is that of `synthesis.noise`, `without`
    names signals (as `synthesis.LEFT_OUT`) that its logs do not have.
    """

    variant: Variant
    level: float
    seed: int
    timing: Timing
    without: tuple[str, ...] = ()

    def record(self, signals: Signals) -> Record:
        """Return what of a run would be in a log."""
        record = record_of_signals('log', signals)
        terminals = record.terminals
        if 'currents' in self.without:
            terminals = None
        elif terminals is not None and 'voltages' in self.without:
            terminals = replace(terminals, voltage=None)
        return replace(
            record,
            terminals=terminals,
            commanded=None if 'commanded' in self.without else record.commanded,
            command=None if 'command' in self.without else record.command,
        )

    def run(self, causes: Sequence[Cause], experiment: Experiment, noisy: bool) -> Signals:
        """Return what a run with these causes would give; raises `UserError` if it is unstable."""
        variant = apply_all(self.variant, causes)
        if noisy:
            random = np.random.default_rng(self.seed)
            variant = with_noise(variant, self.variant, self.level, random)
        return self.twin(variant, experiment).advance(self.timing.ticks(experiment.duration_s))

    def twin(self, variant: Variant, experiment: Experiment) -> Twin:
        """Return the closed loop of a variant, ready for an experiment; raises `UserError`."""
        machine = built(variant, self.timing)
        twin = Twin(machine, variant.pmac, variant.copley, self.timing, variant.name)
        commanded = commanded_positions(
            experiment, twin.servo_parameters, self.timing.servo_hz, variant.description.axis_units
        )
        twin.command(commanded, variant.compensation, experiment.name)
        return twin


@dataclass(frozen=True)
class Load:
    """Largest speed and current of an axis in an experiment, in shares of their limits."""

    speed: float
    current: float
    axis: str

    @property
    def possible(self) -> bool:
        """Whether the machine can do it."""
        return self.speed <= MOST_SPEED and self.current <= MOST_CURRENT


@dataclass(frozen=True)
class Separation:
    """
    How an experiment tells a cause from a rival.

    `evidence` is the 2 ln L that it is expected to give, `refitted` the rival with the values that come
    closest, `samples` how many there are, `load` what the machine has to do.
    """

    evidence: float
    refitted: Cause
    samples: int
    load: Load


def separations(
    machine: Machine, true: Cause, rivals: Sequence[Cause], experiment: Experiment
) -> list[Separation]:
    """
    Return how well an experiment tells each of the rivals from `true`, which is in the machine.

    Raises `UserError` if the machine cannot be simulated with `true`.
    """
    noisy = machine.run((true,), experiment, noisy=True)
    ideal = machine.run((true,), experiment, noisy=False)
    shaken = evaluate(Problem(machine.variant, [machine.record(noisy)]), (true,))
    problem = Problem(machine.variant, [machine.record(ideal)])
    asked = load(machine.variant, ideal)
    found = []
    for rival in rivals:
        evidence, refitted = _imitated(problem, shaken, true, rival)
        found.append(Separation(evidence, refitted, shaken.samples, asked))
    return found


def _imitated(
    problem: Problem, shaken: Hypothesis, true: Cause, rival: Cause
) -> tuple[float, Cause]:
    """Return 2 ln L that a rival loses in the noise of `shaken`, and the rival as it was fitted."""
    both = {block for one in (true, rival) for block in problem.touched(one.effect, one.axis)}
    blocks = [block for block in shaken.fits if block in both]
    if not blocks:
        return 0.0, rival

    def left(cause: Cause) -> Channels:
        variant = apply_all(problem.nominal, (cause,))
        return {block: problem.residuals(variant, block) for block in blocks}

    own = left(true)
    noise_alone = {block: shaken.fits[block] for block in blocks}
    judged = noise_alone
    for _ in range(ROUNDS):
        difference = partial(_difference, judged, left, own)
        rival, squares = _closest(difference, rival, problem)
        rest = left(rival)
        laid_on = {
            block: [
                noise + one - other
                for noise, one, other in zip(
                    shaken.residuals[block], rest[block], own[block], strict=True
                )
            ]
            for block in blocks
        }
        judged = problem.judge(laid_on)
        if squares < NOTHING_LEFT:
            break
    alone = Hypothesis((true,), {block: shaken.residuals[block] for block in blocks}, noise_alone)
    evidence = 2.0 * gain(alone, Hypothesis((rival,), laid_on, judged), noise_known=True)
    return max(evidence, 0.0), rival


def _difference(
    fits: Mapping[str, Fit], left: Callable[[Cause], Channels], other: Channels, cause: Cause
) -> Array:
    """Return what a cause leaves less `other`, whitened, all channels one after another."""
    one = left(cause)
    return np.concatenate(
        [
            white
            for block, fit in fits.items()
            for white in prediction_errors(
                fit, [a - b for a, b in zip(one[block], other[block], strict=True)]
            )
        ]
    )


def _scales(parameters: Sequence[Parameter]) -> Array:
    """Return the change of each parameter that is plainly seen."""
    return np.array(
        [
            abs(item.typical - item.neutral) or abs(item.typical) or 0.1 * (item.high - item.low)
            for item in parameters
        ]
    )


def _at(cause: Cause, parameters: Sequence[Parameter], scaled: Array) -> Cause:
    """Return a cause with parameters in shares of what is plainly seen, within their bounds."""
    values = {
        item.name: float(np.clip(share * scale, item.low, item.high))
        for item, share, scale in zip(parameters, scaled, _scales(parameters), strict=True)
    }
    return cause.with_values(values)


def _closest(
    difference: Callable[[Cause], Array], rival: Cause, problem: Problem
) -> tuple[Cause, float]:
    """Return the rival with the least squares of `difference`, from its values on, and the squares."""
    parameters = parameters_of(problem, rival)
    scales = _scales(parameters)
    low, high = (
        np.array([getattr(item, end) for item in parameters]) / scales for end in ('low', 'high')
    )
    start = np.array([rival.values[item.name] for item in parameters]) / scales
    steps = np.maximum(STEP, np.array([item.resolution for item in parameters]) / scales)

    @lru_cache(maxsize=2)  # a fit asks for its values, and for derivatives there
    def simulated(values: tuple[float, ...]) -> Array:
        return difference(_at(rival, parameters, np.array(values)))

    def residual(scaled: Array) -> Array:
        found = simulated(tuple(scaled))
        if _squares(found) < NOTHING_LEFT:
            raise _NothingLeft(scaled)
        return found

    def derivative(scaled: Array) -> Array:
        here = simulated(tuple(scaled))
        columns = []
        for place, step in enumerate(steps):
            aside = scaled.copy()
            aside[place] += step if scaled[place] + step <= high[place] else -step
            columns.append((simulated(tuple(aside)) - here) / (aside[place] - scaled[place]))
        return np.column_stack(columns)

    try:
        best, _ = least_squares(residual, derivative, start, (low, high), EVALUATIONS, TOLERANCE)
    except _NothingLeft as found:
        best = found.scaled
    return _at(rival, parameters, best), _squares(simulated(tuple(best)))


class _NothingLeft(Exception):
    """A fit has come so near that nothing is left to be seen."""

    def __init__(self, scaled: Array) -> None:
        super().__init__()
        self.scaled = scaled.copy()


def _squares(errors: Array) -> float:
    return float(errors @ errors)


def load(variant: Variant, signals: Signals) -> Load:
    """Return how much of the limits of the axes a run takes; the axis is that with the largest share."""
    record = record_of_signals('run', signals)
    shares = []
    for axis in places.controlled_axes(variant):
        speed, current = _largest(variant, record, axis)
        shares.append(Load(speed, current, axis))
    return max(shares, key=lambda item: max(item.speed, item.current))


def _largest(variant: Variant, record: Record, axis: str) -> tuple[float, float]:
    place = record.layout.place(axis)
    encoder = places.encoder_places(variant)[place]
    assert record.commanded is not None
    assert record.command is not None
    # A servo cycle's jump is no speed that a limit is meant for: means over 10 ms.
    window = round(0.01 * record.timing.servo_hz)
    path = record.reading[:: record.timing.servo_divider // record.timing.encoder_divider, encoder]
    moved = np.abs(path[window:] - path[:-window]) if len(path) > window else np.zeros(1)
    limit = variant.i_variable(axis, 'Ixx16') * MILLISECONDS
    speed = float(moved.max()) * record.timing.servo_hz / window / limit
    largest = float(np.max(np.abs(record.command[:, place])))
    return speed, largest / places.peak_current(variant, axis)
