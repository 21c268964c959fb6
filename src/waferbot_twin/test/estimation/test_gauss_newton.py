# SPDX-License-Identifier: Apache-2.0
"""
Fits of many parameters within their bounds, and the steps that lead there.

Truth of the fits is scipy's bounded least squares.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares

from waferbot_twin.effects import find
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation import gauss_newton
from waferbot_twin.estimation.conditional import shown_by
from waferbot_twin.estimation.gauss_newton import _widths, fit_causes, least_squares_within, moved
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import PLANT, Cause

SEED = 20
TIME_S = np.linspace(0.0, 1.0, 400)


class Term:
    """An effect of one parameter that only knows its own name."""

    def __init__(self, name, low, high):
        self.name = name
        self._parameters = (Parameter('value', '', 0.0, 1.0, low, high, ''),)

    def parameters(self, variant, axis):
        return self._parameters

    def apply(self, variant, axis, values):
        return {**variant, self.name: values['value']}


def model(amplitude, rate, offset):
    return amplitude * np.exp(-rate * TIME_S) + offset


class Decay:
    """A problem whose plant is a decay, measured with noise: residual measured less simulated."""

    size_scales = ()

    def __init__(self, measured):
        self.nominal = {}
        self.blocks = {PLANT: [None]}
        self.measured = measured

    def touched(self, effect, axis):
        return (PLANT,)

    def between(self, one, other):
        return (PLANT,)

    def residuals(self, variant, block, workers=1):
        values = [variant.get(name, 0.0) for name in ('amplitude', 'rate', 'offset')]
        return [self.measured - model(*values)]

    def noises(self, block):
        return [Noise(1e-6, 0)]

    def judge(self, residuals):
        return {PLANT: likelihood(residuals[PLANT], self.noises(PLANT))}


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


@pytest.mark.parametrize(
    ('name', 'shape'),
    [
        ('stribeck_friction', 'speed'),
        ('cold_ferrofluid', 'time_constant'),
        ('presliding', 'distance'),
        ('position_dependent_friction', 'cosine'),
        ('position_dependent_friction', 'sine'),
    ],
)
def test_a_fit_can_move_a_shape_from_where_it_is_typical(name, shape):
    nominal = Variant.of(load_model('rigid'))
    cause = Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
    (item,) = (item for item in cause.effect.parameters(nominal, 'x_rotate') if item.name == shape)
    (width,) = _widths([cause], [(0, item)])
    assert width > 0.05 * (cause.values[shape] or item.high)


def test_settings_that_are_whole_numbers_stay_so():
    nominal = Variant.of(load_model('rigid'))
    causes = (
        Cause(find('wrong_bias'), 'x_rotate', {'difference': 0.0}),
        Cause(find('wrong_derivative_gain'), 'x_rotate', {'ratio': 1.0}),
        Cause(find('coulomb_friction'), 'x_rotate', {'friction': 0.0}),
    )
    names = [
        (place, item)
        for place, cause in enumerate(causes)
        for item in cause.effect.parameters(nominal, cause.axis)
    ]
    bias, derivative, friction = moved(causes, names, np.array([-3199.52, 0.0002, 0.123]))
    assert bias.values == {'difference': -3200.0}
    assert derivative.values == {'ratio': 1.0}
    assert friction.values == {'friction': 0.123}


@pytest.mark.parametrize(('promises', 'better'), [(17.0, True), (1.0, False)])
def test_a_step_that_promises_much_is_shortened_until_it_gains(monkeypatch, promises, better):
    """What the curve of a motor does in proportion to a tenth of it says ten times too much."""
    effect = find('motor_saturation')
    variant = Variant.of(load_model('rigid'))
    cause = Cause(effect, 'y_rotate', {'curvature': 0.0})
    (parameter,) = effect.parameters(variant, 'y_rotate')
    true = 1e-3 * parameter.typical

    def simulated(problem, causes, workers=1):
        error = causes[0].values['curvature'] / true - 1.0
        return SimpleNamespace(causes=causes, log_likelihood=-100.0 * error**2)

    monkeypatch.setattr(gauss_newton, 'evaluate', simulated)
    monkeypatch.setattr(
        gauss_newton,
        'log_likelihood_ratio',
        lambda this, other: this.log_likelihood - other.log_likelihood,
    )
    value = np.array([20.0 * true])
    matrix = np.array([[promises / value[0]]])
    linear = gauss_newton.Linear(value, matrix, matrix @ value)
    now = simulated(None, (cause,))
    tried, _ = gauss_newton._step(
        SimpleNamespace(nominal=None, size_scales=()),
        now,
        [(0, parameter)],
        linear,
        gauss_newton.Reach(),
    )
    assert (tried is not None) == better
    if better:
        assert tried.log_likelihood > now.log_likelihood


def test_what_a_bound_holds_promises_nothing(monkeypatch):
    """The offset would do much beyond its bound; a fit that has come there is at its end."""
    print(f'seed {SEED}')
    noise = 0.05 * np.random.default_rng(SEED).standard_normal(len(TIME_S))

    def sought(*_):
        raise AssertionError('a cause was sought that makes the step of all others fail')

    problem = Decay(model(20.0, 9.0, -5.0) + noise)
    found = fit_causes(problem, decay_causes(0.0), rounds=40, enough=1e-9)
    assert found.causes[2].values['value'] == 0.0
    monkeypatch.setattr(gauss_newton, '_sound', sought)
    again = fit_causes(problem, found.causes, rounds=40, enough=1e-9)
    assert again.log_likelihood == pytest.approx(found.log_likelihood, abs=1e-6)


@pytest.mark.parametrize(('optimum', 'tried'), [(8.0, [1.0, 2.0, 4.0, 8.0]), (1.0, [1.0])])
def test_a_step_is_doubled_as_long_as_it_gains_more(monkeypatch, optimum, tried):
    """The linear problem says 1; the likelihood is a parabola of the same slope about its optimum."""
    seen = []

    def simulated(problem, causes, workers=1):
        x = causes[0].values['value']
        seen.append(x)
        return SimpleNamespace(causes=causes, log_likelihood=x - x**2 / (2.0 * optimum))

    monkeypatch.setattr(gauss_newton, 'evaluate', simulated)
    monkeypatch.setattr(
        gauss_newton,
        'log_likelihood_ratio',
        lambda this, other: this.log_likelihood - other.log_likelihood,
    )
    cause = Cause(Term('value', -100.0, 100.0), 'x', {'value': 0.0})
    linear = gauss_newton.Linear(np.ones(1), np.ones((1, 1)), np.ones(1))
    names = [(0, cause.effect.parameters(None, 'x')[0])]
    now = SimpleNamespace(causes=(cause,), log_likelihood=0.0)
    problem = SimpleNamespace(nominal=None, size_scales=())
    found, _ = gauss_newton._step(problem, now, names, linear, gauss_newton.Reach())
    assert seen == tried
    assert found.causes[0].values['value'] == optimum


class Jump(Decay):
    """The decay with something that is another machine as soon as there is any of it."""

    def residuals(self, variant, block, workers=1):
        (left,) = super().residuals(variant, block)
        return [left + (5.0 * np.sign(TIME_S - 0.5) if variant.get('jump', 0.0) > 0.0 else 0.0)]


def test_a_cause_that_jumps_does_not_hold_the_others_where_they_are():
    """Its slope is a jump over a step, so no step of all parameters together gains anything."""
    print(f'seed {SEED}')
    noise = np.random.default_rng(SEED).normal(0.0, 0.01, len(TIME_S))
    begun = (*decay_causes(-10.0), Cause(Term('jump', 0.0, 1.0), 'x', {'value': 0.0}))
    found = fit_causes(Jump(model(3.0, 7.0, 0.5) + noise), begun)
    values = [cause.values['value'] for cause in found.causes]
    assert values == pytest.approx([3.0, 7.0, 0.5, 0.0], rel=0.02)


def test_what_changes_nothing_stays_where_it_is():
    matrix = np.array([[2.0, 0.0], [0.0, 0.0]])
    low, high = np.array([-1.0, -5.0]), np.array([1.0, 5.0])
    assert least_squares_within(matrix, np.array([1.0, 0.0]), low, high) == pytest.approx(
        [0.5, 0.0]
    )
    assert least_squares_within(np.zeros((2, 2)), np.zeros(2), low, high) == pytest.approx(
        [0.0, 0.0]
    )


class Wave:
    """An effect of a size and an order, which is a shape."""

    name = 'wave'

    def parameters(self, variant, axis):
        return (
            Parameter('size', '', 0.0, 1.0, -1e3, 1e3, ''),
            Parameter('order', '', 0.0, 20.0, 0.5, 100.0, '', shape=True),
        )

    def apply(self, variant, axis, values):
        return {**variant, **values}


class Ripple(Decay):
    """A problem whose plant is a decay with a wave of some order over it."""

    def residuals(self, variant, block, workers=1):
        (left,) = super().residuals(variant, block)
        return [left - variant.get('size', 0.0) * np.sin(variant.get('order', 0.0) * TIME_S)]


def test_an_order_stays_where_it_is_as_long_as_sizes_are_wrong(monkeypatch):
    """Asked together with them, it goes to where the wave does the work of the decay."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    measured = model(20.0, 9.0, -0.5) + np.sin(41.0 * TIME_S)
    measured += 0.05 * random.standard_normal(len(TIME_S))
    causes = (*decay_causes(-10.0), Cause(Wave(), 'x', {'size': 0.5, 'order': 40.0}))
    tried, evaluate = [], gauss_newton.evaluate

    def noted(problem, causes, workers=1):
        tried.append([value for cause in causes for value in cause.values.values()])
        return evaluate(problem, causes)

    monkeypatch.setattr(gauss_newton, 'evaluate', noted)
    found = fit_causes(Ripple(measured), causes)
    values = [value for cause in found.causes for value in cause.values.values()]
    assert values == pytest.approx([20.0, 9.0, -0.5, 1.0, 41.0], rel=0.05)
    wrong = [one for one in tried if abs(one[1] - 9.0) > 1.0]
    assert len(wrong) > 2
    assert {one[4] for one in wrong} == {40.0}


