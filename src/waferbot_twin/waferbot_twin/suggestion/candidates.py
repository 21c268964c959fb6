# SPDX-License-Identifier: Apache-2.0
"""
Experiments that could be made: those of the library, and simple ones designed for an axis.

Designed motions are sized by what the controller allows the axis, speed Ixx16 and acceleration Ixx17,
and by the longest way that an experiment of the library takes it. A step or a sine of amplitude a at
the frequency f asks for an acceleration of about a (2 pi f)^2: amplitudes are in shares of Ixx17.
Whether a machine can really do it is seen when it is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml

from waferbot_lockstep.contract import USUAL_UNITS, usual_axis
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import (
    Experiment,
    commanded_positions,
    load_experiment,
    shipped_experiments,
    suits,
)
from waferbot_pmac.experiments.evaluation import MILLISECONDS
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import SHIPPED, load_model

START_S = 0.05
"""Designed motions begin then: the observers of the diagnosis have taken hold."""

STEP_HZ = 16.0
"""A step of a servo axis is done with about this frequency."""

STEP_SHARES = (0.1, 0.5, 2.0)
SPEED_SHARES = (0.01, 0.05, 0.2, 0.6)
BANDS_HZ = ((0.5, 5.0), (2.0, 40.0), (20.0, 300.0))
SINE_SHARE = 0.3
LONGEST_S = 4.0
RAMP_S, SMOOTH_S = 0.1, 0.02
GENTLY = 1.3
"""By how much longer a ramp to full speed takes than Ixx17 allows."""

CHANGES = (0.5, 0.7, 1.4, 2.0)
"""What the size of the best designed experiment is changed by, to see if that is better."""


@dataclass(frozen=True)
class Design:
    """A motion of one axis: `keys` of the experiment's schema, of which those in `sizes` can grow."""

    axis: str
    kind: str
    duration_s: float
    keys: Mapping[str, Any]
    sizes: tuple[str, ...]
    stroke: float = math.inf

    def scaled(self, factor: float) -> Design:
        """Return the design with its sizes changed by a factor."""
        keys = {
            key: value * factor if key in self.sizes else value for key, value in self.keys.items()
        }
        return Design(self.axis, self.kind, self.duration_s, keys, self.sizes, self.stroke)

    @property
    def experiment(self) -> Experiment:
        """The design as an experiment that every engine runs."""
        keys = {
            key: float(f'{value:.4g}') if isinstance(value, float) else value
            for key, value in self.keys.items()
        }
        size = ', '.join(f'{key} {keys[key]:.3g}' for key in self.sizes)
        band = [f'{keys[key]:g}' for key in sorted(keys) if key.endswith('frequency_hz')][:2]
        what = self.kind.replace('_', ' ') + (f' {" to ".join(band)} Hz' if band else '')
        text = yaml.safe_dump(
            {
                'name': f'{self.kind}_{self.axis}_designed',
                'description': f'{what} of {self.axis}, {size}, to tell causes apart.',
                'duration_s': self.duration_s,
                'motion': {self.axis: {'kind': self.kind, 'start_s': START_S, **keys}},
            },
            sort_keys=False,
        )
        return load_experiment(text)

    @property
    def label(self) -> str:
        """The design in a few words, for a table."""
        size = ', '.join(f'{self.keys[key]:.3g} {_unit(key)}' for key in self.sizes)
        band = ''
        if 'first_frequency_hz' in self.keys:
            first, last = self.keys['first_frequency_hz'], self.keys['last_frequency_hz']
            band = f', {first:g} to {last:g} Hz'
        return f'{self.kind.replace("_", " ")} {self.axis}, {size}{band}'


def _unit(key: str) -> str:
    return 'm/s' if key == 'speed_m_per_s' else 'rad/s' if key == 'speed_rad_per_s' else (
        key.rsplit('_', 1)[-1]
    )  # fmt: skip


@dataclass(frozen=True)
class Candidate:
    """An experiment by its label; `design` if it was designed."""

    label: str
    experiment: Experiment
    design: Design | None = field(default=None, compare=False)


def library(variant: Variant) -> list[Candidate]:
    """Return the experiments of the library that a machine with these axes can be commanded to do."""
    found = []
    for name in shipped_experiments():
        experiment = load_experiment(name)
        if any(axis not in variant.description.axes for axis in experiment.motion):
            continue
        if not suits(experiment, variant.description.axis_units):
            continue
        found.append(Candidate(name, experiment))
    return found


