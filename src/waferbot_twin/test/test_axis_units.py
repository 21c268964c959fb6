# SPDX-License-Identifier: Apache-2.0
"""Whether an axis slides or turns follows from the machine: the same machine under other names."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from waferbot_lockstep.contract import AXES, USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.description import Description
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import description_source
from waferbot_plant.urdf import urdf
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines import inprocess
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.engines.layout import RosOptions, layout
from waferbot_twin.fmi.blocks import variables_of
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.plan import make_plan
from waferbot_twin.response import simulated_responses
from waferbot_twin.response_reader import load_responses
from waferbot_twin.ros2_control.joints import JointScales
from waferbot_twin.suggestion.candidates import designed, library, strokes
from waferbot_twin.sweep.sizing import size
from waferbot_twin.tuning.commission import commission
from waferbot_twin.tuning.feedforward import machine_tables
from waferbot_twin.tuning.tune import poses_of

TIMING = Timing()
PLACE = {'y_linear': 'y_linear', 'x_rotate': 'x_rotate', 'y_rotate': 'y_rotate_load'}
SLIDING = dict.fromkeys(AXES, 'm')


def mass_on(axis: str) -> Variant:
    """Return the mass on a slide as the axis of that name, commissioned."""
    alone = Variant.of(load_model_or_machine('single_mass'))
    machine = alone.machine
    renamed: dict[str, dict[str, object]] = {
        'axes': {'y_linear': None, axis: 'travel'},
        'motors': {'y_linear': None, axis: machine['motors']['y_linear']},
        'encoders': {'y_linear': None, PLACE[axis]: machine['encoders']['y_linear']},
    }
    other = alone if axis == 'y_linear' else alone.with_overlay(Overlay(renamed))
    return commission(Variant.of(other.model()), {axis: 8.0})


def step_of(axis: str, unit: str = 'm') -> str:
    motion = f'{axis}: {{kind: step, start_s: 0.02, amplitude_{unit}: 1.0e-3}}'
    return f'name: step\nduration_s: 0.2\nmotion:\n  {motion}\n'


def described(name: str) -> Description:
    return load_description(description_source(name))


@pytest.mark.parametrize(
    ('name', 'units'),
    [
        ('rigid', USUAL_UNITS),
        ('scara', USUAL_UNITS),
        ('ball_screw_stage', USUAL_UNITS),  # by its one axis, and as usual of those that it lacks
        ('gantry', SLIDING),
        ('planar_two_link_arm', USUAL_UNITS),
    ],
)
def test_units_are_those_of_the_coordinates(name: str, units: dict[str, str]) -> None:
    assert described(name).axis_units == units
    assert load_model_or_machine(name).axis_units == units


@pytest.mark.parametrize('axis', AXES[1:])
def test_a_mass_that_slides_does_the_same_whatever_its_axis_is_called(axis: str) -> None:
    found = {}
    for name in ('y_linear', axis):
        variant = mass_on(name)
        twin = Twin.of(variant.model(), TIMING, load_experiment(step_of(name)))
        responses = simulated_responses(twin, twin.advance(TIMING.ticks(0.2)))
        found[name] = next(one for one in responses if one.axis == name)
        assert found[name].unit == 'm'
        for setting in ('Ixx11', 'Ixx16', 'Ixx17', 'Ixx30', 'counts_per_unit'):
            assert variant.i_variable(name, setting) == mass_on('y_linear').i_variable(
                'y_linear', setting
            ), setting
        with pytest.raises(UserError, match=f'{name} is measured in m or counts'):
            Twin.of(variant.model(), TIMING, load_experiment(step_of(name, 'rad')))
        sized = size(variant, load_experiment(step_of(name)), TIMING)
        words = {row.what for row in sized.rows}
        assert {'RMS force', 'peak force'} <= words
        tables = machine_tables(variant, {name: (0.0, 0.1)}, {name: 0.5})
        assert [table.over for table in tables] == ['position_m', 'speed_m_s']
    np.testing.assert_array_equal(found[axis].position, found['y_linear'].position)
    np.testing.assert_array_equal(found[axis].current, found['y_linear'].current)


def test_a_plan_in_the_wrong_unit_is_refused_before_anything_starts(tmp_path, capsys) -> None:
    file = tmp_path / 'slide.yaml'
    file.write_text(mass_on('y_rotate').text, 'utf-8')
    with pytest.raises(UserError, match='y_rotate is measured in m or counts'):
        make_plan(str(file), step_of('y_rotate', 'rad'))
    with pytest.raises(UserError, match='y_rotate is measured in rad or counts'):
        make_plan('rigid', step_of('y_rotate'))
    assert main(['modes', '--description', 'gantry', '--pose', 'x_rotate=far']) == 1
    assert 'give a number of m' in capsys.readouterr().err


def test_nodes_over_ros_are_told_the_units_of_the_machine(tmp_path) -> None:
    file = tmp_path / 'slide.yaml'
    file.write_text(mass_on('x_rotate').text, 'utf-8')
    told = [
        dict(layout(make_plan(*plan), RosOptions()))['pmac'][1]['units']
        for plan in (('rigid', 'step'), (str(file), step_of('x_rotate')))
    ]
    assert told == ['m rad rad', 'm m rad']


def test_a_recording_of_it_is_told_in_metres(tmp_path, capsys) -> None:
    file, run = tmp_path / 'slide.yaml', tmp_path / 'run'
    file.write_text(mass_on('y_rotate').text, 'utf-8')
    plan = make_plan(str(file), step_of('y_rotate'))
    inprocess.run(plan, run, False, lambda done, total: None)
    units = {response.axis: response.unit for response in load_responses(run)}
    assert units == {'y_linear': 'm', 'x_rotate': 'rad', 'y_rotate': 'm'}
    assert main(['metrics', str(run), '--json']) == 0
    figures = json.loads(capsys.readouterr().out)['y_rotate']
    assert (figures['unit'], figures['step']) == ('m', pytest.approx(1e-3))
    picture = tmp_path / 'run.svg'
    assert main(['plot', str(run), '--out', str(picture)]) == 0


def test_a_plot_calls_the_axes_what_the_machine_calls_them(tmp_path) -> None:
    file, run, picture = tmp_path / 'slide.yaml', tmp_path / 'run', tmp_path / 'run.svg'
    slide = mass_on('y_linear').with_overlay(Overlay({'titles': {'y_linear': 'Slide'}}))
    file.write_text(slide.text, 'utf-8')
    plan = make_plan(str(file), step_of('y_linear'))
    inprocess.run(plan, run, False, lambda done, total: None)
    assert main(['plot', str(run), '--out', str(picture)]) == 0
    # text is drawn as outlines, with what it says in a comment
    said = re.findall('<!-- (.*) -->', picture.read_text('utf-8'))
    assert {'Slide', 'X-Rotate', 'Y-Rotate'} <= set(said)
    assert 'Y-Linear' not in said


def test_an_fmu_has_the_units_of_its_machine() -> None:
    for kind, which, name in (
        ('plant', 1, 'x_rotate_position'),
        ('twin', 0, 'x_rotate_commanded'),
        ('pmac', 0, 'x_rotate_commanded'),
    ):
        for units in (USUAL_UNITS, described('gantry').axis_units):
            variables = {one.name: one.unit for one in variables_of(kind, units)[which]}
            assert variables[name] == units['x_rotate'], kind
    speed = {one.name: one.unit for one in variables_of('plant', SLIDING)[1]}['y_rotate_velocity']
    assert speed == 'm/s'


def test_ros2_control_reads_the_encoder_by_which_an_axis_is_positioned() -> None:
    scales = JointScales.of(described('gantry'))
    assert scales.encoders.tolist() == [0, 1, 3]
    positions = scales.positions(np.array([65536, 2000000, 7, 131072]))
    assert positions == pytest.approx(
        [0.01, 1.0, 0.125]
    )  # a turn of the screw, 1 m, one of the pulley
    assert scales.effort_per_ampere[1] == pytest.approx(49.0 * math.sqrt(3.0) / 2.0)


def test_joints_of_a_gantry_slide_as_far_as_lengths_go() -> None:
    text = urdf(described('gantry'))
    assert text.count('type="prismatic"') == 3
    assert text.count('lower="-0.5" upper="0.5"') == 3


def test_poses_and_motions_in_rad_are_not_for_a_gantry() -> None:
    bandwidths = {'y_linear': 25.0, 'x_rotate': 20.0, 'y_rotate': 10.0}
    gantry = commission(Variant.of(load_model_or_machine('gantry')), bandwidths)
    assert poses_of(gantry, {}) == [{}]
    names = {candidate.label for candidate in library(gantry)}
    assert 'full_stroke_y_linear' in names
    assert 'full_stroke_x_rotate' not in names
    shipped = Variant.of(load_model('rigid'))
    ways = strokes(gantry, TIMING)
    longest = strokes(shipped, TIMING)['y_linear']
    assert ways['x_rotate'] == pytest.approx(longest)
    motions = designed(gantry, ['x_rotate'], TIMING)
    assert motions
    for candidate in motions:
        assert math.isfinite(candidate.design.stroke)
        assert all(candidate.design.keys[key] > 0.0 for key in candidate.design.sizes)
        assert ' m' in candidate.label
    assert len(poses_of(shipped, {})) == 6
