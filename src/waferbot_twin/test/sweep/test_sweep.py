# SPDX-License-Identifier: Apache-2.0
"""Sweeps: points, runs beside single ones, resuming, sensitivities against a closed form, optimising."""

from __future__ import annotations

import json
import time

import numpy as np
import pandas as pd
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.evaluations import as_they_end
from waferbot_twin.models import load_model
from waferbot_twin.sweep import sweep
from waferbot_twin.sweep.evaluation import Task, evaluate
from waferbot_twin.sweep.sensitivity import sensitivities
from waferbot_twin.sweep.variation import parse_variations, points
from waferbot_twin.tuning.runs import behave

SHORT = """\
name: short
duration_s: 0.1
motion:
  y_rotate: {kind: step, start_s: 0.02, amplitude_counts: 1000}
"""


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


def variations_of(rigid, *texts):
    return parse_variations(texts, rigid)


GAINS = ('pmac.y_rotate.Ixx30=3000:7000:3', 'pmac.y_rotate.Ixx31=2500:4500:2')


def task_of(rigid, texts=GAINS, measures=('overshoot_percent.y_rotate',)):
    variations = variations_of(rigid, *texts)
    return Task(rigid, tuple(one.path for one in variations), SHORT, measures), variations


def test_a_grid_is_all_combinations(rigid):
    found = points(variations_of(rigid, *GAINS), 'grid', 0, 0)
    assert found.tolist() == [
        [3000, 2500], [3000, 4500], [5000, 2500], [5000, 4500], [7000, 2500], [7000, 4500]
    ]  # fmt: skip


def test_sobols_points_fill_the_ranges_evenly_and_by_their_seed(rigid):
    variations = variations_of(rigid, 'bodies.carriage.mass_kg=4:6', GAINS[0])
    found = points(variations, 'sobol', 64, 3)
    assert found.shape == (64, 2)
    np.testing.assert_array_equal(found, points(variations, 'sobol', 64, 3))
    # One point in each of 64 strips of the first parameter: what a random sample has not.
    strips = np.floor((found[:, 0] - 4.0) / 2.0 * 64)
    assert len(set(strips)) == 64
    assert (found[:, 1] == np.rint(found[:, 1])).all()  # a register holds whole numbers
    assert points(variations, 'saltelli', 16, 0).shape == (16 * 4, 2)


def test_every_point_is_the_run_of_that_model(rigid):
    task, variations = task_of(rigid)
    made = points(variations, 'grid', 0, 0)
    table = sweep.run(task, made, 1, None)
    for place in (0, 5):
        gains = {'Ixx30': int(made[place, 0]), 'Ixx31': int(made[place, 1])}
        variant = rigid.with_overlay(Overlay(pmac={'y_rotate': gains}))
        alone = behave(variant, load_experiment(SHORT), Timing())['y_rotate']
        assert table['overshoot_percent.y_rotate'][place] == alone.overshoot_percent


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(rigid):
    task, variations = task_of(rigid)
    made = points(variations, 'grid', 0, 0)
    pd.testing.assert_frame_equal(sweep.run(task, made, 1, None), sweep.run(task, made, 2, None))


def test_a_sweep_that_was_broken_off_goes_on_and_runs_nothing_twice(rigid, tmp_path, monkeypatch):
    task, variations = task_of(rigid, ('pmac.y_rotate.Ixx30=3000:7000:20',))
    made = points(variations, 'grid', 0, 0)
    ran = []

    def counted(one, point, stop_behind):
        if len(ran) >= stop_behind:
            raise KeyboardInterrupt
        ran.append(float(point[0]))
        return evaluate(one, point)

    monkeypatch.setattr(sweep, 'evaluate', lambda one, point: counted(one, point, 11))
    with pytest.raises(KeyboardInterrupt):
        sweep.run(task, made, 1, tmp_path / 'parts')
    assert len(ran) == 11
    monkeypatch.setattr(sweep, 'evaluate', lambda one, point: counted(one, point, 1000))
    table = sweep.run(task, made, 1, tmp_path / 'parts')
    assert sorted(ran) == sorted(made[:, 0].tolist())
    monkeypatch.undo()
    pd.testing.assert_frame_equal(table, sweep.run(task, made, 1, None))
    with pytest.raises(UserError, match='broken off, of another model'):
        sweep.run(task, made[:5], 1, tmp_path / 'parts')


