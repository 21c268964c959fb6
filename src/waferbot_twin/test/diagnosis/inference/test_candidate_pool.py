# SPDX-License-Identifier: Apache-2.0
"""Which candidates there are beside known causes, and their prior odds."""

from __future__ import annotations

import math

import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause


def test_prior_odds_are_shared_between_the_orders_of_a_candidate(pool_of):
    """A cause that is tried at three orders, and with the order free, is no likelier for it."""
    pool = pool_of('full_stroke_y_linear', ('coulomb_friction', 'viscous_friction', 'cogging'))
    nominal = pool.problem.nominal
    odds = {}
    for name in pool.names:
        effect, axis = find(name.split(':')[0]), name.split(':')[1]
        odds[name] = pool.log_prior(Cause(effect, axis, effect.typical(nominal, axis)))
    alone = -math.log(len(pool.names))
    assert odds['coulomb_friction:y_linear'] == pytest.approx(alone)
    trials = len(find('cogging').trials(nominal, 'y_linear'))
    assert trials == 3
    assert odds['cogging:y_linear'] == pytest.approx(alone - math.log(trials + 1))


def test_what_is_before_a_drive_is_a_candidate_as_soon_as_the_drive_gives(pool_of):
    """
    Friction and inertia of the motor are those of the axis as long as nothing gives between the two.

    Beside a belt that stretches they are not: without them a machine of which both lack has no true
    model.
    """
    before = {'gearbox_friction': 'coulomb_friction', 'motor_inertia': 'wrong_inertia'}
    pool = pool_of('random_y_rotate', ('belt_compliance', *before, *before.values()))
    problem = pool.problem

    def typical(name):
        effect = find(name)
        return Cause(effect, 'y_rotate', effect.typical(problem.nominal, 'y_rotate'))

    nothing = evaluate(problem)
    pool.begin(nothing)
    belt = typical('belt_compliance')
    for base, offered in ((nothing, False), (evaluate(problem, (belt,)), True)):
        names = {item.cause.effect.name for item in pool.screen(base)}
        assert names.issuperset(before.values())
        assert names.intersection(before) == (set(before) if offered else set())
    for name, of_axis in before.items():
        found = evaluate(problem, (belt, typical(of_axis)))
        assert name in {item.cause.effect.name for item in pool.in_place_of(found)}
        alone = evaluate(problem, (typical(of_axis),))
        assert name not in {item.cause.effect.name for item in pool.in_place_of(alone)}


def test_what_could_be_in_place_of_a_cause_is_asked_beside_the_others_not_in_the_nominal_model(
    pool_of,
):
    """There drag may look like Coulomb friction; beside that it does what viscous friction does."""
    nominal = Variant.of(load_model('rigid'))
    frictions = tuple(
        Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
        for name in ('coulomb_friction', 'viscous_friction')
    )
    names = ('viscous_friction', 'coulomb_friction', 'rolling_drag')
    pool = pool_of('random_x_rotate', names, hidden=frictions)
    pool.begin(evaluate(pool.problem))
    as_there = {key[0][0]: change for key, change in pool._changes.items()}
    for key in pool._changes:
        if key[0][0] == 'rolling_drag:x_rotate':
            pool._changes[key] = as_there['coulomb_friction:x_rotate']
    found = evaluate(pool.problem, frictions)
    base = evaluate(pool.problem, frictions[:1])
    (rivals,) = pool.could_stand_for(base, [found])
    assert 'rolling_drag:x_rotate' not in {one.name for one in rivals}
    assert 'rolling_drag:x_rotate' in {item.cause.name for item in pool.in_place_of(found)}


def test_progress_says_beside_how_many_causes(pool_of):
    told = []
    pool = pool_of(
        'full_stroke_y_linear',
        ('coulomb_friction', 'constant_force'),
        lambda *one: told.append(one),
    )
    effect = find('coulomb_friction')
    friction = Cause(effect, 'y_linear', effect.typical(pool.problem.nominal, 'y_linear'))
    pool.begin(evaluate(pool.problem))
    pool.screen(evaluate(pool.problem, (friction,)))
    stages = [stage for stage, _, _ in told]
    assert list(dict.fromkeys(stages)) == ['screening', 'screening beside 1 cause']
    assert told[-1][1] == told[-1][2]
