# SPDX-License-Identifier: Apache-2.0
"""
What varies in a sweep, and the points at which it is evaluated.

A variation is `PATH=low:high`, or `PATH=low:high:n` for a grid; paths are those of `identify`. Points
(n, parameters) are

    grid      all combinations of n evenly spaced values each
    sobol     the first n points of Sobol's sequence, scrambled by a seed: even in all directions
    saltelli  n (k + 2) points from which first-order and total sensitivities of k parameters follow
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.identification.named_parameters import NamedParameter, at_path

METHODS = ('grid', 'sobol', 'saltelli')
MOST_POINTS = 1_000_000
GRID_POINTS = 5

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Variation:
    """A parameter that varies from `low` to `high`, in its unit; `count` values of it in a grid."""

    parameter: NamedParameter
    low: float
    high: float
    count: int

    @property
    def path(self) -> str:
        """The name of the parameter."""
        return self.parameter.path


def parse_variations(texts: Sequence[str], variant: Variant) -> tuple[Variation, ...]:
    """Return what varies; raises `UserError` for a path that leads nowhere or a range that is none."""
    found: dict[str, Variation] = {}
    for text in texts:
        path, equals, limits = text.partition('=')
        parts = limits.split(':')
        try:
            low, high = float(parts[0]), float(parts[1])
            count = int(parts[2]) if len(parts) == 3 else GRID_POINTS
        except (ValueError, IndexError):
            low = high = math.nan
            count = 0
        if not equals or len(parts) > 3 or not (math.isfinite(low) and math.isfinite(high)):
            raise UserError(f'--vary {text}: give PATH=low:high, or PATH=low:high:n')
        if low >= high or count < 1:
            raise UserError(f'--vary {text}: {low:g} must be less than {high:g}, and n at least 1')
        parameter = at_path(path.strip(), variant)
        if low < parameter.low or high > parameter.high:
            raise UserError(
                f'--vary {text}: {path} can be {parameter.low:g} to {parameter.high:g} '
                f'{parameter.unit}'
            )
        if parameter.path in found:
            raise UserError(f'--vary {parameter.path} is given twice')
        found[parameter.path] = Variation(parameter, low, high, count)
    if not found:
        raise UserError('give at least one --vary')
    return tuple(found.values())


def points(variations: Sequence[Variation], method: str, samples: int, seed: int) -> Floats:
    """Return the points (n, parameters) of a method; rounded where devices hold whole numbers."""
    low = np.array([one.low for one in variations])
    high = np.array([one.high for one in variations])
    if method == 'grid':
        if math.prod(one.count for one in variations) > MOST_POINTS:
            raise UserError(f'the grid has more than {MOST_POINTS} points; give smaller n')
        axes = [np.linspace(one.low, one.high, one.count) for one in variations]
        found = np.array(list(itertools.product(*axes)))
    elif method == 'sobol':
        draws = qmc.Sobol(len(variations), scramble=True, rng=np.random.default_rng(seed))
        power = math.ceil(math.log2(max(samples, 1)))
        found = low + (high - low) * draws.random_base2(power)[:samples]
    else:
        try:
            from SALib.sample import sobol
        except ImportError as error:
            raise UserError('saltelli needs SALib: python -m pip install SALib') from error
        found = sobol.sample(problem(variations), samples, calc_second_order=False, seed=seed)
    return held(variations, np.asarray(found, float))


def held(variations: Sequence[Variation], points: Floats) -> Floats:
    """Return points (n, k), or one (k,), with whole numbers where the device holds them."""
    whole = [one.parameter.whole for one in variations]
    return np.where(whole, np.rint(points), points)


def problem(variations: Sequence[Variation]) -> dict[str, object]:
    """Return the variations as SALib takes them."""
    return {
        'num_vars': len(variations),
        'names': [one.path for one in variations],
        'bounds': [[one.low, one.high] for one in variations],
    }


def overlaid(variant: Variant, parameters: Sequence[NamedParameter], point: Floats) -> Variant:
    """Return the model with parameters at a point; raises `UserError` for a machine that cannot be."""
    for parameter, value in zip(parameters, point, strict=True):
        overlay: Overlay = parameter.overlay(variant, float(value))
        variant = variant.with_overlay(overlay)
    return variant
