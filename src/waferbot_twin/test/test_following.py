# SPDX-License-Identifier: Apache-2.0
"""What is left over and follows the command, with no effect in mind."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.following import _along_the_way, axes_that_follow
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.synthesis import with_noise

SEED = 20261128


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def logged(nominal, variant, random, motion):
    timing = Timing()
    noisy = with_noise(variant, nominal, 1.0, random)
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(motion), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.8)))])


def axes_of(nominal, variant, seed, motion='step'):
    random = np.random.default_rng(seed)
    problem, judge = (logged(nominal, variant, random, motion) for _ in range(2))
    found, judged = evaluate(problem), evaluate(judge)
    return axes_that_follow(problem, judge, Search(found, judged, found, judged))


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(SEED, SEED + 4))
def test_noise_does_not_follow_the_command(nominal, seed):
    print(f'seed {seed}')
    assert axes_of(nominal, nominal, seed) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'values'),
    [
        ('coulomb_friction', {'friction': 3.0}),  # of the plant
        ('winding_temperature', {'rise': 40.0}),  # of the windings
    ],
)
def test_something_that_the_model_lacks_does_on_its_axis(nominal, name, values):
    print(f'seed {SEED}')
    machine = find(name).apply(nominal, 'y_linear', values)
    assert 'y_linear' in axes_of(nominal, machine, SEED)


@pytest.mark.slow
def test_a_motor_that_is_less_even_than_its_model_shows_in_harmonics_of_its_cycle(nominal):
    print(f'seed {SEED}')
    ripple = {'cosine': 0.0, 'sine': 0.004, 'order': 2.0}
    machine = find('torque_ripple').apply(nominal, 'y_linear', ripple)
    assert axes_of(nominal, machine, SEED, 'full_stroke_y_linear') == ['y_linear']
    assert axes_of(nominal, nominal, SEED, 'full_stroke_y_linear') == []


@pytest.mark.slow
def test_what_an_encoder_shows_wrongly_is_told_beside_the_other_one_of_its_axis(nominal):
    """A tenth of a count over three periods, lost in the noise of the motor's encoder by itself."""
    print(f'seed {SEED}')
    error = {'cosine': 0.1, 'sine': 0.04, 'period': 512.0}
    machine = find('interpolation_error').apply(nominal, 'y_rotate', error)
    assert axes_of(nominal, machine, SEED) == ['y_rotate']


def test_an_axis_that_stands_has_nothing_along_its_way():
    """Each log has as many regressors, whether the axis moves there or not."""
    stands, moves = (SimpleNamespace(position=np.linspace(0.0, way, 50)) for way in (0.0, 9.0))
    assert not np.any(_along_the_way(stands))
    assert len(_along_the_way(stands)) == len(_along_the_way(moves))
    assert np.all(np.ptp(_along_the_way(moves), axis=1) > 1.9)


def test_without_a_noise_free_log_nothing_is_said():
    """A log without commands has none, and a model whose loop is unstable."""
    nothing = SimpleNamespace(causes=())
    search = Search(*[nothing] * 4)
    uncommanded = SimpleNamespace(ideal=lambda causes: None)
    assert axes_that_follow(uncommanded, uncommanded, search) == []

    def blows_up(causes):
        raise UserError('the loop is unstable')

    unstable = SimpleNamespace(ideal=blows_up)
    assert axes_that_follow(unstable, unstable, search) == []
