# SPDX-License-Identifier: Apache-2.0
"""What loses in logs that were not used for its fit is withdrawn, and what wins is kept."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.validation.gain import AxisGain
from waferbot_twin.validation.holdout import (
    extension_that_wins,
    fitted_to,
    independent_samples,
    without_refuted,
)

TOLERATED, LEVEL = Settings().tolerated_loss, Settings().refutation_level

AXES = ('y_linear', 'x_rotate', 'y_rotate')
FRICTION = Cause(find('coulomb_friction'), 'y_linear', {'friction': 5.0})
PULLED = Cause(find('constant_force'), 'y_linear', {'force': 30.0})
ODDS = {FRICTION.name: 10.0, PULLED.name: 10.0}


def as_badly(name):
    """Return that the validation data are predicted far worse with a cause, whichever."""
    return -1e3


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log(nominal, name, motion, *hidden):
    timing = Timing()
    variant = apply_all(nominal, hidden)
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(motion), twin.servo_parameters, timing.servo_hz
    )
    return record_of_signals(name, twin.advance(timing.ticks(0.3)))


def test_a_cause_of_both_logs_is_kept_and_one_of_the_first_alone_is_withdrawn(nominal):
    """Somebody leaned against the machine while the log for estimation was taken."""
    estimation = [log(nominal, 'first', 'step', FRICTION, PULLED)]
    validation = [log(nominal, 'second', 'random_y_linear', FRICTION)]
    causes = fitted_to(Problem(nominal, estimation), (FRICTION, PULLED)).causes
    found = extension_that_wins(nominal, causes, estimation, validation, TOLERATED, ODDS)
    assert [cause.name for cause in found.causes] == [FRICTION.name]
    assert [cause.name for cause in found.withdrawn] == [PULLED.name]
    (gain,) = (item for item in found.gains if item.axis == 'y_linear')
    assert gain.log == 'second'
    assert gain.improvement_percent > 0.0


def test_causes_of_both_logs_are_kept_with_values_of_the_first(nominal):
    records = [
        log(nominal, name, motion, FRICTION, PULLED)
        for name, motion in (('first', 'step'), ('second', 'random_y_linear'))
    ]
    begun = FRICTION.with_values({'friction': 1.0}), PULLED.with_values({'force': 1.0})
    causes = fitted_to(Problem(nominal, records[:1]), begun).causes
    found = extension_that_wins(nominal, causes, records[:1], records[1:], TOLERATED, ODDS)
    assert not found.withdrawn
    friction, pulled = found.causes
    assert friction.values['friction'] == pytest.approx(5.0, rel=0.05)
    assert pulled.values['force'] == pytest.approx(30.0, rel=0.05)
    (gain,) = (item for item in found.gains if item.axis == 'y_linear')
    assert gain.improvement_percent > 80.0


def test_without_causes_nothing_is_gained_or_lost(nominal):
    record = log(nominal, 'only', 'step')
    found = extension_that_wins(nominal, (), [], [record], TOLERATED, {})
    assert found.causes == found.withdrawn == ()
    assert [item.improvement_percent for item in found.gains] == pytest.approx([0.0] * 3)


@pytest.mark.parametrize(
    ('ratios', 'kept'),
    [
        ((0.7, 1.0, 1.0), True),
        ((0.7, 1.1, 1.0), True),  # what one axis loses another wins
        ((1.0, 1.0, 1.005), True),
        ((1.05, 1.0, 1.0), False),
        ((0.98, 1.3, 0.99), False),
    ],
)
def test_what_counts_is_the_mean_square_over_the_axes(monkeypatch, nominal, ratios, kept):
    error = np.sin(np.linspace(0.0, 100.0, 2000))

    def gains(before, after, records):
        same = before is after
        return [
            AxisGain(
                'log', axis, 'm', error, error, error, error * (1.0 if same else ratio), True, 0.0
            )
            for axis, ratio in zip(AXES, ratios, strict=True)
        ]

    monkeypatch.setattr('waferbot_twin.validation.holdout.gains', gains)
    found = extension_that_wins(nominal, (FRICTION,), [], [], TOLERATED, {FRICTION.name: 0.0})
    assert bool(found.causes) == kept
    assert bool(found.withdrawn) != kept


def test_an_error_of_a_part_of_a_step_of_the_reading_is_none():
    error = np.sin(np.linspace(0.0, 100.0, 2000))
    small, large = (
        AxisGain(
            'log', 'y_linear', 'm', error, error, size * error, 3.0 * size * error, True, 1e-6
        )
        for size in (1e-8, 1e-4)
    )
    assert small.mean_square_ratio == pytest.approx(1.0, abs=0.01)
    assert large.mean_square_ratio == pytest.approx(9.0, rel=0.01)


def test_what_the_validation_data_refute_is_withdrawn_and_what_they_do_not_show_is_kept(nominal):
    """A wrong bias of the controller is seen to the last bit; nobody moves the third axis."""
    bias = Cause(find('wrong_bias'), 'x_rotate', {'difference': 200.0})
    unseen = Cause(find('viscous_friction'), 'y_rotate', {'damping': 1e-4})
    hidden = FRICTION, bias, unseen
    estimation = [log(nominal, 'first', 'step', *hidden, PULLED)]
    validation = [log(nominal, 'second', 'random_y_linear', *hidden)]
    causes = fitted_to(Problem(nominal, estimation), (*hidden, PULLED)).causes
    refuted = without_refuted(Problem(nominal, validation), causes, LEVEL, as_badly)
    assert [cause.name for cause in refuted] == [PULLED.name]


def test_to_blame_is_what_the_closed_loop_gains_most_without_beside_its_odds(nominal):
    """
    Twelve times the friction that there is, found as well as a bias that is seen to the last bit.

    In closed loop the bias may go, or the wrong friction. The friction is to blame, unless the blocks
    say more for it than the closed loop against it.
    """
    bias = Cause(find('wrong_bias'), 'y_linear', {'difference': 342.0})
    validation = [log(nominal, 'second', 'random_y_linear', FRICTION, bias)]
    wrong = FRICTION.with_values({'friction': 60.0})
    found, both = (
        extension_that_wins(
            nominal, (bias, wrong), [], validation, TOLERATED, {bias.name: 1e6, wrong.name: odds}
        )
        for odds in (5.0, 1e6)
    )
    assert found.causes == (bias,)
    assert found.withdrawn == (wrong,)
    assert both.causes == (bias, wrong)
    assert both.loses(TOLERATED)
    assert not found.loses(TOLERATED)


@pytest.mark.parametrize(
    ('there', 'elsewhere', 'odds', 'withdrawn'),
    [
        # the data that it was fitted to do not defend it
        ((1.0, 0.1), (1.0, 1.5), 5.0, True),
        # they accuse it: with it the loop is unstable there, and blows up
        ((1.0, 30.0), (1.0, 0.9), 5.0, True),
        ((1.0, None), (1.0, 0.9), 5.0, True),
        # the odds are for it
        ((1.0, 30.0), (1.0, 0.9), 1e5, False),
        # it loses nowhere
        ((1.0, 0.9), (1.0, 0.9), -1.0, False),
    ],
)
def test_estimation_data_may_accuse_and_not_defend(
    monkeypatch, nominal, there, elsewhere, odds, withdrawn
):
    seed = 20261127
    print(f'seed {seed}')
    error = np.random.default_rng(seed).standard_normal(400)
    sizes = {'there': there, 'elsewhere': elsewhere}

    def gains(before, after, records):
        (name,) = records
        of_before, of_after = (sizes[name][FRICTION in one] for one in (before, after))
        if of_after is None:
            raise UserError('the plant blew up')
        return [AxisGain(name, 'y_linear', 'm', error, error, of_before * error,
                         of_after * error, True, 0.0)]  # fmt: skip

    monkeypatch.setattr('waferbot_twin.validation.holdout.gains', gains)
    monkeypatch.setattr(
        'waferbot_twin.validation.holdout.apply_all', lambda nominal, causes: tuple(causes)
    )
    found = extension_that_wins(
        (), (FRICTION,), ['there'], ['elsewhere'], TOLERATED, {FRICTION.name: odds}
    )
    assert bool(found.withdrawn) == withdrawn
    assert {one.log for one in found.gains} == {'elsewhere'}


def test_samples_are_as_independent_as_their_mean_square_varies():
    """Of white noise, of noise through a filter with a pole at 0.9 (its correlation by hand), a line."""
    seed = 20261127
    print(f'seed {seed}')
    random, count, pole = np.random.default_rng(seed), 20000, 0.9
    white = random.standard_normal(count)
    assert independent_samples(white) == pytest.approx(count, rel=0.05)
    coloured = lfilter([1.0], [1.0, -pole], white)
    # correlation pole^|k|: the sum of its squares is (1 + pole^2) / (1 - pole^2)
    expected = count * (1.0 - pole**2) / (1.0 + pole**2)
    assert independent_samples(coloured) == pytest.approx(expected, rel=0.1)
    line = np.sin(2.0 * np.pi * np.arange(count) * 10.0 / count)
    assert independent_samples(line) == pytest.approx(4.0)
    assert independent_samples(np.zeros(7)) == 7.0


@pytest.mark.parametrize('level', [1e-3, 0.05])
def test_what_is_less_likely_than_the_level_is_refuted_the_worst_first(monkeypatch, level):
    """Likelihood ratios a little above and below the level; each withdrawal asks the others anew."""
    named = {name: Cause(FRICTION.effect, name, FRICTION.values) for name in AXES}
    ratios = dict(zip(AXES, (1.1 * level, 0.9 * level, 0.5 * level), strict=True))

    def ratio(problem, causes, place):
        # Without the worst, the second is as likely as the first.
        alone = len(causes) < len(AXES)
        axis = causes[place].axis
        return math.log(1.1 * level if alone and axis == AXES[1] else ratios[axis])

    monkeypatch.setattr('waferbot_twin.validation.holdout._gain_of', ratio)
    refuted = without_refuted(None, tuple(named.values()), level, as_badly)
    assert [cause.axis for cause in refuted] == [AXES[2]]
    ratios[AXES[1]] = ratios[AXES[2]] = 1.01 * level
    assert without_refuted(None, tuple(named.values()), level, as_badly) == ()
    ratios[AXES[0]] = 0.99 * level
    refuted = without_refuted(None, tuple(named.values()), level, as_badly)
    assert [one.axis for one in refuted] == [AXES[0]]


def test_what_is_refuted_by_its_value_alone_stays_where_it_predicts_better(monkeypatch):
    """A true cause of which the estimation data tell the value badly."""
    named = {name: Cause(FRICTION.effect, name, FRICTION.values) for name in AXES}
    ratios = dict(zip(AXES, (-20.0, -30.0, -40.0), strict=True))
    predicted = dict(zip(AXES, (30.0, 0.0, -10.0), strict=True))
    asked = []

    def prediction(name):
        asked.append(name.split(':')[1])
        return predicted[asked[-1]]

    monkeypatch.setattr(
        'waferbot_twin.validation.holdout._gain_of',
        lambda problem, causes, place: ratios[causes[place].axis],
    )
    refuted = without_refuted(None, tuple(named.values()), LEVEL, prediction)
    assert asked == list(reversed(AXES))
    assert [cause.axis for cause in refuted] == [AXES[2]]