def test_a_line_that_was_not_written_to_its_end_is_run_again_and_nothing_else(
    rigid, tmp_path, monkeypatch
):
    task, variations = task_of(rigid, ('pmac.y_rotate.Ixx30=3000:7000:6',))
    made, parts = points(variations, 'grid', 0, 0), tmp_path / 'parts'
    whole = sweep.run(task, made, 1, parts)
    file = parts / 'runs.jsonl'
    file.write_bytes(file.read_bytes()[:-3])  # the process was killed while it wrote the sixth
    ran = []
    monkeypatch.setattr(
        sweep, 'evaluate', lambda one, point: ran.append(point[0]) or evaluate(one, point)
    )
    pd.testing.assert_frame_equal(sweep.run(task, made, 1, parts), whole, check_exact=True)
    assert ran == [made[5, 0]]
    assert len(file.read_text('utf-8').splitlines()) == 6
    file.write_text('[0, [1.0], ""]\nnone\n', 'utf-8')
    with pytest.raises(UserError, match=r'runs\.jsonl, line 2 is no run of a sweep'):
        sweep.run(task, made, 1, parts)


def test_no_process_waits_for_another(tmp_path):
    """While one run does not end, the other process makes all that are left, each kept as it ends."""

    def first_waits_for_last(point):
        deadline = time.monotonic() + 60.0
        while point[0] == 0 and not (tmp_path / '11').exists():
            assert time.monotonic() < deadline, 'the other process waits as well'
            time.sleep(0.01)
        (tmp_path / f'{point[0]:.0f}').touch()
        return point[0]

    found = list(as_they_end(first_waits_for_last, np.arange(12.0)[:, None], 2))
    assert sorted(place for place, _ in found) == list(range(12))
    assert all(result == place for place, result in found)


def test_infinite_and_missing_measures_are_kept_as_they_are(rigid, tmp_path, monkeypatch):
    task, variations = task_of(rigid, ('pmac.y_rotate.Ixx30=3000:7000:3',))
    made = points(variations, 'grid', 0, 0)
    given = iter([([np.inf] * 2, ''), ([np.nan] * 2, 'no machine'), ([1 / 3] * 2, '')])
    monkeypatch.setattr(sweep, 'evaluate', lambda one, point: next(given))
    whole = sweep.run(task, made, 1, tmp_path / 'parts')
    again = sweep.run(task, made, 1, tmp_path / 'parts')
    pd.testing.assert_frame_equal(again, whole, check_exact=True)
    assert list(again['error']) == ['', 'no machine', '']


def test_a_machine_that_cannot_be_is_a_row_that_says_so(rigid):
    task, _ = task_of(rigid, ('bodies.carriage.mass_kg=4:6',))
    values, error = evaluate(task, np.array([-5.0]))
    assert np.isnan(values[0])
    assert 'mass' in error


