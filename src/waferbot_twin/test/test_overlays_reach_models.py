# SPDX-License-Identifier: Apache-2.0
"""
Every imperfection can be switched on by a model file, and is felt in the closed loop.

One short move per setting; what must differ is the signal that the setting acts on
first. A setting that nobody reads, or that is lost between file and model, fails here.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import config_folder
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.models import load_model

TIMING = Timing()
AXIS = 'x_rotate'
TURN = 6.283185307179586
TICKS = TIMING.ticks(0.06)

ENCODER = {
    'scale_error': 0.001,
    'eccentricity': {'amplitude_rad': 1e-4, 'period_rad': TURN, 'phase_rad': 1.0},
    'interpolation': {'amplitude_counts': 3.0, 'period_counts': 16.0},
    'coarseness_counts': 16,
    'extra_delay_cycles': 3,
    'delay_fraction': 0.5,
    'delay_s': 0.001,
    'noise_counts': 2.0,
    'lost_counts': {'counts': 2, 'every_rad': 5e-4},
}
MOTOR = {
    'saturation_current_a': 15.0,
    'ripple': [{'order': 6, 'cosine': 0.05}],
    'phase_imbalance': [0.05, 0.0],
    'back_emf_lead_to_lead_v_s_rad': 3.2,
    'resistance_lead_to_lead_ohm': 4.4,
    'inductance_lead_to_lead_h': 0.014,
    'heating': {'state': 'warming', 'winding_start_degc': 90.0},
}
SENSORS = {
    'gain_1': 0.02,
    'gain_2': 0.02,
    'offset_1_a': 0.1,
    'offset_2_a': 0.1,
    'noise_a': 0.01,
}
AMPLIFIER = {
    'current_offset': 0.2,
    'commutation_offset': 0.1,
    'proportional_gain': 4000,
    'integral_gain': 1000,
    'continuous_current': 1.0,
    'i2t_time': 2.0,
    'user_peak_current': 6.0,
    'filter_1_kind': 1,
    'filter_1_frequency': 500.0,
    'filter_2_kind': 3,
    'filter_2_width': 40.0,
    'bus_voltage': 70.0,
    'bus_resistance': 2.0,
    'bus_feedforward': 1,
    'dead_time_voltage': 4.0,
    'dead_time_current': 2.0,
    'update_delay': 1,
    'mode': 1,
}
BESIDE = {
    'continuous_current': {'i2t_time': 0.001},
    'i2t_time': {'continuous_current': 1.0, 'i2t_time': 0.001},
    'filter_1_frequency': {'filter_1_kind': 1},
    'filter_2_width': {'filter_2_kind': 3},
    'bus_voltage': {'voltage_limit': 1},
    'bus_feedforward': {'bus_resistance': 2.0},
    'dead_time_current': {'dead_time_voltage': 4.0},
}
"""Settings without which another one has nothing to act on."""

CONTROLLER = {
    'Ixx30': {'Ixx30': 150000},
    'Ixx31': {'Ixx31': 900},
    'Ixx32': {'Ixx32': 500},
    'Ixx33': {'Ixx33': 50000, 'Ixx34': 0},
    'Ixx35': {'Ixx35': 1000},
    'Ixx29, bias': {'Ixx29': -6000},
    'notch': {'Ixx36': -1.5, 'Ixx37': 0.6, 'Ixx38': -1.4, 'Ixx39': 0.5},
    'deadband': {'Ixx64': -16, 'Ixx65': 32000},
    'error limit': {'Ixx67': 160},
    'friction feedforward': {'Ixx68': 1000},
    'output limit': {'Ixx69': 6000},
    'command_delay': {'command_delay': 2},
    'feedback_filter': {'feedback_filter': 3.0},
}


def run(folder: Path, machine: dict, servo: dict, amplifier: dict) -> Signals:
    """Run the start of a move on the rigid machine with a model file of these overlays."""
    description = folder / 'own_machine.yaml'
    base = str(config_folder() / 'rigid.yaml')
    description.write_text(yaml.safe_dump({'extends': base, **machine}), 'utf-8')
    model = folder / 'own_model.yaml'
    sections = {
        'plant': {'description': str(description)},
        'pmac': {AXIS: servo},
        'copley': {AXIS: amplifier},
    }
    model.write_text(
        yaml.safe_dump({f'/**/{name}': {'ros__parameters': s} for name, s in sections.items()}),
        'utf-8',
    )
    experiment = load_experiment('full_stroke_x_rotate')
    return Twin.of(load_model(str(model)), TIMING, experiment).advance(TICKS)


@cache
def nominal() -> Signals:
    with tempfile.TemporaryDirectory(prefix='waferbot_test_') as folder:
        return run(Path(folder), {}, {}, {})


def first_difference(one: np.ndarray, other: np.ndarray) -> int:
    """Return the first row in which two signals differ, one beyond the last if in none."""
    rows = np.flatnonzero(np.any(one != other, axis=1))
    return int(rows[0]) if len(rows) else len(one)


def acts_first_on(columns: slice, one: np.ndarray, other: np.ndarray) -> bool:
    """Tell whether two signals differ, and there not later than in the places of other axes."""
    found = first_difference(one[:, columns], other[:, columns])
    return found < len(one) and found <= first_difference(one, other)


@pytest.mark.parametrize('name', ENCODER)
def test_encoder(tmp_path: Path, name: str) -> None:
    found = run(tmp_path, {'encoders': {AXIS: {name: ENCODER[name]}}}, {}, {})
    assert acts_first_on(slice(1, 2), found.counts, nominal().counts)


@pytest.mark.parametrize('name', MOTOR)
def test_motor(tmp_path: Path, name: str) -> None:
    found = run(tmp_path, {'motors': {AXIS: {name: MOTOR[name]}}}, {}, {})
    assert acts_first_on(slice(2, 4), found.line_current, nominal().line_current)


@pytest.mark.parametrize('name', SENSORS)
def test_current_sensors(tmp_path: Path, name: str) -> None:
    found = run(tmp_path, {'current_sensors': {AXIS: {name: SENSORS[name]}}}, {}, {})
    assert acts_first_on(slice(2, 4), found.line_current, nominal().line_current)


@pytest.mark.parametrize('name', AMPLIFIER)
def test_amplifier(tmp_path: Path, name: str) -> None:
    beside = BESIDE.get(name, {})
    without = run(tmp_path, {}, {}, beside) if beside else nominal()
    found = run(tmp_path, {}, {}, {**beside, name: AMPLIFIER[name]})
    assert acts_first_on(slice(3, 6), found.voltage, without.voltage)
    assert not found.open_bridges.any()


@pytest.mark.parametrize('name', CONTROLLER)
def test_controller(tmp_path: Path, name: str) -> None:
    found = run(tmp_path, {}, CONTROLLER[name], {})
    assert acts_first_on(slice(1, 2), found.current_command, nominal().current_command)


def test_seeds_choose_the_realisation(tmp_path: Path) -> None:
    runs = []
    for seed in (0, 1, 1):
        noise = {
            'encoders': {AXIS: {'noise_counts': 2.0, 'noise_seed': seed}},
            'current_sensors': {AXIS: {'noise_a': 0.01, 'noise_seed': seed}},
        }
        found = run(tmp_path, noise, {}, {})
        runs.append((found.counts.tobytes(), found.line_current.tobytes()))
    assert runs[1] == runs[2]
    assert runs[0] != runs[1]
