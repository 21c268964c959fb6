# SPDX-License-Identifier: Apache-2.0
"""A cause that is nearly the truth is larger here and smaller there; a true one is not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.agreement import disagreements
from waferbot_twin.diagnosis.left_over import LeftOver
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.steadiness import unsteady
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import with_noise

SEED = 20261123


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def cause(nominal, name, axis, **values):
    effect = find(name)
    return Cause(effect, axis, effect.complete(nominal, axis, values))


def searched(nominal, hidden, named, *motions):
    """
    Return the logs of a machine with `hidden` in which `named` is fitted.

    One with noise of each motion finds, another judges.
    """
    random = np.random.default_rng(SEED)
    print(f'seed {SEED}')
    timing = Timing()

    def log(motion):
        experiment = load_experiment(motion)
        machine = with_noise(apply_all(nominal, [hidden]), nominal, 1.0, random)
        twin = Twin(built(machine, timing), machine.pmac, machine.copley, timing, 'rigid')
        twin.commanded = commanded_positions(experiment, twin.servo_parameters, timing.servo_hz)
        return record_of_signals('log', twin.advance(timing.ticks(experiment.duration_s)))

    finding, judging = (Problem(nominal, [log(motion) for motion in motions]) for _ in range(2))
    found = fit_causes(finding, (named,))
    judged = evaluate(judging, found.causes)
    return finding, judging, Search(found, judged, evaluate(finding), evaluate(judging))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('hidden', 'named', 'with_what'),
    [
        (('cold_ferrofluid', 'y_linear', {'drag': 400.0, 'time_constant': 1.0}),
         'viscous_friction', 'time'),
        (('position_dependent_friction', 'y_linear', {'mean': 20.0, 'sine': 0.5, 'period': 0.6}),
         'coulomb_friction', 'position'),
        (('load_dependent_friction', 'y_rotate', {}), 'coulomb_friction', 'current'),
    ],
)  # fmt: skip
def test_what_a_cause_stands_in_for_shows_where_it_is_larger(nominal, hidden, named, with_what):
    name, axis, values = hidden
    truth = cause(nominal, name, axis, **values)
    stand_in = cause(nominal, named, axis)
    finding, judging, search = searched(nominal, truth, stand_in, f'full_stroke_{axis}')
    doubted = unsteady(finding, judging, search)
    assert [item.cause.effect.name for item in doubted] == [named]
    assert doubted[0].with_what == with_what
    assert f'changed with the {with_what} of its axis' in str(doubted[0])
    rest = LeftOver(doubts=doubted)
    assert rest.axes == [axis]
    assert rest.in_doubt(search.found.causes[0], finding)


@pytest.mark.slow
@pytest.mark.parametrize(
    'name', ['cold_ferrofluid', 'coulomb_friction', 'cogging', 'wrong_inertia']
)
def test_a_true_cause_is_as_large_everywhere(nominal, name):
    truth = cause(nominal, name, 'y_linear')
    assert unsteady(*searched(nominal, truth, truth, 'full_stroke_y_linear')) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'axis'),
    [('coulomb_friction', 'y_linear'), ('load_dependent_friction', 'x_rotate')],
)
def test_a_large_true_friction_is_not_doubted_for_what_sticks_in_noise(nominal, name, axis):
    """It leaves something of its form over, surely no noise, but next to nothing of what it gains."""
    truth = cause(nominal, name, axis)
    in_noise = searched(nominal, truth, truth, 'wafer_exchange', 'step')
    assert unsteady(*in_noise) == []
    assert disagreements(*in_noise) == []


@pytest.mark.slow
def test_several_logs_are_asked_together(nominal):
    truth = cause(nominal, 'cold_ferrofluid', 'y_linear', drag=400.0, time_constant=1.0)
    stand_in = cause(nominal, 'viscous_friction', 'y_linear')
    motions = ('full_stroke_y_linear', 'step')
    assert unsteady(*searched(nominal, truth, truth, *motions)) == []
    (doubted,) = unsteady(*searched(nominal, truth, stand_in, *motions))
    assert doubted.with_what == 'time'


def test_without_a_noise_free_log_nothing_is_said():
    """A log without commands has none, and a model whose loop is unstable."""
    search = Search(*[SimpleNamespace(causes=())] * 4)
    uncommanded = SimpleNamespace(ideal=lambda causes: None)
    assert unsteady(uncommanded, uncommanded, search) == []

    def blows_up(causes):
        raise UserError('the loop is unstable')

    unstable = SimpleNamespace(ideal=blows_up)
    assert unsteady(unstable, unstable, search) == []