def test_sensitivities_of_a_sum_are_the_shares_of_its_variance(rigid):
    """f = 2 a + b over ranges of widths 2 and 1: variances 4 x 4 and 1, so 16/17 and 1/17."""
    variations = variations_of(
        rigid, 'bodies.carriage.mass_kg=4:6', 'bodies.counterweight.mass_kg=40:41'
    )
    made = points(variations, 'saltelli', 512, 1)
    table = pd.DataFrame({'f': 2.0 * made[:, 0] + made[:, 1]})
    found = sensitivities(variations, table, ['f'], 1).set_index('parameter')
    assert found.loc['bodies.carriage.mass_kg', 'first'] == pytest.approx(16 / 17, abs=0.02)
    assert found.loc['bodies.counterweight.mass_kg', 'first'] == pytest.approx(1 / 17, abs=0.02)
    assert found.loc['bodies.counterweight.mass_kg', 'total'] == pytest.approx(1 / 17, abs=0.02)
    table.loc[3, 'f'] = np.inf
    with pytest.raises(UserError, match='1 of 2048 runs'):
        sensitivities(variations, table, ['f'], 1)


def test_the_command_writes_table_picture_and_summary(tmp_path, capsys):
    file, out = tmp_path / 'short.yaml', tmp_path / 'out'
    file.write_text(SHORT, 'utf-8')
    arguments = ['sweep', '--model', 'rigid', '--experiment', str(file), '--workers', '1']
    for text in GAINS:
        arguments += ['--vary', text]
    arguments += ['--measure', 'overshoot_percent.y_rotate', '--out', str(out)]
    assert main([*arguments, '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    table = pd.read_parquet(out / 'sweep.parquet')
    assert len(table) == 6
    least = told['measures']['overshoot_percent.y_rotate']
    assert least['least'] == pytest.approx(table['overshoot_percent.y_rotate'].min())
    assert (out / 'sweep.png').exists()
    assert not sweep.parts_folder(out).exists()


def test_why_points_failed_is_printed(tmp_path, capsys):
    file = tmp_path / 'short.yaml'
    file.write_text(SHORT, 'utf-8')
    arguments = ['sweep', '--model', 'rigid', '--experiment', str(file), '--workers', '1']
    arguments += [
        '--vary',
        'bodies.carriage.mass_kg=-5:4:2',
        '--measure',
        'rms_current_a.y_rotate',
    ]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert '2 points, 1 of them failed' in out
    assert 'mass' in out.split('failed: ')[1]


def test_the_best_gains_within_limits_are_found(tmp_path, capsys):
    """More damping, less overshoot: with a limit of 20 % the smallest gain that keeps it."""
    file, out = tmp_path / 'short.yaml', tmp_path / 'best.yaml'
    file.write_text(SHORT, 'utf-8')
    arguments = ['optimise', '--model', 'rigid', '--experiment', str(file), '--generations', '6']
    arguments += ['--vary', 'pmac.y_rotate.Ixx31=2000:12000', '--json']
    arguments += ['--minimise', 'peak_current_a.y_rotate']
    assert main([*arguments, '--limit', 'overshoot_percent.y_rotate<20', '--out', str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['limits_kept']
    assert found['measures']['overshoot_percent.y_rotate'] <= 20.0
    assert found['before']['overshoot_percent.y_rotate'] > 20.0
    gain = load_model(str(out)).of_axes('pmac')['y_rotate']['Ixx31']
    assert gain == found['point']['pmac.y_rotate.Ixx31']
    assert main([*arguments, '--limit', 'overshoot_percent.y_rotate<-90']) == 1


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['--vary', 'pmac.y_rotate.Ixx30', '--measure', 'settling_time.y_rotate'], 'PATH=low:high'),
        (['--vary', 'pmac.y_rotate.Ixx30=5:1', '--measure', 'settling_time.y_rotate'], 'less than'),
        (['--vary', 'pmac.y_rotate.Ixx3=1:5', '--measure', 'settling_time.y_rotate'], 'no setting'),
        (['--vary', 'pmac.y_rotate.Ixx30=1:5', '--measure', 'setling_time.y_rotate'], 'settling_time'),
        (['--vary', 'pmac.y_rotate.Ixx30=1:5', '--measure', 'settling_time.z'], "FIGURE.AXIS"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(arguments, said, capsys):
    assert main(['sweep', '--model', 'rigid', *arguments]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count('\n') == 1
