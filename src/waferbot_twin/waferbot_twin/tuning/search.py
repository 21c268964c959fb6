# SPDX-License-Identifier: Apache-2.0
"""
The search for gains: margins at every pose of every machine are conditions, speed is what is sought.

For a bandwidth f, the loop's natural frequency is 2 pi f, and damping ratio z, integral rate k and
notch are sought for which the integral is fastest, ln k largest. For an experiment, all of them and the
feedforward ratio are sought for which the measure of a run of the non-linear model is smallest.

A candidate c that misses conditions costs more than any that meets them, by how much it misses,

    cost = 1000 + sum of [required - found] / required + number of loops that are unstable,

and is not run. Minimised by differential evolution (scipy) with a fixed seed, the present gains among
the first candidates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import Experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.tuning.gains import AxisScale, IVariables, Tuning, i_variables
from waferbot_twin.tuning.loop import Linearised
from waferbot_twin.tuning.margins import Margins
from waferbot_twin.tuning.runs import behave

MISSED = 1000.0
SPARE = 0.03
"""Share by which a search asks for more than required: it takes margins off a grid."""

FAR = 1.5
"""Sum of missed shares beyond which no further pose is looked at."""

POPULATION = 10
"""Candidates per sought value."""

GENERATIONS = 20

BOUNDS: dict[str, tuple[float, float]] = {
    'natural_frequency': (0.25, 5.0),  # of the present one
    'damping_ratio': (0.15, 4.0),
    'feedforward_ratio': (0.0, 1.2),
    'integral_rate': (0.05, 40.0),
    'notch_hz': (5.0, 600.0),
    'notch_depth': (0.02, 1.0),
    'notch_width': (0.05, 1.0),
}
"""Where each value is sought, all but the feedforward ratio on a logarithmic scale."""

NOTCH = ('notch_hz', 'notch_depth', 'notch_width')


@dataclass(frozen=True)
class Required:
    """Margins that the gains must have at every pose of every machine: dB, degrees, s."""

    gain_db: float = 6.0
    phase_deg: float = 35.0
    delay_s: float = 0.0

    def missed(self, found: Margins, spare: float = 0.0) -> float:
        """Return by how much margins miss, as a sum of shares of what is required; 0: they do not."""
        pairs = (
            (self.gain_db, abs(found.gain_db)),
            (self.phase_deg, abs(found.phase_deg)),
            (self.delay_s, found.delay_s),
        )
        return sum(max(0.0, 1.0 + spare - have / need) for need, have in pairs if need > 0.0)


@dataclass(frozen=True, eq=False)
class Design:
    """What is to be tuned: an axis of a model, the linearised machines, and what is required."""

    variant: Variant
    axis: str
    machines: Sequence[Linearised]
    required: Required
    scale: AxisScale
    timing: Timing
    with_notch: bool = False

    def gains(self, tuning: Tuning) -> IVariables:
        """Return the I-variables of tuning values."""
        return i_variables(tuning, self.scale, self.servo({}))

    def servo(self, gains: IVariables) -> np.void:
        """Return the `SERVO_PARAMETERS` record of the model with other gains of the axis."""
        settings = {**self.variant.pmac, self.axis: {**self.variant.pmac[self.axis], **gains}}
        return servo_parameters(settings, self.variant.name, self.variant.layout)[0]

    def with_gains(self, gains: IVariables) -> Variant:
        """Return the model with other gains of the axis."""
        return self.variant.with_overlay(Overlay(pmac={self.axis: gains}))

    def missed(self, gains: IVariables, spare: float = 0.0) -> float:
        """
        Return by how much gains miss what is required, over poses and machines; 0: they do not.

        Far from it the first poses are enough to say so. Whether a loop is stable is asked last: it
        costs the most, and margins that are missed lead there as well.
        """
        servo = self.servo(gains)
        loops = [machine.loop(servo, self.axis) for machine in self.machines]
        total = 0.0
        for loop in loops:
            total += self.required.missed(loop.quick_margins, spare)
            if total > FAR:
                return total * len(loops)
        if total == 0.0:
            total += sum(not loop.stable for loop in loops)
        return total


def for_bandwidth(
    design: Design, bandwidth_hz: float, present: Tuning, generations: int = GENERATIONS
) -> Tuning:
    """Return the tuning with a natural frequency and the required margins; the nearest to them else."""
    fixed = replace(present, natural_frequency=2.0 * math.pi * bandwidth_hz, feedforward_ratio=1.0)
    names = ('damping_ratio', 'integral_rate', *(NOTCH if design.with_notch else ()))
    return _sought(
        design, fixed, names, lambda tuning: -math.log(tuning.integral_rate), generations
    )


def for_experiment(
    design: Design,
    experiment: Experiment,
    measure: str,
    present: Tuning,
    generations: int = GENERATIONS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Tuning:
    """
    Return the tuning with the smallest measure (`runs.MEASURES`) in runs of an experiment.

    Of equal ones it takes the smaller RMS following error. Raises `UserError` for an experiment that
    cannot be run.
    """
    reference = behave(design.variant, experiment, design.timing)[design.axis]
    scale = reference.rms_following_error or 1.0

    def value(tuning: Tuning) -> float:
        found = behave(design.with_gains(design.gains(tuning)), experiment, design.timing)
        own = found[design.axis]
        sought = abs(getattr(own, measure))
        if not math.isfinite(sought):
            return 500.0 + min(own.rms_following_error / scale, 100.0)
        unit = scale if measure == 'rms_following_error' else 1.0
        return sought / unit + 0.02 * own.rms_following_error / scale

    names: tuple[str, ...] = (
        'natural_frequency',
        'damping_ratio',
        'feedforward_ratio',
        'integral_rate',
    )
    names += NOTCH if design.with_notch else ()
    return _sought(design, present, names, value, generations, progress)


def _sought(
    design: Design,
    start: Tuning,
    names: Sequence[str],
    value: Callable[[Tuning], float],
    generations: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Tuning:
    """Return the tuning that differs from `start` in `names` and has the smallest value."""
    bounds = []
    for name in names:
        low, high = BOUNDS[name]
        if name == 'natural_frequency':
            low, high = low * start.natural_frequency, high * start.natural_frequency
        bounds.append(
            (low, high) if name == 'feedforward_ratio' else (math.log(low), math.log(high))
        )

    def tuning(point: np.ndarray) -> Tuning:
        values = {
            name: float(one) if name == 'feedforward_ratio' else math.exp(one)
            for name, one in zip(names, point, strict=True)
        }
        return replace(start, **values)

    done, total = 0, POPULATION * len(names) * (generations + 1)

    def cost(point: np.ndarray) -> float:
        nonlocal done
        done += 1
        progress(min(done, total), total)
        one = tuning(point)
        missed = design.missed(design.gains(one), SPARE)
        return MISSED + missed if missed else value(one)

    usual = {'notch_hz': 60.0, 'notch_depth': 1.0, 'notch_width': 0.5}
    first = [
        getattr(start, name) or usual.get(name, 1.0)
        if name == 'feedforward_ratio'
        else math.log(getattr(start, name) or usual.get(name, 1.0))
        for name in names
    ]
    first = [min(max(one, low), high) for one, (low, high) in zip(first, bounds, strict=True)]
    found = differential_evolution(
        cost, bounds, x0=first, seed=2, maxiter=generations, popsize=POPULATION, polish=False,
        tol=1e-4, strategy='currenttobest1bin', mutation=(0.4, 0.9), recombination=0.8,
    )  # fmt: skip
    return tuning(found.x)
