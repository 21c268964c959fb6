# SPDX-License-Identifier: Apache-2.0
"""The search: differential evolution, stage by stage, from the shipped values."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.calibration.as_built import (
    AS_BUILT_PAYLOAD,
    AS_BUILT_Y_ROTATE,
    evaluate_as_built_payload,
    evaluate_as_built_y_rotate,
)
from waferbot_twin.calibration.evaluation import Evaluation
from waferbot_twin.calibration.nominal import (
    PAYLOAD,
    Y_ROTATE,
    evaluate_payload,
    evaluate_y_rotate,
)
from waferbot_twin.calibration.values import Unknown, Values
from waferbot_twin.differential_evolution import minimise
from waferbot_twin.evaluations import in_order

IMPOSSIBLE = 1e3
"""Cost of a candidate that is no machine."""

SEED = 2
SPREAD = 0.12
"""Standard deviation of the first population around the start, in widths of the bounds."""


@dataclass(frozen=True)
class Stage:
    """A part of the calibration: what is sought, and how a candidate is judged."""

    name: str
    unknowns: tuple[Unknown, ...]
    evaluate: Callable[[Mapping[str, float]], Evaluation]
    generations: int
    population: int


STAGES = {
    'payload': Stage('payload', PAYLOAD, evaluate_payload, 60, 50),
    'y_rotate': Stage('y_rotate', Y_ROTATE, evaluate_y_rotate, 30, 36),
    'as_built_payload': Stage(
        'as_built_payload', AS_BUILT_PAYLOAD, evaluate_as_built_payload, 80, 60
    ),
    'as_built_y_rotate': Stage(
        'as_built_y_rotate', AS_BUILT_Y_ROTATE, evaluate_as_built_y_rotate, 60, 48
    ),
}


def search(
    stage: Stage,
    start: Mapping[str, float],
    generations: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    workers: int = 1,
) -> Values:
    """
    Return `start` with the stage's unknowns improved by differential evolution.

    The first population is the start, a cloud around it, and a quarter anywhere within the bounds.
    Zero generations return the start. So many `workers` judge candidates side by side. `progress` is
    called with the candidates judged and to judge; it may end early, when the population has become one
    point.
    """
    steps = stage.generations if generations is None else generations
    if steps == 0:
        return dict(start)
    low = np.array([unknown.low for unknown in stage.unknowns])
    high = np.array([unknown.high for unknown in stage.unknowns])
    first = np.clip([start[unknown.name] for unknown in stage.unknowns], low, high)
    random = np.random.default_rng(SEED)
    crowd = np.clip(
        first + random.normal(0.0, SPREAD, (stage.population, len(low))) * (high - low), low, high
    )
    anywhere = stage.population // 4
    crowd[-anywhere:] = low + (high - low) * random.random((anywhere, len(low)))
    crowd[0] = first

    judged = 0

    def costs(points: np.ndarray) -> np.ndarray:
        nonlocal judged
        found: list[float] = []
        for cost in in_order(functools.partial(_cost, stage, start), points, workers):
            found.append(cost)
            judged += 1
            progress(judged, (steps + 1) * stage.population)
        return np.array(found)

    best, _ = minimise(costs, low, high, steps, crowd, 1e-9)
    return _with(start, stage, best)


def _cost(stage: Stage, start: Mapping[str, float], point: np.ndarray) -> float:
    """Return what a candidate costs."""
    try:
        return stage.evaluate(_with(start, stage, point)).cost
    except (UserError, np.linalg.LinAlgError):
        return IMPOSSIBLE


def _with(start: Mapping[str, float], stage: Stage, point: np.ndarray) -> Values:
    names = (unknown.name for unknown in stage.unknowns)
    return {**start, **dict(zip(names, map(float, point), strict=True))}
