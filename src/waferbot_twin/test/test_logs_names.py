# SPDX-License-Identifier: Apache-2.0
"""Names of logs: as short as tells them apart, in every report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.names import names_of
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.load import load_records

FOLDERS = st.lists(st.sampled_from(['a', 'b', 'step', 'day']), min_size=1, max_size=4)


def test_a_log_has_the_name_of_its_folder_where_that_is_its_own() -> None:
    assert names_of([Path('/x/one'), Path('/y/two')]) == ['one', 'two']
    assert names_of([Path('/runs/mon/step'), Path('/runs/tue/step'), Path('/runs/sine')]) == [
        'mon/step',
        'tue/step',
        'sine',
    ]


def test_a_log_that_is_given_twice_has_a_number() -> None:
    assert names_of([Path('/x/one'), Path('/x/one'), Path('/y/two')]) == ['one', 'one (2)', 'two']


@given(st.lists(FOLDERS, min_size=1, max_size=5))
def test_names_differ_and_end_as_the_paths_do(several) -> None:
    paths = [Path('/root', *folders) for folders in several]
    names = names_of(paths)
    assert len(set(names)) == len(names)
    for path, name in zip(paths, names, strict=True):
        assert str(path).endswith(name.partition(' (')[0])


def _sliding(name, seed, noise_n):
    """A mass of 90 kg on a rail: sums of sines."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, 10.0, 1e-3)
    wave, phase = 2.0 * np.pi * random.uniform(0.3, 2.0, 4), random.uniform(0.0, 6.0, 4)
    angle = np.outer(time_s, wave) + phase
    position = 0.04 * np.sin(angle) @ np.ones(4)
    speed, acceleration = 0.04 * np.cos(angle) @ wave, -0.04 * np.sin(angle) @ wave**2
    force = 90.0 * acceleration + 200.0 * speed + 20.0 * np.sign(speed)
    force = force + noise_n * random.standard_normal(len(time_s))
    return MeasuredLog(
        name,
        (
            Signal('position', 'y_linear', 'm', time_s, position),
            Signal('force', 'y_linear', 'N', time_s, force),
        ),
    )


def test_logs_of_two_days_with_one_name_stay_two(tmp_path, capsys) -> None:
    for day, noise_n in (('monday', 0.5), ('tuesday', 20.0)):
        (tmp_path / day).mkdir()
        write_archive(_sliding('step', len(day), noise_n), tmp_path / day / 'step')
    paths = [tmp_path / day / 'step' for day in ('monday', 'tuesday')]
    command = ['identify', str(paths[0]), '--method', 'least-squares', '--json', '--validate']
    assert main([*command, str(paths[1])]) == 0
    (axis,) = json.loads(capsys.readouterr().out)['axes'].values()
    (fitted,), (judged,) = axis['errors'], axis['validation_errors']
    assert (fitted['log'], judged['log']) == ('monday/step', 'tuesday/step')
    assert judged['relative'] > 3.0 * fitted['relative']
    emps = Variant.of(load_model_or_machine('emps'))
    assert [one.name for one in load_records(paths, emps)] == ['monday/step', 'tuesday/step']
