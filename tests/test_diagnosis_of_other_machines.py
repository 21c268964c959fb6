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

pytestmark = [pytest.mark.slow, pytest.mark.long(90)]

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


def measure(random, file, truth, rate_hz=1000.0, seconds=2.0):
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
    # What was written is a machine again.
    extended = (tmp_path / 'report' / 'extended.yaml').read_text('utf-8')
    assert 'bodies:' in extended
    assert 'ros__parameters' not in extended


STAGE = """
name: linear-motor stage
bodies:
  slider: {mass_kg: 10.0, centre_of_gravity_m: [0, 0, 0], inertia_kg_m2: {xx: 0.05, yy: 0.05, zz: 0.05}}
joints:
  slide: {parent: base, child: slider, at_m: [0, 0, 0],
          freedoms: {travel: {type: prismatic, axis: [1, 0, 0]}}}
axes: {y_linear: travel}
motors:
  y_linear: {coordinate: travel, winding: wye, resistance_lead_to_lead_ohm: 2.0,
             inductance_lead_to_lead_h: 8.0e-3, back_emf_lead_to_lead_v_s_m: 69.282,
             electrical_cycle_m: 0.048}
encoders:
  y_linear: {coordinate: travel, counts_per_m: 1.0e+6}
"""

STAGE_MAPPING = """
time: {column: Time (ms), unit: ms}
signals:
  - {column: Pos (mm), kind: position, axis: y_linear, unit: mm, resolution: 0.001}
  - {column: Iq (A rms), kind: current, axis: y_linear, unit: A_rms}
  - {column: Cmd (mm), kind: commanded_position, axis: y_linear, unit: mm}
options: {delimiter: ;, decimal: ","}
"""


def measure_stage(random, file, truth, hertz, metres, seconds=2.5):
    """
    Write the log of a stage under a sampled PID controller, as a German logger would.

    Semi-implicit Euler at 20 kHz, control at 4 kHz on counts of 1 um, 60 N/A; every millisecond a row
    with decimal commas; four rows are lost, and the last one is cut off.
    """
    step_s, control_s, force_constant, count = 5e-5, 2.5e-4, 60.0, 1e-6
    position = speed = integral = seen = current = 0.0
    omega = 2.0 * np.pi * np.array(hertz)
    rows = []
    for tick in range(int(seconds / step_s)):
        time = tick * step_s
        wanted = float(np.sum(metres * (1.0 - np.cos(omega * time))))
        if tick % 5 == 0:
            before, seen = seen, count * round(position / count)
            rate = float(np.sum(metres * omega * np.sin(omega * time)))
            integral += (wanted - seen) * control_s
            force = 6e4 * (wanted - seen) + 900.0 * (rate - (seen - before) / control_s)
            current = float(np.clip((force + 4e5 * integral) / force_constant, -8.0, 8.0))
        if tick % 20 == 0:
            rms = (current + 0.01 * random.standard_normal()) / np.sqrt(2.0)
            cells = 1e3 * time, 1e3 * count * round(position / count), rms, 1e3 * wanted
            rows.append(';'.join(f'{cell:.6f}' for cell in cells).replace('.', ','))
        force = force_constant * current - truth['friction'] * np.tanh(speed / 2e-4)
        force -= truth['cogging'] * np.sin(2.0 * np.pi * position / 0.024 + truth['phase'])
        speed += step_s * force / (10.0 + truth['mass'])
        position += step_s * speed
    text = ['Time (ms);Pos (mm);Iq (A rms);Cmd (mm)', *rows[:900], *rows[904:], '1234;12']
    file.write_text('\n'.join(text), 'utf-8')
    return file


@pytest.mark.xfail(
    reason='mass and force constant are corrections at their bounds: as a cause they are less probable'
)
def test_a_stage_with_three_causes_at_once_and_what_its_log_cannot_tell(random, tmp_path):
    """A log without the force tells no mass from a force constant: both must be said."""
    truth = {
        'mass': random.uniform(0.8, 2.0),
        'friction': random.uniform(6.0, 12.0),
        'cogging': random.uniform(4.0, 8.0),
        'phase': random.uniform(0.0, 2.0 * np.pi),
    }
    print(truth)
    machine, mapping = tmp_path / 'stage.yaml', tmp_path / 'map.yaml'
    machine.write_text(STAGE, 'utf-8')
    mapping.write_text(STAGE_MAPPING, 'utf-8')
    for name, hertz, metres in (('one', [0.7], [0.05]), ('other', [1.1, 2.6], [0.012, 0.004])):
        log = measure_stage(random, tmp_path / f'{name}.csv', truth, hertz, np.array(metres))
        output_of('import', log, '--map', mapping, '--out', tmp_path / name)
    output_of(
        'diagnose', tmp_path / 'one', '--validate', tmp_path / 'other', '--model', machine,
        '--out', tmp_path / 'report',
    )  # fmt: skip
    report = json.loads((tmp_path / 'report' / 'report.json').read_text('utf-8'))
    print(report['sentence'])
    causes = {cause['effect']: cause for cause in report['causes']}
    values = {
        name: {key: item['value'] for key, item in cause['parameters'].items()}
        for name, cause in causes.items()
    }
    assert report['verdict'] == 'explained'
    (scale,) = causes.keys() - {'coulomb_friction', 'cogging'}
    alike = {item['effect'] for item in causes[scale]['credible_set']}
    assert alike == {'wrong_inertia', 'force_constant'}
    ratio = values[scale].get('ratio', 1.0)
    mass = values[scale].get('mass', 10.0 / ratio - 10.0)
    assert mass == pytest.approx(truth['mass'], abs=0.25)
    assert values['coulomb_friction']['friction'] / ratio == pytest.approx(
        truth['friction'], rel=0.03
    )
    cogging = values['cogging']
    amplitude = np.hypot(cogging['cosine_2'], cogging['sine_2']) / ratio
    assert amplitude == pytest.approx(truth['cogging'], rel=0.1)
    assert report['gain']['axes']['y_linear']['improvement_percent'] > 80.0
