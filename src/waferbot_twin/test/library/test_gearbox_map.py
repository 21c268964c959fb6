# SPDX-License-Identifier: Apache-2.0
"""A gearbox's map from its test: known maps are found again, with errors that hold; what is not told."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_plant.friction_laws import table_part
from waferbot_plant.plant import load_machine
from waferbot_twin.cli.main import main
from waferbot_twin.library.gearbox_points import Points, points_of, read_points, standard_error
from waferbot_twin.library.loss_map import (
    LossMap,
    by_quarter,
    empty_cells,
    fit,
    from_zero,
    nodes_of,
)

RATIO = -50.0
SPEEDS = np.array([20.0, 80.0, 200.0])
LOADS = np.array([0.1, 0.4, 1.0])
LOSSES = np.array([[0.020, 0.025, 0.05], [0.035, 0.045, 0.06], [0.090, 0.080, 0.11]])
TRUE = LossMap(SPEEDS, LOADS, LOSSES, 0.0 * LOSSES, np.zeros(0), np.nan)


def bench(seed: int, noise: float = 2e-3, samples: int = 40):
    """Samples of a test at 60 points in all quarters: labels, speed, torques in and out."""
    random = np.random.default_rng(seed)
    rows = []
    for point in range(60):
        speed = random.uniform(20.0, 200.0) * random.choice([-1.0, 1.0])
        torque = random.uniform(0.1, 1.0) * random.choice([-1.0, 1.0])
        loss = float(TRUE.at(np.array([abs(speed)]), np.array([abs(torque)]))[0])
        out = RATIO * (torque - np.sign(speed) * loss)
        wobble = random.normal(0.0, noise, (2, samples))
        rows += [
            (point, speed, torque + a, out + RATIO * b) for a, b in wobble.T
        ]  # fmt: skip
    return np.array(rows).T


def test_a_known_map_is_found_to_rounding_without_noise() -> None:
    points = points_of(*bench(1, noise=0.0, samples=1), RATIO)
    found = fit(points, SPEEDS, LOADS)
    assert found.losses == pytest.approx(LOSSES, rel=1e-9)
    assert found.rms < 1e-12
    assert np.isnan(found.scatter)
    assert not empty_cells(points, found)
    assert sum(count for count, _ in by_quarter(points, found).values()) == 60


def test_its_errors_hold_over_many_tests() -> None:
    """Of 60 tests x 9 nodes, as many within two standard errors as there should be, and no bias."""
    off = []
    for seed in range(60):
        found = fit(points_of(*bench(seed), RATIO), SPEEDS, LOADS)
        off.append((found.losses - LOSSES) / found.errors)
    share = np.mean(np.abs(off) < 2.0)
    print(f'within two standard errors: {share:.3f}, spread {np.std(off):.2f}')
    assert 0.92 < share < 0.99
    assert 0.8 < np.std(off) < 1.2
    assert np.abs(np.mean(off, axis=0)).max() < 4.0 / np.sqrt(60)


def test_the_error_of_a_point_is_from_blocks_and_sees_what_is_slow() -> None:
    """White noise: sigma / sqrt(n). A drift that a sample-by-sample error would not see: its size."""
    random = np.random.default_rng(7)
    found = [standard_error(random.normal(0.0, 1.0, 400)) for _ in range(200)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0 / 20.0, rel=0.06)
    slow = np.repeat(random.normal(0.0, 1.0, 10), 40)
    assert standard_error(slow) == pytest.approx(np.std(slow[::40], ddof=1) / np.sqrt(10))
    assert np.isnan(standard_error(np.ones(1)))


def test_losses_are_the_same_in_all_quarters_and_what_differs_shows() -> None:
    speed = np.repeat([-50.0, -50.0, 50.0, 50.0], 3)
    torque = np.tile([0.2, 0.5, 0.9], 4) * np.repeat([-1.0, 1.0, 1.0, -1.0], 3)
    loss = 0.05 + np.repeat([0.0, 0.01, 0.0, 0.01], 3)
    points = points_of(
        np.arange(12.0), speed, torque, RATIO * (torque - np.sign(speed) * loss), RATIO
    )
    assert points.loss == pytest.approx(loss, rel=1e-9)
    quarters = by_quarter(points, fit(points))
    assert quarters['forward, driving'] == (3, pytest.approx(-0.005))
    assert quarters['backward, driven'] == (3, pytest.approx(0.005))
    half = points_of(np.arange(3.0), speed[6:9], torque[6:9], RATIO * torque[6:9] * 0.9, RATIO)
    assert by_quarter(half, fit(half))['backward, driving'][0] == 0


def points_at(speed, load) -> Points:
    speed, load = np.array(speed, float), np.array(load, float)
    return Points(speed, load, 0.1 * load, np.full(len(speed), 1e-3))


def test_nodes_that_nothing_supports_are_named() -> None:
    """No point at high speed with high load: that corner, and no other, is refused."""
    points = points_at([10, 10, 100, 55], [0.1, 1.0, 0.1, 0.1])
    with pytest.raises(UserError, match=r'support the map at 100 rad/s with 1 Nm; measure'):
        fit(points, [10.0, 100.0], [0.1, 1.0])
    with pytest.raises(UserError, match=r'at 200 rad/s with 0.1 Nm, 200 rad/s with 1 Nm;'):
        fit(points_at([10, 10, 100, 100], [0.1, 1.0, 0.1, 1.0]), [10.0, 100.0, 200.0], [0.1, 1.0])


def test_cells_without_points_are_told() -> None:
    points = points_at([10, 10, 100, 100, 90], [0.1, 1.0, 0.1, 1.0, 0.9])
    found = fit(points, [10.0, 100.0], [0.1, 1.0])
    assert empty_cells(points, found) == []
    assert empty_cells(points_at([10, 10], [0.1, 0.2]), found)[:1] == []
    assert empty_cells(points_at([200, 200], [0.1, 0.2]), found) == [(10.0, 100.0, 0.1, 1.0)]


def test_nodes_are_where_the_points_are() -> None:
    values = np.array([1.0, 1.02, 5.0, 5.1, 5.2, 9.9, 10.0])
    assert nodes_of(values, 8, 'loads') == pytest.approx([1.0, 5.1, 10.0])
    assert nodes_of(values[:2], 8, 'loads') == pytest.approx([1.01])
    with pytest.raises(UserError, match=r'the test has 3 loads, a map 2 at most: .* --loads'):
        nodes_of(values, 2, 'loads')
    with pytest.raises(UserError, match=r'--speeds must rise, from zero or more'):
        fit(points_at([1, 2], [1, 2]), [2.0, 1.0])


def test_a_map_from_zero_is_constant_below_its_first_nodes() -> None:
    whole = from_zero(TRUE)
    assert whole.speeds[0] == whole.loads[0] == 0.0
    speed, load = np.array([0.0, 5.0, 150.0, 500.0]), np.array([0.0, 0.7, 0.05, 3.0])
    assert whole.at(speed, load) == pytest.approx(TRUE.at(speed, load), rel=1e-14)


def written(path, columns, names):
    np.savetxt(path, columns, '%.9g', ',', header=','.join(names), comments='')
    return str(path)


NAMES = ['point', 'speed_rad_s', 'input_torque_nm', 'output_torque_nm']


def test_the_command_writes_what_a_description_takes(tmp_path, capsys) -> None:
    file = written(tmp_path / 'bench.csv', bench(3).T, NAMES)
    out, picture = tmp_path / 'map.yaml', tmp_path / 'map.png'
    grid = ['--speeds', '20', '80', '200', '--loads', '0.1', '0.4', '1']
    arguments = ['library', 'fit-gearbox', file, '--ratio', '-50', *grid]
    assert main([*arguments, '--out', str(out), '--plot', str(picture), '--json']) == 0
    told = capsys.readouterr()
    found = json.loads(told.out)
    off = (np.array(found['torque_nm']) - LOSSES) / np.array(found['standard_error_nm'])
    assert np.abs(off).max() < 4.0
    assert 'forward, driven: ' in told.err
    assert 'constant below 20 rad/s and 0.1 Nm' in told.err
    assert picture.stat().st_size > 10000
    entry = yaml.safe_load(out.read_text('utf-8'))['frictions']['gearbox_map']
    assert entry['torque_nm']['from'].startswith('bench.csv: 60 points, residuals of 0.000')
    friction = load_machine('rigid', overlays=[out]).description.frictions['gearbox_map']
    assert friction.resistances[1:, 1:] == pytest.approx(np.array(found['torque_nm']), rel=1e-5)
    _check_that_the_plant_has_it(out, found)
    assert main([*arguments, '--out', str(out)]) == 1
    assert 'exists; choose another name' in capsys.readouterr().err
    assert main([*arguments, '--out', str(out), '--force']) == 0
    assert '20 rad/s' in capsys.readouterr().out


def _check_that_the_plant_has_it(file, found) -> None:
    """What is fitted and what the plant makes of it are the same, between the nodes and beyond."""
    machine = load_machine('rigid', overlays=[file])
    parameters = machine.parameters()
    slot = list(machine.description.frictions).index('gearbox_map')
    fitted = replace(TRUE, losses=np.array(found['torque_nm']))
    speed, load = np.random.default_rng(5).uniform(0.0, [[260.0], [1.4]], (2, 50))
    of_plant = [table_part(parameters[0], slot, *at) for at in zip(speed, load, strict=True)]
    assert of_plant == pytest.approx(fitted.at(speed, load), rel=1e-5)


def test_as_many_points_as_nodes_have_no_errors_to_tell(tmp_path, capsys) -> None:
    """The motor drives in all of them: there are none of the other flank to draw."""
    rows = [(20.0, 0.2, 9.0), (20.0, 1.0, 46.0), (90.0, 0.2, 8.5), (90.0, 1.0, 45.0)]
    file = written(tmp_path / 'few.csv', rows, NAMES[1:])
    out, picture = tmp_path / 'map.yaml', tmp_path / 'map.png'
    arguments = ['library', 'fit-gearbox', file, '--ratio', '50', '--out', str(out)]
    assert main([*arguments, '--plot', str(picture)]) == 0
    assert picture.stat().st_size > 10000
    assert '±' not in capsys.readouterr().out
    assert 'nan' not in out.read_text('utf-8')
    found = load_machine('rigid', overlays=[out]).description.frictions['gearbox_map']
    assert found.resistances[1:, 1:] == pytest.approx(np.array([[0.02, 0.03], [0.08, 0.1]]))


def test_what_is_wrong_is_said_in_one_line(tmp_path, capsys) -> None:
    good = written(tmp_path / 'good.csv', bench(3, samples=1).T, NAMES)
    lacks = written(tmp_path / 'lacks.csv', bench(3, samples=1)[:3].T, NAMES[:3])
    still = written(tmp_path / 'still.csv', [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]], NAMES[1:])
    gap = written(tmp_path / 'gap.csv', [[1.0, 1.0, 1.0], [1.0, np.nan, 1.0]], NAMES[1:])
    out = ['--out', str(tmp_path / 'map.yaml')]
    for arguments, said in (
        ([good, *out], 'give the file of a test, its --ratio'),
        ([good, '--ratio', '0', *out], 'must be a number other than zero'),
        ([lacks, '--ratio', '50', *out], "no column 'output_torque_nm'"),
        ([still, '--ratio', '50', *out], 'point 0 stands still'),
        ([gap, '--ratio', '50', *out], 'gap.csv, line 3: a value is missing'),
        ([good, '--ratio', '50', '--plot', 'map.gif', *out], '.png'),
        ([str(tmp_path / 'no.csv'), '--ratio', '50', *out], 'no.csv'),
    ):
        assert main(['library', 'fit-gearbox', *arguments]) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count('\n') == 1
    assert not (tmp_path / 'map.yaml').exists()
    with pytest.raises(UserError, match='no column'):
        read_points(tmp_path / 'lacks.csv', 50.0)
