# SPDX-License-Identifier: Apache-2.0
"""Pareto fronts: against closed forms, within limits, the same from any number of processes."""

from __future__ import annotations

import json
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.sweep import front_report, populations
from waferbot_twin.sweep.evaluation import Task
from waferbot_twin.sweep.limits import Limit, parse_limits
from waferbot_twin.sweep.nsga2 import nondominated, nsga2
from waferbot_twin.sweep.optimise import optimise
from waferbot_twin.sweep.pareto import pareto_front
from waferbot_twin.sweep.variation import parse_variations

pytest.importorskip('pymoo', reason='several --minimise need pymoo, which is not installed')

SHORT = """\
name: short
duration_s: 0.1
motion:
  y_rotate: {kind: step, start_s: 0.02, amplitude_counts: 1000}
"""
GAINS = ('pmac.y_rotate.Ixx30=2000:8000', 'pmac.y_rotate.Ixx31=2000:8000')
CURRENT, ERROR = 'peak_current_a.y_rotate', 'rms_following_error.y_rotate'
OVERSHOOT = 'overshoot_percent.y_rotate'


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


def task_of(rigid, varied=GAINS, measures=(CURRENT, ERROR), limits=()):
    variations = parse_variations(varied, rigid)
    task = Task(rigid, tuple(one.path for one in variations), SHORT, measures)
    return task, variations, parse_limits(limits, rigid)


def test_a_front_is_the_one_of_the_closed_form():
    """
    Of f1 = x^2 + z^2 and f2 = (x - 2)^2 + z^2 with x >= 0.5.

    z = 0 on the front and x from 0.5 to 2: sqrt(f1) + sqrt(f2) = 2, sqrt(f1) >= 0.5.
    """

    def evaluate(points):
        x, z = points.T
        return np.column_stack([x**2 + z**2, (x - 2.0) ** 2 + z**2]), 0.5 - x[:, None]

    low, high = np.array([-4.0, -4.0]), np.array([4.0, 4.0])
    found = nsga2(evaluate, 2, 1, low, high, lambda points: points, 40, 60)
    objectives, violations = evaluate(found)
    assert (violations <= 0.0).all()
    first, second = np.sqrt(objectives[nondominated(objectives, objectives)]).T
    np.testing.assert_allclose(first + second, 2.0, atol=0.03)
    assert np.median(first + second) < 2.001
    # From one end to the other, without gaps.
    ends = np.concatenate([[0.5], np.sort(first), [2.0]])
    assert np.diff(ends).max() < 0.15
    np.testing.assert_array_equal(
        found, nsga2(evaluate, 2, 1, low, high, lambda points: points, 40, 60)
    )


def test_a_point_is_dominated_by_what_is_nowhere_worse_and_somewhere_better():
    values = np.array([[1.0, 3.0], [2.0, 2.0], [2.0, 2.0], [2.0, 3.0], [3.0, 1.0], [3.0, 2.0]])
    assert nondominated(values, values).tolist() == [True, True, True, False, True, False]


def test_nothing_that_was_run_and_keeps_the_limits_dominates_the_front(rigid, monkeypatch):
    """Of an analytic machine, which cannot be in a part of the range; and gains are whole numbers."""

    def evaluate(task, point):
        a, b = point / 1000.0
        if a + b > 12.0:
            return [np.nan] * len(task.measures), 'the machine cannot be'
        values = {CURRENT: a * a + 0.1 * b, ERROR: (a - 6.0) ** 2 + 0.1 * b, OVERSHOOT: 9.0 - b}
        return [values[name] for name in task.measures], ''

    monkeypatch.setattr(populations, 'evaluate', evaluate)
    task, variations, limits = task_of(rigid, limits=[f'{OVERSHOOT}<5'])
    found = pareto_front(task, variations, limits, 10)
    points, front = found.points, found.front
    assert (points['error'] != '').any()
    assert not points['limits_kept'][points['error'] != ''].any()
    assert (front[OVERSHOOT] <= 5.0).all()
    assert (front[CURRENT].diff().dropna() > 0.0).all()
    assert (front[ERROR].diff().dropna() < 0.0).all()
    kept = points[points['limits_kept']]
    for _, row in front.iterrows():
        no_worse = (kept[CURRENT] <= row[CURRENT]) & (kept[ERROR] <= row[ERROR])
        assert (kept[no_worse][[CURRENT, ERROR]] == row[[CURRENT, ERROR]]).all(axis=None)
    paths = list(found.paths)
    assert (points[paths] == points[paths].round()).all(axis=None)
    assert not points.duplicated(paths).any()
    # The limit costs current, so the best points are on it: b = 4000.
    assert 4000.0 <= front[paths[1]].min() < 4050.0
    assert front[paths[1]].median() < 4500.0
    assert len(found.variants) == len(front) > 20
    for variant, (_, row) in zip(found.variants[::9], list(front.iterrows())[::9], strict=True):
        assert variant.pmac['y_rotate']['Ixx30'] == row[paths[0]]


def test_a_range_with_fewer_points_than_a_population_is_a_front_without_twins(rigid, monkeypatch):
    def evaluate(task, point):
        return [point[0], -point[0]], ''

    monkeypatch.setattr(populations, 'evaluate', evaluate)
    task, variations, _ = task_of(rigid, ['pmac.y_rotate.Ixx30=2000:2010'])
    found = pareto_front(task, variations, (), 20)
    assert found.front[CURRENT].tolist() == list(range(2000, 2011))


