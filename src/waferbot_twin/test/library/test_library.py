# SPDX-License-Identifier: Apache-2.0
"""The library: kept as text, ranges, priors of an identification, errors."""

from __future__ import annotations

import json

import pytest
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_plant.motors import force_constant
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.named_parameters import at_path
from waferbot_twin.library.entries import Entry, add, load, shipped
from waferbot_twin.library.from_report import part_of, read_entries
from waferbot_twin.library.ranges import draw, prior, table
from waferbot_twin.models import load_model

BELT = 'connections.belt.stiffness_n_m'

IDENTIFIED = {
    'schema': 1,
    'parameters': {
        BELT: {'value': 3.6e5, 'unit': 'N/m', 'low95': 3.5e5, 'high95': 3.7e5, 'identified': True},
        'bodies.carriage.mass_kg': {
            'value': 4.0, 'unit': 'kg', 'low95': None, 'high95': None, 'identified': False
        },
    },
}  # fmt: skip

DIAGNOSED = {
    'causes': [
        {
            'effect': 'gearbox_damping',
            'axis': 'y_rotate',
            'parameters': {
                'damping': {'value': 2e-4, 'unit': 'Nm s', 'low95': 1e-4, 'high95': 3e-4}
            },
        }
    ]
}


def report(folder, content):
    folder.mkdir()
    (folder / 'report.json').write_text(json.dumps(content), 'utf-8')
    return folder


def test_the_shipped_library_has_the_damping_of_chapter_5():
    rows = table(load(shipped())).set_index(['part', 'parameter'])
    assert rows.loc[('linear_guide', 'loss_factor'), 'low'] == 0.008
    assert rows.loc[('linear_guide', 'loss_factor'), 'high'] == 0.02  # 2.5 times, in chapter 6
    assert tuple(rows.loc[('belt', 'loss_factor'), ['low', 'high']]) == (0.001, 0.05)
    assert rows.loc[('shaft', 'loss_factor'), 'median'] == 0.003


def test_what_was_found_is_a_line_at_the_end_and_nothing_else_changes(tmp_path, capsys):
    file = tmp_path / 'parts.yaml'
    file.write_text('# ours\nschema: 1\nentries:  # by part\n', 'utf-8')
    found = report(tmp_path / 'found', IDENTIFIED)
    arguments = ['library', 'add', str(found), '--library', str(file), '--machine', 'robot_1']
    assert main([*arguments, '--date', '2026-03-01', '--temperature', '24', '--load', '2 kg']) == 0
    text = file.read_text()
    assert text.startswith('# ours\nschema: 1\nentries:  # by part\n')
    assert len(text.splitlines()) == 4  # what was left open is not in it
    (entry,) = load(file)
    assert (entry.part, entry.parameter, entry.value) == ('belt', 'stiffness_n_m', 3.6e5)
    assert (entry.low, entry.high, entry.machine, entry.date) == (
        3.5e5, 3.7e5, 'robot_1', '2026-03-01'
    )  # fmt: skip
    assert entry.conditions == {'temperature_degc': 24.0, 'load': '2 kg'}
    assert (
        main(['library', 'add', str(report(tmp_path / 'd', DIAGNOSED)), '--library', str(file)])
        == 0
    )
    assert load(file)[1].part == 'gearbox'
    assert load(file)[1].parameter == 'gearbox_damping.damping'
    assert yaml.safe_load(file.read_text())['entries'][0]['part'] == 'belt'
    capsys.readouterr()
    assert main(['library', 'list', '--library', str(file), '--json']) == 0
    assert [row['part'] for row in json.loads(capsys.readouterr().out)] == ['belt', 'gearbox']


@pytest.mark.parametrize(
    ('path', 'part'),
    [
        ('motors.y_linear.back_emf_lead_to_lead_v_s_m', 'motor'),
        ('connections.payload_bearing_x.loss_factor', 'linear_guide'),
        ('connections.x_rotate_bearing_y.stiffness_nm_rad', 'cross_roller_bearing'),
        ('frictions.x_rotate_ferrofluid.torque_nm[0]', 'ferrofluid_seal'),
        ('dampers.gearbox.damping_nm_s_rad', 'gearbox'),
        ('frictions.somewhere.force_n[0]', 'other'),
    ],
)
def test_the_name_of_a_path_says_which_part_it_is(path, part):
    assert part_of(path) == part


def test_a_prior_holds_what_was_seen_and_the_models_value():
    variant = Variant.of(load_model('flexible'))
    parameter = at_path(BELT, variant)
    known = (
        Entry('belt', 'stiffness_n_m', 3.6e5, 'N/m', 3.5e5, 3.7e5, path=BELT),
        Entry('belt', 'stiffness_n_m', 4.0e5, 'N/m', path='connections.other_belt.stiffness_n_m'),
        Entry('belt', 'stiffness_n_m', 9.0e9, 'N/m rad', path='another unit'),
    )
    low, high = prior(known[1:], parameter)
    assert low <= min(4.0e5, parameter.start)
    assert high >= max(4.0e5, parameter.start)
    assert high < 1e9
    own = prior(known, parameter)  # this very part was seen: that counts alone
    assert own[1] == pytest.approx(max(3.8e5, parameter.start))
    assert prior((), parameter) is None


