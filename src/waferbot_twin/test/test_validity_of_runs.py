# SPDX-License-Identifier: Apache-2.0
"""A run that leaves the range of its model says so: at its end, in its recording, in the picture."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from waferbot_lockstep.timing import Timing
from waferbot_plant import payload, plant
from waferbot_twin.cli.main import main
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.reader import stream_recording
from waferbot_twin.validity import Validity, recorded_validity


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    """Return the recording of a wafer exchange of the machine as built, and what the command said."""
    out = tmp_path_factory.mktemp('validity') / 'exchange'
    plan = ('--experiment', 'wafer_exchange', '--model', 'as_built', '--duration', '1.2')
    assert main(['run', '--engine', 'inprocess', *plan, '--out', str(out)]) == 0
    return out


@pytest.mark.slow
def test_belt_is_slack_in_a_wafer_exchange_and_every_report_says_so(recording, capsys) -> None:
    told = {(row['place'], row['what']): row for row in recorded_validity(recording)}
    row = told['belt', 'tension of the slack span']
    assert row['outside']
    assert row['worst'] < 0.0
    assert main(['metrics', str(recording), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['loads'] == list(told.values())
    assert main(['metrics', str(recording)]) == 0
    printed = capsys.readouterr().out
    assert 'belt: tension of the slack span' in printed
    assert f'{row["first_s"]:.3f}' in printed
    assert main(['plot', str(recording)]) == 0
    assert (recording / 'plot.png').stat().st_size > 20_000


def test_run_says_it_when_it_is_over(capsys) -> None:
    plan = ('--experiment', 'wafer_exchange', '--model', 'as_built', '--duration', '1.0')
    assert main(['run', '--engine', 'inprocess', *plan, '--json']) == 0
    outside = json.loads(capsys.readouterr().out)['outside']
    assert any(line.startswith('belt: tension of the slack span -') for line in outside)


def test_belt_tension_is_that_of_the_motion_of_both_ends() -> None:
    """The pull is the belt's stiffness by how far the payload is behind the motor, seen here."""
    plan = make_plan('as_built', 'wafer_exchange', 1.0)
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    description = twin.machine.description
    part, gearbox = description.parts['belt'], description.connections['gearbox']
    drive = description.transmissions['y_rotate_drive']
    pulls = []
    for _ in range(int(plan.ticks / 8)):
        twin.advance(8)
        s = twin.plant_state[0]
        placing = twin.machine.assembly.placing
        motor, load = (
            placing[name][1] * s['position'][placing[name][0]]
            for name in ('y_rotate_motor', 'y_rotate')
        )
        belt = description.connections['belt'].stiffness * part.driven_pulley_radius_m**2
        soft = 1.0 / (1.0 / belt + 1.0 / (gearbox.stiffness * part.ratio**2))
        pulls.append(abs(soft * (drive.ratio * motor - load)) / part.driven_pulley_radius_m)
    expected = part.span_pretension_n - 0.5 * max(pulls)
    validity = Validity(plan.model, plan.timing)
    again = Twin.of(plan.model, plan.timing, plan.experiment)
    again.advance(plan.ticks).note_validity(validity)
    found = {(one.check.place, one.check.what): one for one in validity.extremes()}
    slack = found['belt', 'tension of the slack span'].low
    assert slack == pytest.approx(expected, abs=0.5)  # the belt's damping comes on top


def test_limited_currents_are_told() -> None:
    validity = Validity(load_model('rigid'), Timing())
    validity.note_commands(np.array([0, 8, 16]), np.array([[1, 2, 3], [4, -40.0, 5], [0, 0, 0.0]]))
    for tick in (24, 32):
        validity.note_command(tick, 0b001, (-41.0, 99.0, 99.0))
    setpoint = np.full((2, 3), 1200.0)
    accumulator = np.array([[0.0, 0.0, 1300.0], [1200.0, 0.0, 1300.0]])
    validity.note_amplifiers(np.array([0, 180]), np.array([0b011, 0b011]), accumulator, setpoint)
    departures = validity.departures()
    assert [line.partition(' (')[0] for line in departures] == [
        'y_linear: current command 41 A',
        'x_rotate: current command 40 A',
        'y_linear: I2T accumulator 1200 A2 s',
    ]
    assert 'at 0.001 s' in departures[0]
    assert validity.after('killed').startswith(
        'killed; outside of the range of the model: y_linear'
    )
    assert validity.after('') == ''


def test_a_recording_that_tells_nothing_is_no_error(tmp_path) -> None:
    (tmp_path / 'empty.mcap').write_bytes(b'')
    assert recorded_validity(tmp_path) == []


@pytest.mark.slow
def test_warm_windings_and_the_payload_are_recorded_and_drawn(tmp_path) -> None:
    """What the recording tells is what the plant's state has at those ticks."""
    description = plant.config_folder() / 'as_built.yaml'
    file = tmp_path / 'warm.yaml'
    warming = {'motors': {'x_rotate': {'heating': {'state': 'warming'}}}}
    file.write_text(yaml.safe_dump({'extends': str(description), **warming}), 'utf-8')
    model = tmp_path / 'model.yaml'
    section = {'/**/plant': {'ros__parameters': {'description': str(file)}}}
    model.write_text(yaml.safe_dump(section), 'utf-8')
    out = tmp_path / 'run'
    run = ['run', '--engine', 'inprocess', '--model', str(model), '--experiment', 'step']
    assert main([*run, '--duration', '0.1', '--out', str(out)]) == 0
    told: list[np.ndarray] = []
    stream_recording(out, lambda topic, records: None, None, told.append)
    records = np.concatenate(told)
    assert records['tick'].tolist() == list(range(0, 1800, 180))
    plan = make_plan(str(model), 'step', 0.1)
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    frame = np.zeros(payload.WIDTH)
    for row in records:
        payload.payload_frame(twin.plant_state[0], twin.plant_parameters[0], frame)
        assert row['payload_position'].tolist() == frame[:3].tolist()
        assert row['payload_error'].tolist() == frame[16:19].tolist()
        temperature = twin.plant_state[0]['winding_temperature']
        assert row['winding_temperature'].tolist() == temperature.tolist()
        twin.advance(180)
    assert records['winding_temperature'][-1, 1] > 25.0
    assert np.abs(records['payload_error'][-1]).max() > 1e-9
    assert main(['plot', str(out)]) == 0


def test_a_run_in_a_script_has_them() -> None:
    import waferbot

    run = waferbot.simulate(waferbot.load_model('as_built'), 'wafer_exchange', 1.0)
    assert any(line.startswith('belt: tension of the slack span -') for line in run.departures)
    assert waferbot.simulate(waferbot.load_model('rigid'), 'constant', 0.1).departures == ()