def test_the_picture_shows_the_front_and_no_outlier_makes_it_small(rigid, monkeypatch, tmp_path):
    def evaluate(task, point):
        a = point[0] / 1000.0
        values = {CURRENT: a, ERROR: 1.0 / a if a < 7.0 else 1e6, OVERSHOOT: a}
        return [values[name] for name in task.measures], ''

    monkeypatch.setattr(populations, 'evaluate', evaluate)
    shown = []
    monkeypatch.setattr(front_report, 'save_picture', lambda figure, file: shown.append(figure))
    task, variations, limits = task_of(rigid, limits=[f'{OVERSHOOT}<7'])
    found = pareto_front(task, variations, limits, 2)
    front_report.draw(found, tmp_path / 'front.png')
    panel = shown[0].axes[0]
    for (low, high), name in ((panel.get_xlim(), CURRENT), (panel.get_ylim(), ERROR)):
        assert low < found.front[name].min() < found.front[name].max() < high
        assert np.ptp(found.front[name]) > 0.3 * (high - low)
    plt.close(shown[0])


def test_current_against_error_of_a_step(rigid):
    """The first current of a step is the proportional gain times the step: it is known beforehand."""
    task, variations, limits = task_of(rigid, limits=[f'{OVERSHOOT}<40'])
    found = pareto_front(task, variations, limits, 2)
    front = found.front
    before = found.before[CURRENT] / variations[0].parameter.start
    np.testing.assert_allclose(front[CURRENT] / front['pmac.y_rotate.Ixx30'], before, rtol=2e-3)
    assert (front[OVERSHOOT] <= 40.0).all()
    assert not found.points['limits_kept'].all()
    assert len(front) > 5


@pytest.mark.slow
def test_two_processes_find_the_same_to_the_last_bit(rigid):
    task, variations, limits = task_of(rigid, limits=[f'{OVERSHOOT}<40'])
    one, two = (pareto_front(task, variations, limits, 1, workers) for workers in (1, 2))
    pd.testing.assert_frame_equal(one.points, two.points, check_exact=True)
    assert [variant.text for variant in one.variants] == [each.text for each in two.variants]
    one, two = (optimise(task, variations, limits, 2, workers) for workers in (1, 2))
    assert one.point == two.point
    assert one.measures == two.measures


def test_no_run_that_ends_is_an_error(rigid, monkeypatch):
    monkeypatch.setattr(
        populations, 'evaluate', lambda task, point: ([np.inf] * len(task.measures), 'blew up')
    )
    task, variations, _ = task_of(rigid)
    with pytest.raises(UserError, match='no point within these ranges'):
        pareto_front(task, variations, [Limit(CURRENT, 5.0)], 1)


@pytest.fixture
def command(tmp_path):
    file = tmp_path / 'short.yaml'
    file.write_text(SHORT, 'utf-8')
    arguments = ['optimise', '--model', 'rigid', '--experiment', str(file), '--workers', '1']
    arguments += ['--generations', '1', '--minimise', CURRENT]
    return [*arguments, *(word for text in GAINS for word in ('--vary', text))]


def test_the_command_writes_points_picture_summary_and_models(command, tmp_path, capsys):
    out = tmp_path / 'out'
    asked = [*command, '--minimise', ERROR, '--limit', f'{OVERSHOOT}<40', '--out', str(out)]
    assert main([*asked, '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((out / 'front.json').read_text('utf-8'))
    assert told['minimised'] == [CURRENT, ERROR]
    points = pd.read_parquet(out / 'points.parquet')
    assert len(points) == told['runs'] == 80
    last = told['front'][-1]
    assert points['front'].max() == len(told['front'])
    row = points[points['front'] == len(told['front'])].iloc[0]
    assert row[CURRENT] == last['measures'][CURRENT]
    gains = load_model(str(out / last['model'])).of_axes('pmac')['y_rotate']
    assert gains['Ixx31'] == last['point']['pmac.y_rotate.Ixx31']
    assert (out / 'front.png').exists()
    assert main(asked) == 1
    assert '--force' in capsys.readouterr().err


def test_three_objectives_and_a_limit_that_no_point_keeps(command, tmp_path, capsys):
    out = tmp_path / 'out'
    asked = [*command, '--minimise', ERROR, '--minimise', OVERSHOOT]
    assert main([*asked, '--limit', f'{CURRENT}<0.1', '--out', str(out)]) == 1
    captured = capsys.readouterr()
    assert '80 runs; no point keeps the limits' in captured.out
    assert len(pd.read_parquet(out / 'points.parquet')) == 80
    assert (out / 'front.png').exists()
    assert not list(out.glob('model_*'))


@pytest.mark.parametrize('module', ['pymoo.algorithms.moo.nsga2', 'pyarrow'])
def test_what_is_not_installed_is_said_in_one_line(command, tmp_path, capsys, monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    out = tmp_path / 'out'
    assert main([*command, '--minimise', ERROR, '--out', str(out)]) == 1
    error = capsys.readouterr().err
    assert f'python -m pip install {module.partition(".")[0]}\n' in error
    assert error.count('\n') == 1
    assert not out.exists()