class Bend(Decay):
    """A problem that bends: over a usual way its slope is another one than over what the log shows."""

    def residuals(self, variant, block, workers=1):
        x = variant.get('bend', 0.0)
        return [self.measured - (x + 30.0 * abs(x) * x) * (1.0 + TIME_S)]


def test_a_fit_ends_where_the_likelihood_is_flat_and_not_the_slope_over_a_usual_way():
    """From 0, and no further than a little: slopes over a tenth of the usual way are four times it."""
    print(f'seed {SEED}')
    noise = np.random.default_rng(SEED).normal(0.0, 1e-3, len(TIME_S))
    problem = Bend(2e-3 * (1.0 + TIME_S) + noise)
    found = fit_causes(problem, (Cause(Term('bend', -9.0, 9.0), 'x', {'value': 0.0}),))
    truth = least_squares(lambda x: problem.residuals({'bend': x[0]}, PLANT)[0], [0.0], xtol=1e-12)
    value, error = found.causes[0].values['value'], float(np.sqrt(found.covariance[0, 0]))
    assert value == pytest.approx(truth.x[0], abs=0.05 * error)
    # Of the normal equations there: the slope is that of equation and log, by hand.
    slope = (1.0 + 60.0 * truth.x[0]) * (1.0 + TIME_S)
    assert error == pytest.approx(1e-3 / float(np.linalg.norm(slope)), rel=0.15)


