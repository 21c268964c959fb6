# SPDX-License-Identifier: Apache-2.0
"""Which of the fitted causes is taken, and what values a fit may give it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.confirmation import Fitted
from waferbot_twin.diagnosis.proposals.screening import Screened
from waferbot_twin.diagnosis.roles import shows_more
from waferbot_twin.diagnosis.search import _revise, _take_best
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation import gauss_newton, search, shortlist
from waferbot_twin.estimation.gauss_newton import _widths, moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import CONTROLLER, PLANT, Cause


def hypothesis(cause, log_likelihood, parameters):
    return SimpleNamespace(
        causes=(cause,),
        log_likelihood=log_likelihood,
        parameters=parameters,
        information_criterion=7.0 * parameters - 2.0 * log_likelihood,
    )


@pytest.mark.parametrize(('confirms', 'taken'), [(100.0, 'wide'), (55.0, 'simple')])
def test_a_cause_with_more_parameters_is_taken_if_the_other_logs_pay_for_them(confirms, taken):
    nothing = hypothesis(SimpleNamespace(name='nothing'), 0.0, 0)
    state = Search(nothing, nothing, nothing, nothing)
    fitted = [
        Fitted(
            hypothesis(SimpleNamespace(name=name, held=()), 100.0, parameters),
            hypothesis(None, judged, parameters),
            True,
        )
        for name, parameters, judged in (('simple', 1, 50.0), ('wide', 4, confirms))
    ]
    assert _take_best(None, None, state, fitted)
    assert state.found.causes[0].name == taken


@pytest.mark.parametrize('possible', [True, False])
def test_what_is_more_likely_than_the_cause_is_a_rival_unless_it_was_refuted(possible):
    """Coulomb friction pays less by what the command shows than four parameters that happen to suit."""
    nothing = SimpleNamespace(causes=(), log_likelihood=0.0, information_criterion=0.0)
    state = Search(nothing, nothing, nothing, nothing)
    wide, simple = (
        Fitted(
            hypothesis(SimpleNamespace(name=name, held=()), 32.0, parameters),
            hypothesis(None, judged, parameters),
            confirmed=name == 'wide',
            possible=name == 'wide' or possible,
        )
        for name, parameters, judged in (('wide', 3, 5.0), ('simple', 1, 7.0))
    )
    assert _take_best(None, None, state, [simple, wide])
    assert state.found.causes[0].name == 'wide'
    rivals = [rival.cause.name for rival in state.rivals['wide']]
    assert rivals == (['simple'] if possible else [])


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


class World:
    """Logs that say how likely sets of causes are, and nothing else."""

    correlation = 0.5

    def __init__(self, monkeypatch, log_likelihoods, promising):
        nominal = Variant.of(load_model('rigid'))
        self.nominal = nominal
        self.log_likelihoods = {frozenset(key.split()): v for key, v in log_likelihoods.items()}
        self.every = [
            Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
            for name in sorted({name for key in log_likelihoods for name in key.split()})
        ]
        self.asked = []
        for module in (search, shortlist):
            monkeypatch.setattr(module, 'fit_causes', lambda _, causes: self.hypothesis(causes))
            monkeypatch.setattr(module, 'evaluate', lambda _, causes: self.hypothesis(causes))
        monkeypatch.setattr(shortlist, '_start', lambda problem, base, item: item.cause)
        monkeypatch.setattr(shortlist, 'weighed', lambda *rest: replace(rest[3], confirmed=True))
        self.promising = promising
        self.problem, self.progress, self.workers = self, lambda *rest: None, 1

    def touched(self, effect, axis):
        return ('plant',)

    def is_exact_limit(self, cause):
        return False

    def hypothesis(self, causes):
        names = frozenset(cause.effect.name for cause in causes)
        self.asked.append(names)
        fit = SimpleNamespace(log_likelihood=self.log_likelihoods[names], samples=100)
        count = len(names_of(self, causes))
        covariance = np.full((count, count), self.correlation)
        np.fill_diagonal(covariance, 1.0)
        return Hypothesis(tuple(causes), {}, {'plant': fit}, covariance)

    def screen(self, base):
        """Stand in for the rounds of screening."""
        taken = {cause.name for cause in base.causes}
        return [
            Screened(cause, self.promising, np.zeros(1))
            for cause in self.every
            if cause.name not in taken
        ]


def test_a_cause_that_stood_in_for_two_gives_way_once_the_other_is_known(monkeypatch):
    likely = {
        '': 0.0,
        'constant_force': 70.0,
        'viscous_friction': 60.0,
        'coulomb_friction': 100.0,
        'coulomb_friction constant_force': 150.0,
        'viscous_friction constant_force': 200.0,
        'viscous_friction coulomb_friction': 110.0,
    }
    world = World(monkeypatch, likely, 50.0)
    by_name = {cause.effect.name: cause for cause in world.every}
    first = world.hypothesis([by_name['coulomb_friction'], by_name['constant_force']])
    state = Search(first, first, world.hypothesis([]), world.hypothesis([]))
    _revise(world, state, world)
    names = {cause.effect.name for cause in state.found.causes}
    assert names == {'viscous_friction', 'constant_force'}
    assert state.gains.keys() == {cause.name for cause in state.found.causes}
    rivals = {item.cause.effect.name for item in state.rivals['viscous_friction:x_rotate']}
    assert rivals == {'coulomb_friction'}


def test_causes_that_do_not_bend_each_other_are_not_chosen_again(monkeypatch):
    world = World(monkeypatch, {'': 0.0, 'deadband coulomb_friction': 9.0}, 1.0)
    world.correlation = 0.05
    both = world.hypothesis(world.every)
    state = Search(both, both, both, both)
    world.asked.clear()
    _revise(world, state, world)
    assert not world.asked
    assert state.found is both


def test_what_stood_in_for_the_usual_is_not_kept_beside_it(monkeypatch):
    nominal = Variant.of(load_model('rigid'))
    scale, bias, friction = (
        Cause(find(name), 'y_linear', find(name).typical(nominal, 'y_linear'))
        for name in ('encoder_scale', 'wrong_bias', 'coulomb_friction')
    )
    assert friction.effect.usual
    assert not scale.effect.usual
    tried = []

    def fit_together(finding, judging, causes, *rest):
        tried.extend(causes)
        raise UserError('enough')

    def touched(effect, axis):
        return (CONTROLLER,) if effect is bias.effect else (PLANT,)

    monkeypatch.setattr(search, 'fit_together', fit_together)
    monkeypatch.setattr(search, 'usual_causes', lambda *rest: ())
    found = Hypothesis((scale, bias, friction), {}, {})
    state = Search(found, found, found, found)
    finding = SimpleNamespace(touched=touched)
    rounds = SimpleNamespace(problem=finding, effects=[], progress=None, workers=1)
    search._take_together(finding, state, rounds)
    assert tried == [bias, friction]
    assert state.found is found


def test_logs_that_tell_more_of_what_was_found_find_it():
    def found(causes, in_finding, in_judging):
        return SimpleNamespace(
            found=SimpleNamespace(
                causes=(None,) * causes, parameters=causes, samples=500, log_likelihood=in_finding
            ),
            judged=SimpleNamespace(samples=500, log_likelihood=in_judging),
        )

    first = found(1, 100.0, 90.0)
    assert shows_more(found(1, 101.0, 96.0), first)  # 14 more in 2 ln L
    assert not shows_more(found(1, 98.0, 94.0), first)
    assert shows_more(found(2, 100.0, 92.0), first)
    assert not shows_more(found(0, 100.0, 90.0), first)


@pytest.mark.parametrize(('promises', 'better'), [(17.0, True), (1.0, False)])
def test_a_step_that_promises_much_is_shortened_until_it_gains(monkeypatch, promises, better):
    """What the curve of a motor does in proportion to a tenth of it says ten times too much."""
    effect = find('motor_saturation')
    variant = Variant.of(load_model('rigid'))
    cause = Cause(effect, 'y_rotate', {'curvature': 0.0})
    (parameter,) = effect.parameters(variant, 'y_rotate')
    true = 1e-3 * parameter.typical

    def simulated(problem, causes):
        error = causes[0].values['curvature'] / true - 1.0
        return SimpleNamespace(causes=causes, log_likelihood=-100.0 * error**2)

    monkeypatch.setattr(gauss_newton, 'evaluate', simulated)
    value = np.array([20.0 * true])
    matrix = np.array([[promises / value[0]]])
    linear = gauss_newton.Linear(value, np.eye(1), matrix, matrix @ value)
    now = simulated(None, (cause,))
    tried, _ = gauss_newton._step(None, now, [(0, parameter)], linear, gauss_newton.REACH)
    assert (tried is not None) == better
    if better:
        assert tried.log_likelihood > now.log_likelihood
