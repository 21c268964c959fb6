# SPDX-License-Identifier: Apache-2.0
"""Demands beyond the figures: distances by their definition, and the same runs as the tables use."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_plant.plant import load_machine
from waferbot_twin.calibration.candidate_runs import CandidateRuns, Stepped
from waferbot_twin.calibration.demands import charge, distance, models_of
from waferbot_twin.calibration.evaluation import Evaluation
from waferbot_twin.models import load_model
from waferbot_twin.statements import statements
from waferbot_twin.step_runs import CASES, run_step


@pytest.mark.parametrize(
    ('value', 'least', 'most', 'expected'),
    [
        (75.0, 72.5, 77.5, 0.0),
        (72.5, 72.5, 77.5, 0.0),
        (155.0, 72.5, 77.5, 0.5),
        (29.0, 72.5, 77.5, 0.6),
        (-3.0, 0.001, math.inf, 1.0),
        (math.nan, 0.0, 1.0, 1.0),
        (math.inf, -math.inf, 1.0, 1.0),
        (math.inf, 1.0, math.inf, 0.0),
    ],
)
def test_distance(value: float, least: float, most: float, expected: float) -> None:
    assert distance(value, least, most) == pytest.approx(expected)


def test_distance_has_no_unit() -> None:
    assert distance(4e-3, most=1e-3) == pytest.approx(distance(4.0, most=1.0))


def test_unmet_demands_are_charged_and_met_ones_are_not() -> None:
    assert charge([0.0, 0.0]) == 0.0
    assert charge([0.0, 0.5, 1.0]) == pytest.approx(0.75 + 1.0)
    assert Evaluation(demands={'met': 0.0, 'unmet': 0.5}).cost == pytest.approx(0.75)


def test_statements_are_about_models_that_are_run() -> None:
    runs = {model for model, _ in CASES}
    for said in statements():
        assert models_of(said) <= runs, said.name
    named = {said.name: models_of(said) for said in statements()}
    assert named['y_linear_position_75_hz'] == {'as_built'}
    assert named['y_rotate_flexible_rms'] == {'flexible', 'as_built'}


def test_a_candidate_that_is_the_shipped_machine_steps_as_it_does() -> None:
    """In memory, by machine and I-variables, and from the model file: the same, bit for bit."""
    own = load_model('as_built').of_axes('pmac')
    candidate = CandidateRuns({'as_built': Stepped(load_machine('as_built'), own)})
    ours = candidate['as_built', 'y_rotate']
    shipped = run_step('as_built', 'y_rotate')
    for one, other in zip(ours.responses, shipped.responses, strict=True):
        assert np.array_equal(one.position, other.position)
        assert np.array_equal(one.current, other.current)
    assert candidate['as_built', 'y_rotate'] is ours


def test_models_that_a_candidate_does_not_have_come_from_beside() -> None:
    shipped = CandidateRuns({'rigid': Stepped(load_machine('rigid'), {})})
    candidate = CandidateRuns({}, shipped)
    assert candidate['rigid', 'x_rotate'] is shipped['rigid', 'x_rotate']
    with pytest.raises(KeyError):
        candidate['flexible', 'x_rotate']
