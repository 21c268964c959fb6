# SPDX-License-Identifier: Apache-2.0
"""What a library knows of one machine, in its next diagnosis; and where a new machine begins."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.diagnosis.inference.nuisance import nuisance
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.known_before import with_known
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate, standard_errors
from waferbot_twin.estimation.known_values import Known
from waferbot_twin.identification.named_parameters import at_path
from waferbot_twin.library.entries import Entry, load
from waferbot_twin.library.from_report import read_entries
from waferbot_twin.library.known import known_of
from waferbot_twin.library.start import with_starting_values
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.synthesis import noise

FRICTION = 'coulomb_friction.x_rotate.friction'
INERTIA = 'bodies.x_rotate_load.inertia_kg_m2'
RESISTANCE = 'resistance_lead_to_lead_ohm'
TRUE_FRICTION, TRUE_INERTIA = 3.0, 1.02

PAIRS = range(41, 65, 4)
"""Seeds of first logs; that of the second is two more. Each seed has noise of its own."""


def entry(value, half, machine='robot_1', date='2026-01-01', path=INERTIA):
    return Entry(
        'body',
        'inertia_kg_m2',
        value,
        'kg m2',
        value - half,
        value + half,
        machine,
        path,
        '',
        date,
    )


def test_the_latest_entry_of_the_machine_counts_alone():
    entries = (
        entry(1.0, 0.1),
        entry(1.2, 0.196, date='2026-02-01'),
        entry(5.0, 0.1, machine='robot_2', date='2026-03-01'),
        dataclasses.replace(entry(2.0, 0.1, path='of.no.interval'), low=float('nan')),
    )
    known = known_of(entries, 'robot_1')
    assert list(known) == [INERTIA]
    assert known[INERTIA].value == 1.2
    assert known[INERTIA].error == pytest.approx(0.1, rel=1e-3)
    with pytest.raises(UserError, match="did you mean 'robot_1'"):
        known_of(entries, 'robot_l')


def test_a_diagnosis_gives_its_corrected_parameters_to_the_library(tmp_path):
    (tmp_path / 'report.json').write_text(
        json.dumps(
            {
                'causes': [
                    {
                        'effect': 'load',
                        'axis': 'y_rotate',
                        'parameters': {'offset_x': {'value': 1, 'unit': 'm', 'told': False}},
                    }
                ],
                'corrections': [
                    {
                        'path': 'bodies.carriage.mass_kg',
                        'unit': 'kg',
                        'found': 4.97,
                        'low': 4.7,
                        'high': 5.2,
                        'on_bound': True,
                    },
                    {'path': INERTIA, 'unit': 'kg m2', 'found': 0.6, 'low': 0.5, 'high': 0.7},
                    {'path': 'logs.x_rotate.skew_s', 'unit': 's', 'found': 0, 'low': 0, 'high': 1},
                ],
            }
        )
    )
    # What is on its bound, or what the logs do not tell, is no finding.
    (found,) = read_entries(tmp_path, 'robot_1', '2026-01-01', {})
    assert (found.part, found.path, found.low, found.high) == ('body', INERTIA, 0.5, 0.7)


@pytest.fixture(scope='module')
def machine():
    """A model, and the machine: Coulomb friction that the model lacks, and an inertia a little off."""
    rigid = Variant.of(load_model('rigid'))
    inertia = at_path(f'{INERTIA}.xx', rigid)
    real = rigid.with_overlay(inertia.overlay(rigid, TRUE_INERTIA * inertia.start))
    friction = find('coulomb_friction')
    return rigid, friction.apply(real, 'x_rotate', {'friction': TRUE_FRICTION}), friction


def fitted(machine, seed, duration_s):
    """Return problem, fit and numbers of the dense effect, for a log of that length."""
    from waferbot_twin.diagnosis.inference.refit import to_the_end

    rigid, real, friction = machine
    shaken = real.with_overlay(noise(real.base, 1.0, seed, np.random.default_rng(seed)))
    timing = Timing()
    twin = Twin.of(shaken.model(), timing, load_experiment('random_x_rotate'))
    record = record_of_signals('log', twin.advance(timing.ticks(duration_s)))
    record = dataclasses.replace(record, terminals=None)
    settings = Settings()
    (dense, _), numbers = nuisance(rigid, [record], settings)
    paths = [number.path for number in numbers if not number.is_damping]
    problem = Problem(rigid, [record]).with_prior([paths], settings.prior_scales)
    causes = (
        Cause(friction, 'x_rotate', friction.typical(rigid, 'x_rotate')),
        Cause(dense, dense.axes(rigid)[0], dict.fromkeys(paths, 0.0)),
    )
    return problem, to_the_end(problem, evaluate(problem, causes)), numbers


def row_of(problem, found, name):
    names = [item for cause in found.causes for item in cause.values if item not in cause.held]
    return names.index(name)


@pytest.mark.slow
def test_a_second_diagnosis_with_what_is_known_needs_half_the_data(machine):
    """
    Over pairs of logs, in what is told and in what is off.

    Each log has noise of another colour, and the error that is told comes from what its few tenths of a
    second show of it: with some pairs half of a log tells a smaller one than all of it does, by itself.
    """
    rigid, _, _ = machine
    start = float(np.max(np.diag(rigid.description.bodies['x_rotate_load'].inertia)))

    def read(found, problem):
        errors = standard_errors(found)
        friction, dense = found.causes
        return {
            FRICTION: (friction.values['friction'], errors[0]),
            INERTIA: (
                start * (1.0 + dense.values[INERTIA]),
                start * errors[row_of(problem, found, INERTIA)],
            ),
        }

    truth = {FRICTION: TRUE_FRICTION, INERTIA: TRUE_INERTIA * start}
    narrower, told = [], []
    off = {'whole': [], 'half': [], 'better': []}
    for seed in PAIRS:
        problem, first, _ = fitted(machine, seed, 0.8)
        known = {path: Known(*pair, 'the first') for path, pair in read(first, problem).items()}
        problem, whole, _ = fitted(machine, seed + 2, 0.8)
        values = {'whole': read(whole, problem)}
        problem, half, numbers = fitted(machine, seed + 2, 0.4)
        better, notes = with_known(problem, half, known, numbers)
        assert notes == ['2 values of earlier logs of this machine took part']
        values |= {'half': read(half, problem), 'better': read(better, problem)}
        for name, found in values.items():
            off[name].append([found[path][0] - truth[path] for path in truth])
        narrower.append([values['better'][path][1] / values['whole'][path][1] for path in truth])
        told.append([values['better'][path][1] for path in truth])
    assert max(narrower[0]) <= 1.0
    rms = {name: np.sqrt(np.mean(np.square(errors), axis=0)) for name, errors in off.items()}
    assert (np.median(narrower, axis=0) < 1.0).all()
    assert (np.array(narrower) <= 1.0).mean() >= 0.75
    # So much for what is told; and what is off is no more than that of the whole log alone.
    assert (rms['better'] < rms['half']).all()
    assert (rms['better'] <= 1.1 * rms['whole']).all()
    deviations = np.array(off['better']) / np.array(told)
    assert np.abs(deviations).max() < 4.0
    assert np.sqrt(np.mean(deviations**2)) < 2.0
    # What has changed since is told, and left out.
    changed = {FRICTION: Known(2.0 * TRUE_FRICTION, known[FRICTION].error, 'the first')}
    same, (note,) = with_known(problem, half, changed, numbers)
    assert same is half
    assert 'is not what it was (the first)' in note


def test_a_new_machine_begins_with_what_parts_of_its_types_had(tmp_path, capsys):
    variant = Variant.of(load_model('flexible'))
    path = 'parts.belt.loss_factor'
    entries = (
        Entry('belt', 'loss_factor', 0.01),
        Entry('belt', 'loss_factor', 0.03, machine='robot_2'),
        Entry('belt', 'loss_factor', 0.02, 'of another unit'),
        Entry('controller', 'Ixx31', 1234.0, path='pmac.y_linear.Ixx31'),
        # Of another motor: its size is another one.
        Entry('motor', RESISTANCE, 0.7, 'ohm', path=f'motors.of_another_machine.{RESISTANCE}'),
    )
    changed, starts = with_starting_values(variant, entries)
    assert [one.path for one in starts] == [path, 'pmac.y_linear.Ixx31']
    assert at_path(path, changed).start == pytest.approx(0.02)
    assert changed.i_variable('y_linear', 'Ixx31') == 1234.0
    file = tmp_path / 'new.yaml'
    assert main(['library', 'start', 'flexible', '--out', str(file), '--json']) == 0
    rows = json.loads(capsys.readouterr().out)
    assert path in [row['path'] for row in rows]
    again = Variant.of(load_model(str(file)))
    assert at_path(path, again).start == next(r['value'] for r in rows if r['path'] == path)
    assert main(['library', 'start', 'flexible', '--out', str(file)]) == 1
    assert 'exists' in capsys.readouterr().err


def test_what_cannot_be_is_said_in_one_line(tmp_path, capsys):
    file = tmp_path / 'parts.yaml'
    file.write_text('schema: 1\nentries: []\n')
    assert load(file) == ()
    for arguments, said in (
        (['diagnose', 'log', '--library', str(file), '--out', 'x'], 'say which with --machine'),
        (['library', 'start', '--out', 'x.yaml'], 'give a model'),
        (['library', 'start', 'rigid', '--library', str(file), '--out', 'x.yaml'], 'has nothing'),
        (
            ['identify', 'log', '--method', 'least-squares', '--machine', 'a'],
            '--machine belongs to --method simulation',
        ),
    ):
        assert main(arguments) == 1
        error = capsys.readouterr().err
        assert said in error
        assert error.count('\n') == 1
