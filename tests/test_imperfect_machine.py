# SPDX-License-Identifier: Apache-2.0
"""A machine with every imperfection of its drives and sensors: the same bits on every engine."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from harness import run_engine

from waferbot_plant.plant import config_folder
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording

TURN = 6.283185307179586


def motor(place: int) -> dict:
    return {
        'saturation_current_a': 20.0 + place,
        'ripple': [{'order': 6, 'cosine': 0.02, 'sine': -0.01}, {'order': 1, 'sine': 0.005}],
        'phase_imbalance': [0.02, -0.01],
        'heating': {'state': 'warming', 'winding_start_degc': 60.0 + place},
    }


def encoder(place: int, unit: str, period: float) -> dict:
    return {
        'scale_error': 1e-4,
        'eccentricity': {f'amplitude_{unit}': 1e-5 * period, f'period_{unit}': period},
        'interpolation': {'amplitude_counts': 2.0, 'period_counts': 200.0, 'phase_rad': 0.4},
        'coarseness_counts': 2,
        'extra_delay_cycles': 1,
        'delay_fraction': 0.3,
        'noise_counts': 1.5,
        'noise_seed': 40 + place,
        'lost_counts': {'counts': 1, f'every_{unit}': 1e-3 * period},
    }


MACHINE = {
    'extends': str(config_folder() / 'flexible.yaml'),
    'motors': {axis: motor(n) for n, axis in enumerate(('y_linear', 'x_rotate', 'y_rotate'))},
    'encoders': {
        'y_linear': encoder(0, 'm', 0.05),
        'x_rotate': encoder(1, 'rad', TURN),
        'y_rotate_load': encoder(2, 'rad', TURN),
        'y_rotate_motor': encoder(3, 'rad', TURN),
    },
    'current_sensors': {
        axis: {'gain_1': 0.01, 'offset_2_a': 0.05, 'noise_a': 0.01, 'noise_seed': 50}
        for axis in ('y_linear', 'x_rotate', 'y_rotate')
    },
}
AMPLIFIER = {'dead_time_voltage': 3.0, 'bus_resistance': 1.0, 'voltage_limit': 1}
SERVO = {'command_delay': 1, 'feedback_filter': 0.8}


@pytest.fixture
def model(tmp_path):
    machine = tmp_path / 'imperfect_machine.yaml'
    machine.write_text(yaml.safe_dump(MACHINE), 'utf-8')
    sections = {
        'plant': {'description': str(machine)},
        'pmac': {axis: dict(SERVO) for axis in MACHINE['motors']},
        'copley': {axis: dict(AMPLIFIER) for axis in MACHINE['motors']},
    }
    path = tmp_path / 'imperfect.yaml'
    path.write_text(
        yaml.safe_dump(
            {f'/**/{name}': {'ros__parameters': part} for name, part in sections.items()}
        ),
        'utf-8',
    )
    return str(path)


@pytest.mark.slow
@pytest.mark.parametrize('engine', ['composed', 'ros'])
def test_imperfect_machine_is_bit_identical_over_ros(tmp_path, model, engine):
    runs = [
        run_engine(name, tmp_path / name, model=model, duration_s=0.1)
        for name in (engine, 'inprocess')
    ]
    assert len(runs[0]['phase_currents']) == 1800
    assert differing_signals(*runs) == []


@pytest.mark.slow
def test_a_report_on_some_axes_is_the_same_message(tmp_path):
    """One amplifier runs into its peak current: it reports alone, between the regular reports."""
    path = tmp_path / 'weak.yaml'
    weak = {'x_rotate': {'user_peak_current': 9.0}}
    path.write_text(yaml.safe_dump({'/**/copley': {'ros__parameters': weak}}), 'utf-8')
    runs = [
        run_engine(engine, tmp_path / engine, model=str(path), duration_s=0.1)
        for engine in ('composed', 'inprocess')
    ]
    assert 2 in runs[0]['amplifier_state']['valid']
    assert differing_signals(*runs) == []


@pytest.mark.slow
def test_imperfect_machine_is_told_from_the_perfect_one(tmp_path, model):
    found = run_engine('inprocess', tmp_path / 'imperfect', model=model, duration_s=0.1)
    other = run_engine('inprocess', tmp_path / 'perfect', model='flexible', duration_s=0.1)
    assert {'encoders.counts', 'phase_currents.current'} <= set(differing_signals(found, other))


@pytest.mark.slow
def test_recording_holds_the_imperfections(tmp_path, model):
    """From the recording alone the same run comes out again."""
    from waferbot_twin.engines.inprocess import Twin
    from waferbot_twin.models import recorded_model
    from waferbot_twin.plan import make_plan

    run_engine('inprocess', tmp_path / 'run', model=model, duration_s=0.05)
    recording = read_recording(tmp_path / 'run')
    plan = make_plan(model, 'step', 0.05)
    twin = Twin.of(recorded_model(recording), plan.timing, plan.experiment)
    signals = twin.advance(plan.ticks)
    assert np.array_equal(signals.counts, recording['encoders']['counts'])
    assert np.array_equal(signals.line_current, recording['phase_currents']['current'])
