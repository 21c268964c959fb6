# SPDX-License-Identifier: Apache-2.0
"""What a run of an experiment says of the gains: following error, settling, overshoot, current."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import Experiment
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Runaway, Twin
from waferbot_twin.metrics import rms
from waferbot_twin.response import AxisResponse, simulated_responses

MEASURES = ('settling_time', 'rms_following_error', 'overshoot_percent', 'peak_current_a')


@dataclass(frozen=True, eq=False)
class Behaviour:
    """
    An axis in a run: its response, and the figures of it.

    RMS and peak following error in m or rad; RMS and peak current command in A. Settling time in s and
    overshoot in %, of the worst of the steps, NaN if the axis does not step; infinite settling time if
    a step does not settle before the next one. `alive` tells whether the run got to its end.
    """

    response: AxisResponse
    rms_following_error: float
    peak_following_error: float
    rms_current_a: float
    peak_current_a: float
    settling_time: float
    overshoot_percent: float
    alive: bool

    def figures(self) -> dict[str, float]:
        """Return the figures by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, float)}


def behave(variant: Variant, experiment: Experiment, timing: Timing) -> dict[str, Behaviour]:
    """Return how every axis behaves; what blows up is there up to then. Raises `UserError`."""
    twin = Twin.of(variant.model(), timing, experiment)
    alive = True
    try:
        signals = twin.advance(timing.ticks(experiment.duration_s))
    except Runaway as error:
        signals, alive = error.signals, False
    alive = alive and not bool(twin.servo_state['killed'].any())
    return {
        axis.axis: _behaviour(axis, alive)
        for axis in simulated_responses(twin, signals)
        if axis.axis in twin.machine.description.axes
    }


def _behaviour(response: AxisResponse, alive: bool) -> Behaviour:
    error, current = response.following_error, response.current_command
    settling, overshoot = _of_steps(response)
    return Behaviour(
        response,
        rms(error) if alive else math.inf,
        float(np.max(np.abs(error), initial=0.0)),
        rms(current),
        float(np.max(np.abs(current), initial=0.0)),
        settling if alive else math.inf,
        overshoot,
        alive,
    )


def _of_steps(response: AxisResponse) -> tuple[float, float]:
    """Return settling time and overshoot, the worst of all steps; NaN if the motion is none."""
    if response.step() is None:
        return math.nan, math.nan
    jumps = np.flatnonzero(np.diff(response.commanded))
    ends = [*(response.servo_time[jumps[1:] + 1]), np.inf]
    figures = []
    for jump, end_s in zip(jumps, ends, strict=True):
        found = response.one_step(int(jump), float(end_s))
        if found is None:
            return math.nan, math.nan
        settling = found.settling_time
        figures.append(
            (settling if math.isfinite(settling) else math.inf, found.overshoot_percent)
        )
    return max(one[0] for one in figures), max(one[1] for one in figures)


def moving_axis(experiment: Experiment) -> str | None:
    """Return the axis that an experiment moves, None if it moves several."""
    axes = set(experiment.motion)
    for statement in experiment.program:
        for mode in ('linear', 'rapid'):
            axes |= {key.rpartition('_')[0] for key in statement.get(mode, {})}
    return axes.pop() if len(axes) == 1 else None
