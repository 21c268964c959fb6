# SPDX-License-Identifier: Apache-2.0
"""Fig. 4.3: the mathematical plant in closed loop beside the multibody plant."""

from __future__ import annotations

import json

import numpy as np
import pytest

from waferbot_twin.cli.main import main
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.plan import make_plan
from waferbot_twin.plant_difference import is_mathematical, multibody_plan, plant_differences


def test_multibody_plan_is_that_of_the_rigid_machine() -> None:
    plan = make_plan('mathematical', 'step', 0.05)
    assert is_mathematical(plan)
    other = multibody_plan(plan)
    assert not is_mathematical(other)
    rigid = make_plan('rigid', 'step', 0.05)
    one, two = (
        Twin.of(each.model, each.timing, each.experiment).advance(each.ticks)
        for each in (other, rigid)
    )
    assert np.array_equal(one.line_current, two.line_current)


def test_both_plants_count_the_same_within_a_count() -> None:
    differences = {one.axis: one for one in plant_differences(make_plan('mathematical', 'step'))}
    assert set(differences) == {'y_linear', 'x_rotate', 'y_rotate'}
    for one in differences.values():
        assert one.largest_counts <= 1
        assert one.largest == pytest.approx(one.largest_counts * (one.largest or 1.0))
        assert 0.0 < one.rms < one.largest  # two programs, not one twice
        assert one.travel > 100.0 * one.largest


@pytest.mark.slow
def test_run_prints_the_difference(capsys, tmp_path) -> None:
    run = ['run', '--engine', 'inprocess', '--experiment', 'step_y_rotate', '--duration', '0.2']
    assert main([*run, '--model', 'mathematical', '--out', str(tmp_path / 'run')]) == 0
    printed = capsys.readouterr().out
    assert 'difference to the multibody plant, y_rotate: at most' in printed
    assert main([*run, '--model', 'rigid', '--json']) == 0
    assert 'difference' not in json.loads(capsys.readouterr().out)
    assert main(['replay', str(tmp_path / 'run'), '--node', 'plant']) == 0
