# SPDX-License-Identifier: Apache-2.0
"""
Motions drawn at random, within what the machine's controller allows, as experiments of the PMAC.

Each axis has its own: steps, random positions, a swept sine, a multisine, there and back or one way at
constant speed. Small signals are between 0.3 and 1.5 times those of the shipped experiments; moves
keep the controller's limits of speed Ixx16 and acceleration Ixx17.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from waferbot_twin.effects.places import controlled_axes
from waferbot_twin.effects.variant import Variant

DURATION_S = 1.0
QUIET_S = 0.05
"""Standstill at the beginning and at the end."""

ACCELERATION_TIME_S, S_CURVE_TIME_S = 0.1, 0.02

STEP_COUNTS = {'y_linear': 2500.0, 'x_rotate': 800.0, 'y_rotate': 1000.0}
RANDOM_COUNTS = {'y_linear': 500.0, 'x_rotate': 300.0, 'y_rotate': 400.0}
SINE_COUNTS = {'y_linear': 1000.0, 'x_rotate': 167.0, 'y_rotate': 334.0}
CORNER_HZ = {'y_linear': 20.0, 'x_rotate': 20.0, 'y_rotate': 10.0}
"""Amplitudes of the shipped experiments, and the corner above which their sines become smaller."""

Motion = dict[str, Any]


def draw_experiment(variant: Variant, random: np.random.Generator) -> str:
    """Return an experiment in which every axis with a controller moves, as text (JSON is YAML)."""
    axes = controlled_axes(variant)
    kinds = [KINDS[int(random.integers(len(KINDS)))] for _ in axes]
    motion = {axis: kind(variant, axis, random) for axis, kind in zip(axes, kinds, strict=True)}
    return json.dumps({'name': 'drawn', 'duration_s': DURATION_S, 'motion': motion})


def _amplitude(usual: dict[str, float], axis: str, random: np.random.Generator) -> float:
    return usual[axis] * float(random.uniform(0.3, 1.5))


def _sign(random: np.random.Generator) -> float:
    return -1.0 if random.random() < 0.5 else 1.0


def _logarithmic(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(2**31))


def _steps(variant: Variant, axis: str, random: np.random.Generator) -> Motion:
    return {
        'kind': 'bidirectional_step',
        'start_s': float(random.uniform(QUIET_S, 0.2)),
        'return_s': float(random.uniform(0.35, 0.7)),
        'amplitude_counts': float(round(_sign(random) * _amplitude(STEP_COUNTS, axis, random))),
    }


def _random_positions(variant: Variant, axis: str, random: np.random.Generator) -> Motion:
    return {
        'kind': 'random',
        'start_s': QUIET_S,
        'hold_s': float(random.uniform(0.02, 0.08)),
        'amplitude_counts': _amplitude(RANDOM_COUNTS, axis, random),
        'seed': _seed(random),
    }


def _swept_sine(variant: Variant, axis: str, random: np.random.Generator) -> Motion:
    return {
        'kind': 'swept_sine',
        'start_s': QUIET_S,
        'end_s': DURATION_S - QUIET_S,
        'fade_s': 0.05,
        'first_frequency_hz': _logarithmic(random, 1.0, 5.0),
        'last_frequency_hz': _logarithmic(random, 60.0, 200.0),
        'corner_frequency_hz': CORNER_HZ[axis],
        'amplitude_counts': _amplitude(SINE_COUNTS, axis, random),
    }


def _multisine(variant: Variant, axis: str, random: np.random.Generator) -> Motion:
    return {
        'kind': 'multisine',
        'start_s': QUIET_S,
        'period_s': 0.5,
        'first_frequency_hz': 2.0,
        'last_frequency_hz': 1.5 * CORNER_HZ[axis],
        'fade_s': 0.05,
        'amplitude_counts': _amplitude(SINE_COUNTS, axis, random),
        'seed': _seed(random),
    }


def _speed(variant: Variant, axis: str, random: np.random.Generator) -> float:
    """Return a speed in counts per s: 0.02 to 0.9 of what both limits allow."""
    by_speed = 1e3 * variant.i_variable(axis, 'Ixx16')
    by_acceleration = (
        1e6 * variant.i_variable(axis, 'Ixx17') * (ACCELERATION_TIME_S - S_CURVE_TIME_S)
    )
    return min(by_speed, by_acceleration) * _logarithmic(random, 0.02, 0.9)


def _move(kind: str, longest_s: float) -> Callable[[Variant, str, np.random.Generator], Motion]:
    """Return a way to draw a move at a speed that is kept for up to `longest_s`."""

    def drawn(variant: Variant, axis: str, random: np.random.Generator) -> Motion:
        speed = _speed(variant, axis, random)
        distance = speed * float(random.uniform(ACCELERATION_TIME_S, longest_s))
        return {
            'kind': kind,
            'start_s': QUIET_S,
            'acceleration_time_s': ACCELERATION_TIME_S,
            's_curve_time_s': S_CURVE_TIME_S,
            'speed_counts_per_s': speed,
            'distance_counts': _sign(random) * distance,
        }

    return drawn


KINDS = (
    _steps,
    _random_positions,
    _swept_sine,
    _multisine,
    _move('constant_velocity', 0.5 * (DURATION_S - 2.0 * QUIET_S) - ACCELERATION_TIME_S),
    _move('linear', DURATION_S - 2.0 * QUIET_S - ACCELERATION_TIME_S),
)
