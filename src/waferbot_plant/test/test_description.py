# SPDX-License-Identifier: Apache-2.0
"""Descriptions: what is wrong is said once, with file, line and key."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import plant_machines as machines
import pytest
import yaml

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_lockstep.errors import UserError
from waferbot_plant import plant
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import config_folder, load_machine

ROPE = {
    'rope': {
        'driving': 'first',
        'driven': 'second',
        'stages': [{'kind': 'cable', 'connection': 'rope'}],
    }
}


def broken(change) -> UserError:
    """Apply `change` to a sound description and return the error."""
    data = machines.two_slides(
        transmissions=copy.deepcopy(ROPE),
        connections={'rope': {'state': 'flexible', 'stiffness_n_m': 4000.0, 'loss_factor': 0.01}},
        encoders={'y_linear': {'coordinate': 'first', 'counts_per_m': 1000}},
        motors={
            'y_linear': {
                'coordinate': 'first',
                'winding': 'delta',
                'resistance_lead_to_lead_ohm': 2.0,
                'inductance_lead_to_lead_h': 0.01,
                'back_emf_lead_to_lead_v_s_m': 50.0,
                'electrical_cycle_m': 0.03,
            }
        },
    )
    load_description(machines.write(copy.deepcopy(data)))
    change(data)
    path = machines.write(data)
    with pytest.raises(UserError) as caught:
        load_description(path)
    assert str(path) in str(caught.value)
    lines = path.read_text().splitlines()
    number = int(str(caught.value).split(f'{path}, line ')[1].split(':')[0])
    assert 1 <= number <= len(lines)
    return caught.value


def _set(*keys_and_value):
    """Return a change that sets the value at a path of keys."""
    *keys, last, value = keys_and_value

    def change(data) -> None:
        for key in keys:
            data = data[key]
        data[last] = value

    return change


def _drop(*keys):
    """Return a change that removes the key at a path."""
    *above, last = keys

    def change(data) -> None:
        for key in above:
            data = data[key]
        del data[last]

    return change


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (_set('bodys', {}), ['bodys', "did you mean 'bodies'"]),
        (_set('bodies', 'first', 'mass', 3.0), ['bodies.first.mass', "'mass_kg'"]),
        (_drop('bodies', 'first', 'mass_kg'), ['bodies.first', 'mass_kg missing']),
        (
            _set('bodies', 'first', 'mass_kg', -2.0),
            ['bodies.first.mass_kg', '-2.0', 'greater than 0'],
        ),
        (
            _set('bodies', 'first', 'mass_kg', 'heavy'),
            ['bodies.first.mass_kg', "'heavy'", 'number'],
        ),
        (_set('bodies', 'first', 'mass_kg', float('nan')), ['bodies.first.mass_kg', 'finite']),
        (_set('bodies', 'first', 'centre_of_gravity_m', [0, 1]), ['centre_of_gravity_m', '3']),
        (
            _set('bodies', 'first', 'inertia_kg_m2', {'xx': 0.1, 'yy': 0.1, 'zz': 0.3}),
            ['bodies.first.inertia_kg_m2', 'sum of the other two'],
        ),
        (
            _set('bodies', 'first', 'inertia_kg_m2', {'xx': 0.1, 'yy': 0.1, 'zz': 0.1, 'xy': 0.2}),
            ['bodies.first.inertia_kg_m2', 'not positive definite'],
        ),
        (
            _set('joints', 'first_guide', 'parent', 'sceond'),
            ['joints.first_guide.parent', "'second'"],
        ),
        (_set('joints', 'first_guide', 'child', 'second'), ['child', "'first_guide' already"]),
        (_set('joints', 'first_guide', 'parent', 'first'), ['joints.first_guide', 'circle']),
        (
            lambda data: (
                data['joints']['first_guide'].update(parent='second'),
                data['joints']['second_guide'].update(parent='first'),
            ),
            ['joints run in a circle'],
        ),
        (
            _set('joints', 'first_guide', 'freedoms', 'first', 'axis', [0, 0, 0]),
            ['joints.first_guide.freedoms.first.axis', 'no direction'],
        ),
        (
            _set(
                'joints',
                'second_guide',
                'freedoms',
                {'first': {'type': 'prismatic', 'axis': [0, 1, 0]}},
            ),
            ['freedoms.first', 'already'],
        ),
        (_drop('joints', 'first_guide'), ['bodies.first', 'no joint']),
        (
            _set('joints', 'first_guide', 'freedoms', 'first', 'locked', True),
            ['axes.y_linear', 'first is locked', 'moves'],
        ),
        (
            _set('joints', 'first_guide', 'freedoms', 'first', 'locked', 'yes'),
            ['joints.first_guide.freedoms.first.locked', 'boolean'],
        ),
        (
            lambda data: data['joints']['second_guide']['freedoms']['second'].update(
                locked=True, held_by=['rope']
            ),
            ['joints.second_guide.freedoms.second.locked', 'leave out one'],
        ),
        (
            _set('transmissions', 'rope', 'driven', 'third'),
            ['transmissions.rope.driven', "'third'"],
        ),
        (
            _set(
                'transmissions',
                'back',
                {'driving': 'second', 'driven': 'first', 'stages': [{'kind': 'cable'}]},
            ),
            ['transmissions', 'circle'],
        ),
        (
            _set('transmissions', 'rope', 'stages', [{'kind': 'gear', 'ratio': 3}]),
            ['transmissions.rope.stages[0]', 'a gear is driven by an angle'],
        ),
        (
            _set('connections', 'rope', 'state', 'soft'),
            ['connections.rope.state', "'soft'", 'rigid'],
        ),
        (
            _drop('connections', 'rope', 'stiffness_n_m'),
            ['connections.rope', 'stiffness_n_m missing'],
        ),
        (
            _set('connections', 'rope', 'damping_n_s_m', 3.0),
            ['connections.rope', 'either loss_factor'],
        ),
        (
            lambda data: (
                data['connections']['rope'].pop('stiffness_n_m'),
                data['connections']['rope'].update(stiffness_nm_rad=3.0),
            ),
            ['connections.rope.stiffness_nm_rad', 'wrong unit', 'stiffness_n_m'],
        ),
        (
            _set('connections', 'spare', {'state': 'rigid', 'stiffness_n_m': 1, 'loss_factor': 0}),
            ['0 places'],
        ),
        (_set('connections', 'rope', 'part', 'thread'), ["no part 'thread'"]),
        (
            _set('motors', 'y_linear', 'pole_pairs', 4),
            ['motors.y_linear.pole_pairs', 'wrong unit'],
        ),
        (_set('motors', 'z_linear', {}), ['z_linear']),
        (_set('encoders', 'y_linear', 'counts_per_revolution', 4), ['wrong unit', 'counts_per_m']),
        (_set('encoders', 'y_linear', 'counts_per_m', 0), ['counts_per_m', 'must not be zero']),
        (_set('axes', 'y_linear', 'frist'), ['axes.y_linear', "'first'"]),
        (
            _set('titles', {'y_linear': 'Lift', 'x_rotate': 'Arm'}),
            ['titles.x_rotate', "no axis 'x_rotate'"],
        ),
        (_set('titles', {'lift': 'Lift'}), ['titles.lift', "no axis 'lift'"]),
        (_set('motors', 'lift', {}), ['motors.lift']),
        (_set('axes', {'lift': 'first'}), ['encoders', 'y_linear is on no axis']),
        (_set('axes', {'lift_motor': 'first'}), ['axes', 'lift_motor cannot be a name']),
        (_set('axes', {f'axis_{n}': 'first' for n in range(9)}), ['axes', '9 axes', '1 to 8']),
        (_set('titles', {'y_linear': ''}), ['titles.y_linear', 'must not be empty']),
        (_set('titles', {'y_linear': ' '}), ['titles.y_linear', 'must not be empty']),
        (_set('titles', {'y_linear': 3}), ['titles.y_linear', 'of type string']),
        (
            _set('frictions', {'f': {'coordinate': 'first', 'speed_m_s': [0, 1], 'force_n': [1]}}),
            ['frictions.f', '2 speeds but 1'],
        ),
        (
            _set(
                'frictions', {'f': {'coordinate': 'first', 'speed_m_s': [0, 0], 'force_n': [1, 1]}}
            ),
            ['frictions.f', 'rise from 0'],
        ),
        (
            _set('parts', {'p': {'kind': 'cable', 'diameter': 3}}),
            ['parts.p.diameter', 'nominal_diameter_m'],
        ),
        (_set('name', {'value': 'x', 'form': 'y'}), ['name', '{value, from}']),
    ],
)
def test_error_names_the_place_and_the_remedy(change, words: list[str]) -> None:
    message = str(broken(change))
    for word in words:
        assert word in message
    assert '\n' not in message


def test_error_gives_the_right_line() -> None:
    text = Path(machines.write(machines.two_slides())).read_text()
    lines = text.splitlines()
    row = next(place for place, line in enumerate(lines) if 'mass_kg' in line)
    lines[row] = lines[row].replace('2.0', '-2.0')
    path = machines.write(machines.two_slides())
    path.write_text('\n'.join(lines))
    with pytest.raises(UserError, match=f', line {row + 1}: bodies.first.mass_kg'):
        load_description(path)


def test_yaml_that_is_no_yaml(tmp_path: Path) -> None:
    path = tmp_path / 'm.yaml'
    path.write_text('name: x\nbodies: [1, 2\njoints: 3\n')
    with pytest.raises(UserError, match=r'm\.yaml, line \d+, column \d+: not valid YAML'):
        load_description(path)
    path.write_text('name: x\nname: y\n')
    with pytest.raises(UserError, match=r'm\.yaml, line 2: name is given twice, first on line 1'):
        load_description(path)
    path.write_text('- 1\n')
    with pytest.raises(UserError, match='must be a mapping'):
        load_description(path)
    with pytest.raises(UserError, match='cannot be read'):
        load_description(tmp_path / 'none.yaml')


def test_overlay_changes_a_value_and_is_blamed_for_its_errors(tmp_path: Path) -> None:
    path = tmp_path / 'heavier.yaml'
    path.write_text('bodies:\n  carriage:\n    mass_kg: 4.5\n')
    machine = load_machine('rigid', overlays=[path])
    assert machine.description.bodies['carriage'].mass == 4.5
    path.write_text('bodies:\n  carriage:\n    mass_kg: 0\n')
    with pytest.raises(UserError, match=r'heavier\.yaml, line 3: bodies\.carriage\.mass_kg'):
        load_machine('rigid', overlays=[path])
    machine = load_machine('rigid', overlays=[{'gravity_m_s2': [0, 0, 0]}])
    assert not machine.description.gravity.any()


def test_extends_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / 'a.yaml').write_text('extends: b.yaml\n')
    (tmp_path / 'b.yaml').write_text('extends: a.yaml\n')
    with pytest.raises(UserError, match='extends this file in turn'):
        load_description(tmp_path / 'a.yaml')


def test_switches_and_damping() -> None:
    machine = load_machine('rigid', {'cable': 'flexible'})
    assert machine.coordinates == ('y_linear', 'x_rotate', 'y_rotate', 'counterweight')
    with pytest.raises(UserError, match="did you mean 'cable'"):
        load_machine('rigid', {'cabel': 'flexible'})
    with pytest.raises(UserError, match='rigid or flexible'):
        load_machine('rigid', {'cable': 'soft'})
    with pytest.raises(UserError, match='calculated, improved'):
        load_machine('rigid', damping='better')
    losses = [
        load_machine('flexible', damping=damping).description.connections['payload_bearing_x']
        for damping in ('calculated', 'improved')
    ]
    assert [loss.loss_factor for loss in losses] == [0.008, 0.02]


def test_titles_are_the_machines_and_the_usual_ones_where_it_says_nothing() -> None:
    assert load_machine('rigid').description.titles == USUAL_TITLES
    gantry = load_machine('gantry').description
    assert gantry.titles == {'y_linear': 'Ram', 'x_rotate': 'Bridge', 'y_rotate': 'Carriage'}
    stage = load_machine('ball_screw_stage').description
    assert stage.titles == {**USUAL_TITLES, 'y_linear': 'Table'}
    data = machines.two_slides(titles={'y_linear': 'the\n  lift\n'})
    assert load_description(machines.write(data)).titles['y_linear'] == 'the lift'


def test_unknown_machine_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UserError, match=r"did you mean 'rigid'.*two_mass_drive"):
        load_machine('rigit')
    with pytest.raises(UserError, match='no such machine description'):
        load_machine('nowhere/rigid.yaml')


def test_every_description_that_comes_with_the_package_loads() -> None:
    folder = config_folder()
    files = [
        path
        for path in [*folder.glob('*.yaml'), *folder.glob('examples/*.yaml')]
        if 'joints' in (data := yaml.safe_load(path.read_text())) or 'extends' in data
    ]
    assert len(files) >= 7
    for path in files:
        assert load_machine(path).coordinates


def test_provenance_is_kept() -> None:
    provenance = load_machine('rigid').description.provenance
    assert provenance['gravity_m_s2'] == 'thesis (2.24)'
    assert 'calibrated' in provenance['parts.cable.cable_length_m']


@pytest.mark.parametrize(
    ('said', 'kind', 'value'),
    [
        ({'stiffness_n_m': 4000.0, 'loss_factor': 0.01}, 'loss_factor', 0.01),
        ({'stiffness_n_m': 4000.0, 'damping_n_s_m': 2.0}, 'damping', 2.0),
    ],
)
def test_a_connection_has_so_many_times_its_damping(said, kind, value) -> None:
    def damping_of(**more: float) -> float:
        data = machines.two_slides(
            transmissions=ROPE,
            connections={'rope': {'state': 'flexible', **said, **more}},
        )
        rope = load_description(machines.write(data)).connections['rope']
        return float(getattr(rope, kind))

    assert damping_of() == value
    assert damping_of(damping_factor=5.0) == pytest.approx(5.0 * value)
    with pytest.raises(UserError, match='damping_factor'):
        damping_of(damping_factor=0.0)


def test_axes_of_its_own_names_have_their_places_and_titles() -> None:
    machine = load_machine('puma_560')
    description, axes = machine.description, machine.layout.axes
    assert axes == ('waist', 'shoulder', 'elbow', 'wrist_roll', 'wrist_bend', 'flange')
    assert machine.layout.encoders == axes
    assert description.axis_units == dict.fromkeys(axes, 'rad')
    assert description.titles['wrist_roll'] == 'Wrist roll'
    p = machine.parameters()[0]
    assert p['winding'].shape == (6,)
    ratios = [machine.assembly.placing[description.axes[axis]][1] for axis in axes]
    per_joint = p['counts_per_unit'] / np.array(ratios)
    gears = np.array([62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686])
    assert per_joint == pytest.approx(gears * 131072 / (2.0 * np.pi), rel=1e-12)


MOTOR_OF_TABLE = {
    'coordinate': 'motor_angle',
    'winding': 'wye',
    'resistance_lead_to_lead_ohm': 3.0,
    'inductance_lead_to_lead_h': 0.01,
    'back_emf_lead_to_lead_v_s_rad': 2.0,
    'pole_pairs': 8,
}


def test_an_axis_of_any_name_may_have_two_encoders() -> None:
    machine = load_machine(
        'two_mass_drive',
        overlays=[
            {
                'axes': {'x_rotate': None, 'table': 'load_angle'},
                'motors': {'x_rotate': None, 'table': MOTOR_OF_TABLE},
                'encoders': {
                    'x_rotate': None,
                    'table_motor': {'coordinate': 'motor_angle', 'counts_per_revolution': 4000},
                    'table_load': {'coordinate': 'load_angle', 'counts_per_revolution': 65536},
                },
            }
        ],
    )
    assert machine.layout.encoders == ('table_load', 'table_motor')
    assert machine.description.position_encoder('table') == 'table_load'
    state, parameters = (
        machine.initial_state(machine.parameters(), {'table': 0.5}),
        machine.parameters(),
    )
    counts, currents = np.zeros(2, np.int64), np.zeros(2)
    plant.measure(state, parameters, 0, counts, currents)
    assert counts.tolist() == [int(0.5 / (2.0 * np.pi) * own) for own in (65536, 4000)]
