# SPDX-License-Identifier: Apache-2.0
"""
Fits of many parameters with bounds, and what far from the machine means.

Truth of the fits is scipy's: bounded least squares, plain least squares with a column left out, and the
maximum of a probability.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from waferbot_twin.diagnosis.together import NEARLY, far, pays, price_of, take_out, usual_causes
from waferbot_twin.effects import find, library
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import USUAL, Linear, fit_causes, names_of, without
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import PLANT, Cause

SEED = 20
TIME_S = np.linspace(0.0, 1.0, 400)


class Term:
    """An effect of one parameter that only knows its own name."""

    usual = True

    def __init__(self, name, low, high, typical=1.0, neutral=0.0):
        self.name = name
        self._parameters = (Parameter('value', '', neutral, typical, low, high, ''),)

    def parameters(self, variant, axis):
        return self._parameters

    def apply(self, variant, axis, values):
        return {**variant, self.name: values['value']}


def model(amplitude, rate, offset):
    return amplitude * np.exp(-rate * TIME_S) + offset


class Decay:
    """A problem whose plant is a decay, measured with noise: residual measured less simulated."""

    def __init__(self, measured):
        self.nominal = {}
        self.blocks = {PLANT: [None]}
        self.measured = measured

    def touched(self, effect, axis):
        return (PLANT,)

    def residuals(self, variant, block):
        values = [variant.get(name, 0.0) for name in ('amplitude', 'rate', 'offset')]
        return [self.measured - model(*values)]

    def noises(self, block):
        return [Noise(1e-6, 0)]

    def judge(self, residuals):
        return {PLANT: likelihood(residuals[PLANT], self.noises(PLANT))}

    def quick(self):
        return self


def decay_causes(offset_low):
    return (
        Cause(Term('amplitude', -100.0, 100.0), 'x', {'value': 1.0}),
        Cause(Term('rate', 0.0, 50.0), 'x', {'value': 1.0}),
        Cause(Term('offset', offset_low, 10.0), 'x', {'value': 1.0}),
    )


@pytest.mark.parametrize('offset_low', [-10.0, 0.0])
def test_a_fit_is_the_bounded_least_squares_one_also_where_a_bound_holds(offset_low):
    random = np.random.default_rng(SEED)
    measured = model(20.0, 9.0, -0.5) + 0.05 * random.standard_normal(len(TIME_S))
    found = fit_causes(Decay(measured), decay_causes(offset_low), rounds=40, enough=1e-9)
    values = [cause.values['value'] for cause in found.causes]
    truth = least_squares(
        lambda x: measured - model(*x),
        [1.0, 1.0, 1.0],
        bounds=([-100.0, 0.0, offset_low], [100.0, 50.0, 10.0]),
        xtol=1e-12,
        ftol=1e-12,
    ).x
    assert values == pytest.approx(truth, rel=1e-3, abs=1e-3)
    assert (values[2] == 0.0) == (offset_low == 0.0)


def test_what_is_usual_is_the_most_probable_where_the_logs_do_not_decide():
    weight = 14.0
    random = np.random.default_rng(SEED)
    measured = model(8.0, 3.0, 0.0) + 0.5 * random.standard_normal(len(TIME_S))
    causes = (
        Cause(Term('amplitude', -100.0, 100.0, typical=2.0), 'x', {'value': 1.0}),
        Cause(Term('rate', 0.0, 50.0, typical=5.0), 'x', {'value': 1.0}),
        Cause(Term('offset', -50.0, 50.0, typical=0.1), 'x', {'value': 1.0}),
    )
    found = fit_causes(Decay(measured), causes, rounds=60, enough=1e-10, usual=weight)
    values = [cause.values['value'] for cause in found.causes]
    deviations = USUAL * np.array([2.0, 5.0, 0.1])

    def improbability(x):
        left = measured - model(*x)
        own = 0.5 * weight * np.sum((x / deviations) ** 2)
        return 0.5 * len(left) * np.log(np.mean(left**2)) + own

    truth = minimize(improbability, values, method='Nelder-Mead', options={'xatol': 1e-8}).x
    # a derivative is a difference over a tenth of the typical size
    assert np.all(np.abs(values - truth) < 0.02 * deviations)
    free = fit_causes(Decay(measured), causes, rounds=60, enough=1e-10)
    assert abs(values[2]) < abs(free.causes[2].values['value'])


def test_without_a_cause_the_others_make_up_for_it_as_least_squares_does():
    random = np.random.default_rng(SEED)
    matrix = random.standard_normal((50, 3)) @ np.array([[1, 0.9, 0], [0, 1, 0.5], [0, 0, 1]])
    causes = tuple(
        Cause(Term(name, -1e3, 1e3), 'x', {'value': value})
        for name, value in (('a', 2.0), ('b', -3.0), ('c', 5.0))
    )
    names = names_of(SimpleNamespace(nominal={}), causes)
    triangle = np.linalg.qr(matrix).R
    linear = Linear(np.zeros(3), np.eye(3), triangle, np.zeros(3))
    left = without(causes, names, linear, 1)
    change = np.linalg.lstsq(matrix[:, [0, 2]], -matrix[:, 1] * 3.0, rcond=None)[0]
    assert [cause.effect.name for cause in left] == ['a', 'c']
    assert [cause.values['value'] for cause in left] == pytest.approx(
        [2.0 + change[0], 5.0 + change[1]]
    )


@pytest.mark.parametrize(('judging_noise', 'kept'), [(0.05, True), (3.0, False)])
def test_a_cause_that_nearly_pays_stays_where_other_logs_pay_for_it(judging_noise, kept):
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    offset = 0.3

    def log(noise):
        return Decay(model(20.0, 9.0, offset) + noise * random.standard_normal(len(TIME_S)))

    finding, judging, tried = log(1.0), log(judging_noise), 3
    found = fit_causes(finding, decay_causes(-10.0), rounds=40, enough=1e-9)
    less = fit_causes(finding, decay_causes(-10.0)[:2], rounds=40, enough=1e-9)
    share = 2.0 * (found.log_likelihood - less.log_likelihood) / price_of(1, found.samples, tried)
    print('share of its price that the offset gains:', share)
    assert NEARLY < share < 1.0
    result = take_out(finding, judging, found, False, tried, lambda *_: None)
    names = [cause.effect.name for cause in result.found.causes]
    assert names == (['amplitude', 'rate', 'offset'] if kept else ['amplitude', 'rate'])
    if kept:
        gained = evaluate(judging, found.causes).log_likelihood
        lost = evaluate(judging, less.causes).log_likelihood
        assert 2.0 * (gained - lost) > price_of(1, found.samples, tried)


def test_what_other_logs_gain_pays_for_a_little_only():
    assert pays(10.0, -5.0, 10.0)
    assert pays(7.0, 10.0, 10.0)
    assert not pays(7.0, 9.9, 10.0)
    assert not pays(6.9, 1000.0, 10.0)


def hypothesis(residual):
    fits = {PLANT: likelihood([residual], [Noise(0.1, 24)])}
    return Hypothesis((), {PLANT: [residual]}, fits)


def test_far_is_smooth_and_large_not_loud():
    random = np.random.default_rng(SEED)
    noise = random.standard_normal(4000)
    smooth = np.sin(2.0 * np.pi * np.arange(4000) / 300.0)
    assert not far(hypothesis(noise))
    assert not far(hypothesis(100.0 * noise))
    assert not far(hypothesis(noise + smooth))
    assert far(hypothesis(noise + 100.0 * smooth))


def test_usual_causes_begin_where_a_fit_can_begin():
    variant = Variant.of(load_model('rigid'))
    problem = SimpleNamespace(nominal=variant, touched=lambda effect, axis: (PLANT,))
    taken = Cause(find('coulomb_friction'), 'x_rotate', {'friction': 1.0})
    begin = {cause.name: cause for cause in usual_causes(problem, library().values(), [taken])}
    assert 'coulomb_friction:x_rotate' not in begin
    assert 'coulomb_friction:y_linear' in begin
    assert 'backlash:y_rotate' not in begin
    cable = begin['cable_compliance:y_linear']
    (compliance,) = cable.effect.parameters(variant, 'y_linear')
    assert cable.values['compliance'] == compliance.typical > 0.0
    assert begin['force_constant:x_rotate'].values == {'ratio': 1.0}
    assert begin['encoder_delay:x_rotate'].values == {'delay': 0.0}