def strokes(variant: Variant, timing: Timing) -> dict[str, float]:
    """
    Return the longest way that an experiment of the library takes each axis, m or rad.

    For an axis that slides where that of the shipped machine turns, or the other way round, the library
    has no experiment of its own: the way is that of the shipped axis with the same unit.
    """
    units = variant.description.axis_units
    own = _longest_ways(variant, timing)
    foreign = [axis for axis in units if units[axis] != USUAL_UNITS.get(axis)]
    if foreign:
        shipped = _longest_ways(Variant.of(load_model(SHIPPED)), timing)
        own |= {axis: shipped[usual_axis(axis, units[axis])] for axis in foreign}
    return own


def _longest_ways(variant: Variant, timing: Timing) -> dict[str, float]:
    """Return the longest way that those experiments take each axis that suit the machine."""
    parameters = servo_parameters(variant.pmac, variant.name, variant.layout)
    per_unit = parameters[0]['counts_per_unit']
    units = variant.description.axis_units
    longest = np.zeros(len(units))
    for one in library(variant):
        path = commanded_positions(one.experiment, parameters, timing.servo_hz, units)
        longest = np.maximum(longest, np.ptp(path, axis=0) / per_unit)
    return {axis: float(longest[place]) for place, axis in enumerate(units)}


def designed(variant: Variant, axes: Sequence[str], timing: Timing) -> list[Candidate]:
    """Return steps, runs at constant velocity and swept sines of every axis that has a controller."""
    ways = strokes(variant, timing)
    controlled = places.controlled_axes(variant)
    return [
        Candidate(design.label, design.experiment, design)
        for axis in axes
        if axis in controlled
        for design in _designs(variant, axis, ways[axis])
    ]


def _designs(variant: Variant, axis: str, stroke: float) -> list[Design]:
    unit = places.length_unit(variant, axis)
    per_unit = variant.i_variable(axis, 'counts_per_unit')
    speed = variant.i_variable(axis, 'Ixx16') * MILLISECONDS / per_unit
    acceleration = variant.i_variable(axis, 'Ixx17') * MILLISECONDS**2 / per_unit
    found = []
    for share in STEP_SHARES:
        amplitude = share * acceleration / (2.0 * math.pi * STEP_HZ) ** 2
        keys = {'return_s': 0.6, f'amplitude_{unit}': amplitude}
        found.append(Design(axis, 'bidirectional_step', 1.2, keys, (f'amplitude_{unit}',), stroke))
    for share in SPEED_SHARES:
        # There and back, each with a ramp up and down, within the stroke.
        ramp_s = round(max(RAMP_S, GENTLY * share * speed / acceleration), 3)
        way = min(stroke, share * speed * (0.5 * LONGEST_S - 2.0 * (ramp_s + SMOOTH_S)))
        moving_s = way / (share * speed) + ramp_s + SMOOTH_S
        duration_s = math.ceil(10.0 * (2.0 * moving_s + 4.0 * START_S)) / 10.0
        keys = {
            'dwell_s': START_S, 'acceleration_time_s': ramp_s, 's_curve_time_s': SMOOTH_S,
            f'speed_{unit}_per_s': share * speed, f'distance_{unit}': way,
        }  # fmt: skip
        sizes = (f'speed_{unit}_per_s', f'distance_{unit}')
        found.append(Design(axis, 'constant_velocity', duration_s, keys, sizes, stroke))
    for first, last in BANDS_HZ:
        # Above the corner the amplitude falls with the square of the frequency: constant acceleration.
        corner = math.sqrt(first * last)
        amplitude = SINE_SHARE * acceleration / (2.0 * math.pi * corner) ** 2
        keys = {
            'end_s': LONGEST_S - START_S, 'first_frequency_hz': first, 'last_frequency_hz': last,
            'corner_frequency_hz': corner, 'fade_s': 0.2,
            f'amplitude_{unit}': min(amplitude, 0.4 * stroke),
        }  # fmt: skip
        found.append(Design(axis, 'swept_sine', LONGEST_S, keys, (f'amplitude_{unit}',), stroke))
    return found


def changed(candidate: Candidate) -> list[Candidate]:
    """Return a designed experiment in other sizes, as far as the stroke allows; else nothing."""
    design = candidate.design
    if design is None:
        return []
    variations = (design.scaled(factor) for factor in CHANGES)
    return [
        Candidate(one.label, one.experiment, one)
        for one in variations
        if all(one.keys[key] <= one.stroke for key in one.sizes if not key.endswith('_per_s'))
    ]
