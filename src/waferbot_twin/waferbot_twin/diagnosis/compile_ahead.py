# SPDX-License-Identifier: Apache-2.0
"""
Compile every machine that a search will want, before it wants it.

A machine is compiled for its numbers of links, coordinates and springs (half a minute each, then kept
on disk): the nominal one, one with room for what gives, one with a coordinate more. Left to chance all
cores would wait for the first, and then compile the second at the same time.

Limit: only cores that share a disk find what was compiled; those of a cluster compile for themselves.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.problem import PLANT, Cause, Problem, apply_all
from waferbot_twin.effects.effect import Effect
from waferbot_twin.effects.host import built


def compile_ahead(problem: Problem, effects: Sequence[Effect], workers: int) -> None:
    """Compile the machines that these effects make of the nominal one, on all cores."""
    if workers > 1:
        Parallel(n_jobs=workers, batch_size=1)(
            delayed(_drive)(problem, causes) for causes in machines(problem, effects)
        )


def machines(problem: Problem, effects: Sequence[Effect]) -> list[tuple[Cause, ...]]:
    """Return no cause, and one of each kind that makes a machine which differs in memory from others."""
    found: dict[np.dtype, tuple[Cause, ...]] = {}
    for causes in ((), *_one_of_each(problem, effects)):
        try:
            machine = built(apply_all(problem.nominal, causes), problem.records[0].timing)
        except UserError:  # the search will say so where it matters
            continue
        found.setdefault(machine.parameter_dtype, causes)
    return list(found.values())


def _one_of_each(problem: Problem, effects: Sequence[Effect]) -> list[tuple[Cause, ...]]:
    return [
        (Cause(effect, axis, effect.typical(problem.nominal, axis)),)
        for effect in effects
        for axis in effect.distinct_axes(problem.nominal)[:1]
        if PLANT in problem.touched(effect, axis)
    ]


def _drive(problem: Problem, causes: tuple[Cause, ...]) -> None:
    with contextlib.suppress(UserError):  # compiled it is all the same
        problem.residuals(apply_all(problem.nominal, causes), PLANT)