@pytest.mark.parametrize('offset_low', [-10.0, 0.0])
def test_a_fit_says_what_another_one_may_gain(offset_low):
    """Next to nothing at its end, also at a bound; and on the way what the linear problem promises."""
    print(f'seed {SEED}')
    noise = 0.05 * np.random.default_rng(SEED).standard_normal(len(TIME_S))
    problem, causes = Decay(model(20.0, 9.0, -0.5) + noise), decay_causes(offset_low)
    best = fit_causes(problem, causes, rounds=40, enough=1e-9)
    assert best.promised < gauss_newton.ENOUGH
    near = tuple(
        cause.with_values({'value': cause.values['value'] + more})
        for cause, more in zip(best.causes, (0.1, 0.0, 0.0), strict=True)
    )
    begun = gauss_newton.evaluate(problem, near)
    found = gauss_newton._with_covariance(
        problem, begun, gauss_newton.all_signatures(problem, begun)
    )
    before, after = (float(np.sum(one.residuals[PLANT][0] ** 2)) for one in (begun, best))
    by_hand = (
        0.5 * len(TIME_S) * (before - after) / before
    )  # in noise as large as what is left over
    assert found.promised == pytest.approx(by_hand, rel=0.01)


@pytest.mark.parametrize('told', [(), ('amplitude',), ('amplitude', 'rate', 'offset')])
def test_where_a_fit_has_told_how_far_to_go_signatures_are_not_found_twice(monkeypatch, told):
    """Only those of which nothing is known are found anew after the first step; the fit is the same."""
    rng = np.random.default_rng(SEED)
    print(f'seed {SEED}')
    problem = Decay(model(3.0, 4.0, 0.5) + 0.01 * rng.standard_normal(len(TIME_S)))
    causes = decay_causes(-10.0)
    before = fit_causes(problem, causes)
    shown = {key: one for key, one in shown_by(problem, before).items() if key[0][:-2] in told}
    found = []
    slope = gauss_newton.signature

    def counted(problem, now, every, place, errors):
        found.append(every[place].name)
        return slope(problem, now, every, place, errors)

    monkeypatch.setattr(gauss_newton, 'signature', counted)
    again = fit_causes(problem, causes, rounds=2, shown=shown)
    once = [f'{name}:x' for name in ('amplitude', 'rate', 'offset')]
    assert found == [*once, *(name for name in once if name[:-2] not in told)]
    monkeypatch.undo()
    again = fit_causes(problem, causes, shown=shown)
    for one, other in zip(again.causes, before.causes, strict=True):
        assert one.values['value'] == pytest.approx(other.values['value'], rel=1e-3)