@pytest.mark.slow
def test_identify_takes_ranges_from_the_library(tmp_path, capsys):
    log, out = tmp_path / 'log', tmp_path / 'out'
    assert main([
        'run', '--engine', 'inprocess', '--experiment', 'random_y_linear', '--duration', '1',
        '--out', str(log),
    ]) == 0  # fmt: skip
    path = 'bodies.carriage.mass_kg'
    start = at_path(path, Variant.of(load_model('rigid'))).start
    file = tmp_path / 'parts.yaml'
    add(file, (Entry('body', 'mass_kg', 1.1 * start, 'kg', path=path),))
    arguments = ['identify', str(log), '--parameter', path, '--library', str(file)]
    assert main([*arguments, '--out', str(out)]) == 0
    assert f'{path}: ' in capsys.readouterr().err
    found = json.loads((out / 'report.json').read_text())['parameters'][path]
    assert found['value'] == pytest.approx(start, rel=0.01)
    expected = prior(load(file), at_path(path, Variant.of(load_model('rigid'))))
    assert found['range'] == pytest.approx(expected)


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('entries: []', 'begins with schema: 1'),
        ('schema: 1\nentries: {a: 1}', 'must be a list'),
        ('schema: 1\nentries:\n  - {part: blet, parameter: a, value: 1}', "did you mean 'belt'"),
        ('schema: 1\nentries:\n  - {part: belt, value: 1}', 'parameter is missing'),
        ('schema: 1\nentries:\n  - {part: belt, parameter: a, value: much}', 'must be a number'),
        (
            'schema: 1\nentries:\n  - {part: belt, parameter: a, value: 1, colour: red}',
            'not known',
        ),
    ],
)
def test_what_is_wrong_in_a_library_is_named_with_its_line(tmp_path, text, said):
    file = tmp_path / 'parts.yaml'
    file.write_text(text + '\n', 'utf-8')
    with pytest.raises(UserError, match=r'parts\.yaml') as raised:
        load(file)
    assert said in str(raised.value)


def test_what_is_wrong_is_said_in_one_line(tmp_path, capsys):
    broken = report(tmp_path / 'broken', {'parameters': {'a': 1}})
    empty = report(tmp_path / 'empty', {'causes': []})
    file = str(tmp_path / 'parts.yaml')
    for arguments, said in (
        (['add', str(broken), '--library', file], 'damaged'),
        (['add', str(empty), '--library', file], 'nothing was identified'),
        (['add', str(tmp_path / 'no'), '--library', file], 'cannot be read'),
        (['add', str(empty)], '--library'),
        (['add', str(empty), '--library', file, '--date', 'today'], 'YYYY-MM-DD'),
        (['show', 'blet'], "did you mean 'belt'"),
        (['show', 'belt', '--plot', 'belt.gif'], '.png'),
    ):
        assert main(['library', *arguments]) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count('\n') == 1
    assert not (tmp_path / 'parts.yaml').exists()


def test_a_torque_constant_of_a_diagnosis_is_the_back_emf_that_its_path_names(tmp_path):
    key = 'motors.y_rotate.back_emf_lead_to_lead_v_s_rad'
    variant = Variant.of(load_model('rigid'))
    motor = variant.description.motors['y_rotate']
    correction = {
        'path': key, 'unit': 'Nm/A', 'found': force_constant(motor), 'low': 0.1, 'high': 0.2,
    }  # fmt: skip
    folder = report(tmp_path / 'diagnosis', {'causes': [], 'corrections': [correction]})
    (entry,) = read_entries(folder, 'mine', '2026-11-30', {})
    named = at_path(key, variant)
    assert entry.value == pytest.approx(named.start, rel=1e-12)
    assert entry.unit == named.unit
    assert entry.low / 0.1 == pytest.approx(entry.value / force_constant(motor), rel=1e-12)


def test_what_has_another_unit_is_another_quantity(tmp_path):
    newtons = [Entry('other', 'coulomb_friction.friction', value, 'N') for value in (20.0, 22.0)]
    torque = Entry('other', 'coulomb_friction.friction', 1.5, 'Nm')
    rows = table([newtons[0], torque, newtons[1]])
    assert rows['unit'].tolist() == ['N', 'Nm']
    assert rows['entries'].tolist() == [2, 1]
    assert rows['high'].tolist() == [22.0, 1.5]
    draw([*newtons, torque], tmp_path / 'ranges.png')
    assert (tmp_path / 'ranges.png').stat().st_size > 0
