# SPDX-License-Identifier: Apache-2.0
"""Run a machine through a motion: the log that its drive would have written."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from independent_machine.machine import (
    Hidden,
    Machine,
    Tuning,
    encoders_of,
    loop_of,
    physics_of,
)
from independent_machine.motions import MOTIONS, Reach
from independent_machine.plant import run_loop

LONGEST_STEP_S = 1e-5
PREROLL_S = 0.8
"""The machine has stood under control for so long when the log begins."""

NOISE_PARTS = 10
"""Parts of a tick in each of which the force noise is constant."""


@dataclass(frozen=True)
class Noise:
    """Noise: force on the load (rms, corner in Hz), encoders (counts rms), current (A rms)."""

    force: float
    corner_hz: float
    counts: float
    motor_counts: float
    current: float


@dataclass(frozen=True)
class Setup:
    """All of a case but what is hidden: machine, loop, noise, and how the log is written."""

    machine: Machine
    tuning: Tuning
    noise: Noise
    rounds: bool
    tick_hz: float
    every: int
    drive: str
    reach: Reach

    @property
    def drive_late_s(self) -> float:
        """
        How much later than it acts a drive stands in the log, read straight from sample to sample.

        A sample of the current is taken as the next command goes out, and what follows that has a lag
        tau. Of a step, as samples have it and as it is, the integrals over 1 - i(t) differ by

            T / 2 coth(T / (2 tau)) - tau,

        and a mean over n ticks is half of n - 1 of them late besides. A command acts from its tick on.
        """
        if self.drive == 'current_command':
            return 0.0
        tick_s, lag_s = 1.0 / self.tick_hz, self.tuning.lag_s
        sampled_s = 0.5 * tick_s / math.tanh(0.5 * tick_s / lag_s) - lag_s
        return sampled_s + 0.5 * (self.every - 1) * tick_s


@dataclass(frozen=True)
class Motion:
    """A motion by kind, length and the seed of what is drawn in it."""

    kind: str
    seconds: float
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Log:
    """What a drive writes, in SI units: position of load and motor, command, and what drives it."""

    time_s: np.ndarray
    position: np.ndarray
    motor_position: np.ndarray
    commanded: np.ndarray
    drive: np.ndarray
    saturated: float
    restless: float
    forced_steps: int


def reference_of(setup: Setup, motion: Motion) -> np.ndarray:
    """Return position, speed, acceleration at every tick, with the standstill before the log."""
    tick_s = 1.0 / setup.tick_hz
    ticks = round(motion.seconds / tick_s)
    random = np.random.default_rng(motion.seed)
    path = MOTIONS[motion.kind](setup.reach, random, ticks, tick_s)
    still = np.zeros((round(PREROLL_S / tick_s), 3))
    still[:, 0] = path[0, 0]
    return np.concatenate([still, path])


def simulate(setup: Setup, hidden: Hidden, motion: Motion, noise_seed: tuple[int, ...]) -> Log:
    """
    Return the log of a run; the same to the bit for the same arguments.

    The integrator's steps are at most 10 us and a whole part of a tick. A drive that logs more slowly
    than it controls averages its current over the ticks since the last sample, so that no impulse of it
    is lost. `saturated` is the share of commands at the limit, `restless` the RMS following error at the
    end of the standstill over stroke.
    """
    tick_s = 1.0 / setup.tick_hz
    steps = math.ceil(tick_s / LONGEST_STEP_S)
    step_s = tick_s / steps
    reference = reference_of(setup, motion)
    ticks = len(reference)
    random = np.random.default_rng(noise_seed)
    load, motor = encoders_of(setup.machine, hidden, setup.rounds, step_s)
    loop = loop_of(setup.machine, hidden, setup.tuning, float(reference[0, 0]), tick_s, step_s)
    counts = random.standard_normal((ticks, 2)) * [setup.noise.counts, setup.noise.motor_counts]
    readings, commands, currents, _, _, forced = run_loop(
        physics_of(setup.machine, hidden),
        loop,
        load,
        motor,
        reference,
        coloured(setup.noise, ticks, tick_s, random),
        counts,
        tick_s,
        steps,
    )
    begin = round(PREROLL_S / tick_s)
    rows = slice(begin, None, setup.every)
    measured = currents + setup.noise.current * random.standard_normal(ticks)
    sensed = averaged(measured, setup.every)[rows]
    drive = {
        'current': sensed,
        'force': setup.machine.axis_constant * sensed,
        'current_command': commands[rows],
    }[setup.drive]
    seen = readings[:, 1] / setup.machine.ratio if loop.position_on_motor else readings[:, 0]
    still = (reference[:, 0] - seen)[begin // 2 : begin]
    return Log(
        time_s=np.arange(ticks)[rows] * tick_s - begin * tick_s,
        position=readings[rows, 0],
        motor_position=readings[rows, 1],
        commanded=reference[rows, 0],
        drive=drive,
        saturated=float(np.mean(np.abs(commands[begin:]) >= loop.limit)),
        restless=float(np.std(still) / setup.reach.stroke),
        forced_steps=int(forced),
    )


def averaged(values: np.ndarray, last: int) -> np.ndarray:
    """Return at every sample the mean of as many as `last`, this one included."""
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(values, last, mode='nearest', origin=(last - 1) // 2)


def coloured(noise: Noise, ticks: int, tick_s: float, random: np.random.Generator) -> np.ndarray:
    """Return low-passed white noise (ticks, parts) with the given rms, exact at the parts' ends."""
    from scipy.signal import lfilter

    keep = math.exp(-2.0 * math.pi * noise.corner_hz * tick_s / NOISE_PARTS)
    white = random.standard_normal(ticks * NOISE_PARTS)
    white[1:] *= math.sqrt(1.0 - keep**2)
    return noise.force * lfilter([1.0], [1.0, -keep], white).reshape(ticks, NOISE_PARTS)
