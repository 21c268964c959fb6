# SPDX-License-Identifier: Apache-2.0
"""
A machine of one's own, its CSV, and a diagnosis: all as processes, the truth from another integrator.

The motion is that of scipy's LSODA for J q'' = u - b q' - c tanh(q' / 0.001) - cogging(q), with u from a
continuous controller; the log has the time, the position in steps of the encoder, and the torque.
Sizes, phases and noise are drawn from a seed that is printed; `WAFERBOT_SEED` draws others.
"""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from harness import output_of
from scipy.integrate import solve_ivp

DESCRIPTION = """
name: my axis
bodies:
  table: {mass_kg: 1.0, centre_of_gravity_m: [0, 0, 0],
          inertia_kg_m2: {xx: 2.0e-3, yy: 2.0e-3, zz: 2.0e-3}}
joints:
  bearing:
    {parent: base, child: table, at_m: [0, 0, 0], freedoms: {angle: {type: revolute, axis: [0, 0, 1]}}}
axes: {x_rotate: angle}
motors:
  x_rotate: {coordinate: angle, winding: wye, resistance_lead_to_lead_ohm: 1.0,
             inductance_lead_to_lead_h: 1.0e-3, back_emf_lead_to_lead_v_s_rad: 0.23, pole_pairs: 5}
encoders:
  x_rotate: {coordinate: angle, counts_per_revolution: 20000}
"""

MAPPING = """
machine: {machine}
time: {{column: time, unit: s}}
signals:
  - {{column: angle, kind: position, axis: x_rotate, unit: rad}}
  - {{column: torque, kind: torque, axis: x_rotate, unit: Nm}}
"""

INERTIA = 2e-3  # kg m2, as in the description
COUNT = 2.0 * np.pi / 20000.0  # rad


@pytest.fixture(scope='module')
def random():
    seed = int(os.environ.get('WAFERBOT_SEED', '4'))
    print(f'seed {seed}: repeat with WAFERBOT_SEED={seed}')
    return np.random.default_rng(seed)


def measure(random, file, truth, rate_hz=1000.0, seconds=3.0):
    """Write a log of the true machine following a path of its own, with noise of 1 % in the torque."""
    wave = 2.0 * np.pi * random.uniform(0.2, 1.2, 4)
    phase = random.uniform(0.0, 2.0 * np.pi, 4)

    def path(time, order):
        return float(
            np.sum(2.0 / wave * wave**order * np.sin(wave * time + phase + order * np.pi / 2))
        )

    def torque(time, state):
        follow = 0.8 * (path(time, 0) - state[0]) + 0.05 * (path(time, 1) - state[1])
        return INERTIA * path(time, 2) + follow

    def rates(time, state):
        angle, speed = state
        force = torque(time, state) - truth['viscous'] * speed
        force -= truth['coulomb'] * np.tanh(speed / 0.001)
        for order, (cosine, sine) in truth['cogging'].items():
            force += cosine * np.cos(order * angle) + sine * np.sin(order * angle)
        return [speed, force / INERTIA]

    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    start = [path(0.0, 0), path(0.0, 1)]
    motion = solve_ivp(
        rates, (0.0, seconds), start, 'LSODA', t_eval=time, rtol=1e-8, atol=1e-9, max_step=2e-3
    )
    assert motion.success
    given = np.array([torque(t, state) for t, state in zip(time, motion.y.T, strict=True)])
    given *= 1.0 + 0.01 * random.standard_normal(len(given))
    rows = np.column_stack([time, COUNT * np.round(motion.y[0] / COUNT), given])
    np.savetxt(file, rows, delimiter=',', header='time,angle,torque', comments='', fmt='%.9g')
    return file


@pytest.mark.slow
def test_friction_and_cogging_of_a_machine_of_ones_own(random, tmp_path):
    truth = {
        'viscous': 0.0,
        'coulomb': random.uniform(0.03, 0.06),
        'cogging': {n: tuple(random.uniform(0.02, 0.04, 2)) for n in (10, 12, 36)},
    }
    machine, mapping = tmp_path / 'my_axis.yaml', tmp_path / 'map.yaml'
    machine.write_text(DESCRIPTION, 'utf-8')
    mapping.write_text(MAPPING.format(machine=machine), 'utf-8')
    for name in ('one', 'other'):
        log = measure(random, tmp_path / f'{name}.csv', truth)
        output_of('import', log, '--map', mapping, '--out', tmp_path / name)
    output_of(
        'diagnose', tmp_path / 'one', '--validate', tmp_path / 'other', '--model', machine,
        '--out', tmp_path / 'report',
    )  # fmt: skip
    report = json.loads((tmp_path / 'report' / 'report.json').read_text('utf-8'))
    causes = {cause['effect']: cause for cause in report['causes']}
    print(report['sentence'])
    assert 'cogging' in causes
    found = causes['cogging']['parameters']
    for order, amplitudes in truth['cogging'].items():
        for wave, value in zip(('cosine', 'sine'), amplitudes, strict=True):
            assert found[f'{wave}_{order}']['value'] == pytest.approx(value, abs=0.002)
    # A tanh is a friction that gives way a little before it slides, as presliding does.
    (friction,) = causes.keys() - {'cogging'}
    assert friction in ('coulomb_friction', 'presliding')
    value = causes[friction]['parameters']['friction']['value']
    assert value == pytest.approx(truth['coulomb'], rel=0.05)
    assert report['gain']['axes']['x_rotate']['improvement_percent'] > 40.0
    # What was written is a machine again, and it says what it could not do.
    extended = (tmp_path / 'report' / 'extended.yaml').read_text('utf-8')
    assert 'bodies:' in extended
    assert 'ros__parameters' not in extended
    assert any('commanded position' in note for note in report['notes'])
