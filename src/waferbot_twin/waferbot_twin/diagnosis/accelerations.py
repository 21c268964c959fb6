# SPDX-License-Identifier: Apache-2.0
"""
Acceleration of an axis per ampere: what a log tells where neither mass nor force constant is told.

    a = k / M                                                                                     (1)

with k the force or torque at the axis per ampere, and M the mass or inertia that the axis moves at home,
all else rigid. A log of positions and currents has hardly more to say of the two: with both a little off
by chance it leaves either open, and a is known to a part in a thousand. With a covariance V of all
parameters x of what was found, a has the variance g' V g, g the slopes of (1). An axis is told where its
interval leaves out what the model has.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, width_of
from waferbot_twin.estimation.intervals import Rival, averaged
from waferbot_twin.residuals.problem import Problem, apply_all
from waferbot_twin.residuals.record import Array


def accelerations(
    problem: Problem, found: Hypothesis, rivals: Sequence[Rival] = ()
) -> list[Correction]:
    """
    Return the accelerations per ampere that the logs tell to be others than the model's, with intervals.

    None of axes whose logs have a force: of these the mass itself is told. Intervals are averages over
    the other models, `rivals`, where they are known no better than here.
    """
    names = names_of(problem, found.causes)
    nominal = problem.nominal
    axes = [axis for axis in places.motor_axes(nominal) if axis not in nominal.force_driven]
    if len(found.covariance) != len(names) or not axes:
        return []
    here = _of_axes(apply_all(nominal, found.causes), axes)
    slopes = np.zeros((len(names), len(axes)))
    for number, (place, item) in enumerate(names):
        value = found.causes[place].values[item.name]
        # (1) is smooth and has no noise but rounding.
        step = math.sqrt(sys.float_info.epsilon) * width_of(found.causes[place], item)
        change = np.zeros(len(names))
        change[number] = step if value + step <= item.high else -step
        try:
            there = apply_all(nominal, moved(found.causes, names, change))
        except UserError:  # no machine: a part is too small for it
            return []
        slopes[number] = (_of_axes(there, axes) - here) / change[number]
    errors = np.sqrt(np.einsum('ka,kl,la->a', slopes, found.covariance, slopes))
    others = [
        (_of_axes(apply_all(nominal, one.found.causes), axes), one.log_odds) for one in rivals
    ]
    ends = [
        averaged(value, error, [(there[place], error, log_odds) for there, log_odds in others])
        for place, (value, error) in enumerate(zip(here, errors, strict=True))
    ]
    return [
        Correction(
            f'acceleration per ampere of {axis}',
            f'axes.{axis}.acceleration_per_ampere',
            'rad/s2/A' if places.rotary(nominal, axis) else 'm/s2/A',
            float(before), float(after), low, high,
        )
        for axis, before, after, (low, high) in zip(
            axes, _of_axes(nominal, axes), here, ends, strict=True
        )
        if not low <= before <= high
    ]  # fmt: skip


def _of_axes(variant: Variant, axes: list[str]) -> Array:
    """Return equation (1) of some axes of a variant itself, (axes,)."""
    itself = replace(variant, origin=None)
    return np.array(
        [
            places.force_per_ampere(itself, axis) / places.moving_inertia(itself, axis)
            for axis in axes
        ]
    )