class InSteps(Decay):
    """A decay that can be simulated in longer steps, which make another one of it."""

    longer = False

    def residuals(self, variant, block, workers=1):
        rate = 0.9 * variant.get('rate', 0.0) if self.longer else variant.get('rate', 0.0)
        return super().residuals({**variant, 'rate': rate}, block)

    def quick(self):
        other = InSteps(self.measured)
        other.longer = True
        return other


@pytest.mark.parametrize('near', [(), ('amplitude',), ('amplitude', 'rate', 'offset')])
@pytest.mark.parametrize('roughly', [0.0, 1e-2])
def test_a_fit_of_a_search_begins_with_what_is_near_or_in_longer_steps(monkeypatch, near, roughly):
    """And ends with its own signatures, unless a rough fit is all that is wanted."""
    rng = np.random.default_rng(SEED)
    print(f'seed {SEED}')
    problem = InSteps(model(3.0, 4.0, 0.5) + 0.01 * rng.standard_normal(len(TIME_S)))
    causes = decay_causes(-10.0)
    before = fit_causes(problem, causes)
    names = [cause.name for cause in causes]
    each = gauss_newton.all_signatures(problem, before)
    begun = {name: one for name, one in zip(names, each, strict=True) if name[:-2] in near}
    found = []
    slope = gauss_newton.signature

    def told(problem, now, every, place, errors):
        found.append((every[place].name, problem.longer))
        return slope(problem, now, every, place, errors)

    monkeypatch.setattr(gauss_newton, 'signature', told)
    again = fit_causes(
        problem, causes, enough=0.3, roughly=roughly, shown=shown_by(problem, before), begun=begun
    )
    first = [name for name in names if name not in begun]
    assert found[: len(first)] == [(name, True) for name in first]
    assert found[len(first) :] == [(name, bool(roughly)) for name in names]
    error = np.sqrt(np.diag(before.covariance))
    far = 0.5 if roughly else 0.1
    for one, other, deviation in zip(again.causes, before.causes, error, strict=True):
        assert one.values['value'] == pytest.approx(other.values['value'], abs=far * deviation)


@pytest.mark.parametrize('roughly', [0.0, 1e-2])
def test_a_fit_that_begins_with_signatures_that_lead_nowhere_finds_its_own(roughly):
    """Those from near here may be of another machine: against the slopes no step is a better one."""
    rng = np.random.default_rng(SEED)
    print(f'seed {SEED}')
    problem = InSteps(model(3.0, 4.0, 0.5) + 0.01 * rng.standard_normal(len(TIME_S)))
    causes = decay_causes(-10.0)
    before = fit_causes(problem, causes)
    each = gauss_newton.all_signatures(problem, before)
    wrong = {
        cause.name: {block: -rows for block, rows in one.items()}
        for cause, one in zip(causes, each, strict=True)
    }
    again = fit_causes(problem, causes, enough=0.3, roughly=roughly, begun=wrong)
    assert again.log_likelihood > before.log_likelihood - 1.0
