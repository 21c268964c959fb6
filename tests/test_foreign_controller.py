# SPDX-License-Identifier: Apache-2.0
"""A stranger's node in place of ours: the contract is all that it needs to know."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest
from harness import Program, domain_of, output_of

from waferbot_twin.recording.reader import read_recording

HERE = Path(__file__).parent
DURATION_S = 0.25
TICKS = 4500


def run_with(start, tmp_path, foreign, *arguments):
    """Run the twin with a foreign node in place of one of its own; return the recording."""
    import sys

    out = tmp_path / 'run'
    twin = start(
        'waferbot_twin', 'run', '--duration', str(DURATION_S), '--out', str(out), *arguments
    )
    environment = {
        'ROS_DOMAIN_ID': str(domain_of(twin)),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    stranger = Program(
        [sys.executable, str(HERE / f'{foreign}.py')], tmp_path / 'foreign.log', environment
    )
    try:
        code = twin.wait()
    finally:
        if stranger.process.poll() is None:
            stranger.process.kill()
        stranger.process.wait()
    assert code == 0, twin.output + stranger.output
    assert '0 missing of' in twin.output
    return read_recording(out)


@pytest.mark.parametrize('name', ['foreign_pmac', 'foreign_copley'])
def test_the_foreign_node_knows_the_messages_only(name):
    imported = set()
    for node in ast.walk(ast.parse((HERE / f'{name}.py').read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module.split('.')[0])
    assert {module for module in imported if module.startswith('waferbot')} == {'waferbot_msgs'}


@pytest.mark.slow
def test_foreign_position_controller_steps_one_axis_and_holds_the_others(start, tmp_path):
    recording = run_with(start, tmp_path, 'foreign_pmac', '--without', 'pmac')
    commands = recording['current_command']
    np.testing.assert_array_equal(commands['tick'], np.arange(0, TICKS, 8))
    # The law of the foreign node on the recorded counts, at a tick of our choice.
    counts = recording['encoders']['counts'][::4].astype(float)
    speed = np.diff(counts[:, 0], prepend=counts[0, 0])
    target = np.where(commands['tick'] >= 360, 2500.0, 0.0)
    expected = np.clip(1.43e-3 * (target - counts[:, 0]) - 1.8e-2 * speed + 0.731, -35, 35)
    np.testing.assert_allclose(commands['current'][:, 0], expected, rtol=1e-12, atol=1e-15)
    last = counts[-200:]
    assert abs(last[:, 0].mean() - 2500) < 250
    assert np.ptp(last[:, 0]) < 250
    assert abs(last[:, 1]).max() < 200
    assert abs(last[:, 2]).max() < 200
    assert 'servo_state' not in recording.topics or len(recording['servo_state']) == 0
    check_commands(recording.path)


def check_commands(path):
    """What our PMAC would have reported lacks; the commands say so, and show the rest."""
    told = json.loads(output_of('info', path, '--json'))
    assert told['missing'] == 0
    figures = json.loads(output_of('metrics', path, '--json'))['y_linear']
    assert figures['peak_following_error'] is None
    assert figures['peak_current'] > 1.0
    assert Path(output_of('plot', path).strip()).exists()


@pytest.mark.slow
def test_foreign_amplifier_on_one_axis_while_the_others_stay_simulated(start, tmp_path):
    recording = run_with(
        start, tmp_path, 'foreign_copley',
        '--copley-per-axis', '--without', 'copley_y_linear', '--experiment', 'step',
    )  # fmt: skip
    assert recording.counts['/phase_voltages'] == 3 * TICKS
    voltages = recording['phase_voltages']
    assert set(voltages['valid']) == {0b111}
    assert set(recording['amplifier_state']['valid']) == {0b110}
    counts = recording['encoders']['counts'][-400:]
    assert abs(counts[:, 0].mean() - 2500) < 500
    assert abs(counts[:, 1].mean() - 800) < 200
