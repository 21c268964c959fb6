# SPDX-License-Identifier: Apache-2.0
"""The dense effect: what every machine, and every log, has a little different."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.diagnosis.inference import single_effects
from waferbot_twin.diagnosis.inference.nuisance import (
    LOGS,
    each_once,
    in_place_of_bounds,
    nuisance,
)
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, Posterior, SingleEffect
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.from_measured_log import aligned_record, record_of_measured_log
from waferbot_twin.residuals.problem import PLANT, Cause, Problem, apply_all


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def dense(nominal, records, name='nuisance_parameters', **values):
    (effect,) = (one for one in nuisance(nominal, records, Settings())[0] if one.name == name)
    (axis,) = effect.axes(nominal)
    parameters = effect.parameters(nominal, axis)
    return Cause(effect, axis, {item.name: values.get(item.name, 0.0) for item in parameters})


def test_with_nothing_off_the_machine_is_as_it_was(nominal):
    changed = apply_all(nominal, [dense(nominal, [])])
    assert changed.description.bodies.keys() == nominal.description.bodies.keys()
    for name, body in nominal.description.bodies.items():
        assert changed.description.bodies[name].mass == body.mass
    assert not any(changed.deviations.values())


def test_what_a_data_sheet_has_is_off_by_shares(nominal):
    _, known = nuisance(nominal, [], Settings())
    mass = next(item for item in known if item.path == 'bodies.carriage.mass_kg')
    changed = apply_all(nominal, [dense(nominal, [], **{mass.path: 0.06})])
    assert changed.description.bodies['carriage'].mass == pytest.approx(
        1.06 * nominal.description.bodies['carriage'].mass
    )
    assert changed.deviations[mass.path] == pytest.approx(0.06 / Settings().spread_of_masses)


SKEW_S, STEP_S = 3e-4, 1e-3


def log_of(variant, late_s):
    """Return a log of an axis that has inertia alone; its drive stands so much later in it."""
    time_s = STEP_S * np.arange(4000)
    wave, phase = np.array([3.0, 7.0, 19.0]), np.array([0.3, 1.0, 2.0])
    angle = np.sin(np.outer(time_s, wave) + phase) @ (1.0 / wave)
    rate = -np.sin(np.outer(time_s - late_s, wave) + phase) @ wave
    inertia = places.moving_inertia(variant, 'y_rotate')
    return MeasuredLog(
        'log',
        (
            Signal('position', 'y_rotate', 'rad', time_s, angle, 1e-6),
            Signal('force', 'y_rotate', 'Nm', time_s, inertia * rate),
        ),
    )


def test_the_time_of_a_drive_is_open_by_what_lies_between_samples():
    """As late as half a step either way, any time as probable as another."""
    geared = Variant.of(load_model_or_machine('geared_pendulum'))
    record = aligned_record(log_of(geared, 0.0), geared)
    _, known = nuisance(geared, [record, record], Settings())
    (skew,) = (item for item in known if item.section == LOGS)
    assert skew.name == 'y_rotate'
    assert STEP_S / math.sqrt(12.0) <= skew.spread < STEP_S
    assert not any(item.section == LOGS for item in nuisance(geared, [], Settings())[1])


def test_a_skew_of_the_dense_effect_is_that_of_a_log():
    geared = Variant.of(load_model_or_machine('geared_pendulum'))
    late = record_of_measured_log(log_of(geared, SKEW_S), geared)
    records = [replace(late, skew_spread_s=(0.0, 0.0, STEP_S))]
    cause = dense(geared, records, 'nuisance_times')
    path = 'logs.y_rotate.skew_s'
    known = Problem(geared, [record_of_measured_log(log_of(geared, 0.0), geared)])
    (without,) = known.residuals(geared, PLANT)

    def off(skew_s):
        variant = apply_all(geared, [cause.with_values({path: skew_s})])
        (left,) = Problem(geared, [late]).residuals(variant, PLANT)
        return float(np.sqrt(np.mean((left - without) ** 2)))

    # Forces go straight between samples, here at other times: some of it stays.
    assert off(SKEW_S) < 0.2 * off(0.0)
    assert off(0.0) < off(-SKEW_S)
    machines = [
        apply_all(geared, [cause.with_values({path: skew})]).machine for skew in (0.0, SKEW_S)
    ]
    assert machines[0] == machines[1]


def test_what_has_a_cause_does_not_deviate_besides(nominal):
    """Else a cause and a correction would share one number, and no log could tell how."""
    _, known = nuisance(nominal, [], Settings())
    off = dense(nominal, [], **{item.path: 0.5 * item.spread for item in known})
    constant = Cause(find('force_constant'), 'x_rotate', {'ratio': 0.8})
    friction = Cause(find('coulomb_friction'), 'x_rotate', {'friction': 1.0})
    nothing = Cause(find('force_constant'), 'y_linear', {'ratio': 1.0})
    problem = SimpleNamespace(nominal=nominal)
    *others, once = each_once(problem, (constant, friction, nothing, off))
    assert others == [constant, friction, nothing]
    (held,) = once.held
    assert held.startswith('motors.x_rotate.')
    assert once.values == {**off.values, held: 0.0}
    (free,) = each_once(problem, (once,))
    assert free.held == ()


def test_what_is_as_far_off_as_any_may_be_is_said_by_a_cause_of_the_same_number(nominal):
    """At the value with which it says the same, and the number does not deviate besides."""
    key = 'back_emf_lead_to_lead_v_s_m'
    path = f'motors.y_linear.{key}'
    _, known = nuisance(nominal, [], Settings())
    number = next(item for item in known if item.path == path)
    low, high = number.room
    candidates = [
        Cause(find(name), axis, find(name).typical(nominal, axis))
        for name in ('force_constant', 'wrong_inertia', 'coulomb_friction')
        for axis in find(name).axes(nominal)
    ]
    problem = SimpleNamespace(nominal=nominal)
    for x in (low, high):
        off = dense(nominal, [], **{path: x})
        ((once, named),) = in_place_of_bounds(problem, (off,), candidates)
        assert named.name == 'force_constant:y_linear'
        assert once.held == (path,)
        before, after = (apply_all(nominal, one) for one in ((off,), (once, named)))
        one, other = (
            places.plain(nominal, variant.machine['motors']['y_linear'][key])
            for variant in (before, after)
        )
        assert other == pytest.approx(one)
        assert not in_place_of_bounds(problem, (off, named), [named])
    inside = dense(nominal, [], **{path: 0.99 * high})
    assert in_place_of_bounds(problem, (inside,), candidates) == []


BEARING = ('x_rotate_bearing_radial', 'x_rotate_bearing_y', 'x_rotate_bearing_z')


def test_the_damping_of_a_part_is_off_by_a_factor_in_all_directions_of_it(nominal):
    """A factor of 5: what is known of it is the order of magnitude, eq. (5.5)."""
    _, known = nuisance(nominal, [], Settings())
    (bearing,) = (one for one in known if one.is_damping and one.name in BEARING)
    assert {bearing.name, *bearing.also} == set(BEARING)
    changed = apply_all(
        nominal, [dense(nominal, [], 'nuisance_dampings', **{bearing.path: math.log(5.0)})]
    )
    for name, before in nominal.description.connections.items():
        times = 5.0 if name in BEARING else 1.0
        assert changed.description.connections[name].loss_factor == pytest.approx(
            times * before.loss_factor
        )
    assert changed.deviations[bearing.path] == pytest.approx(
        math.log(5.0) / Settings().spread_of_dampings
    )


def test_the_damping_of_a_part_that_is_softer_too_is_both(nominal):
    """In whatever order they come; a shaft is given without its part, with its loss factor."""
    path = 'connections.x_rotate_shaft_torsion.damping_factor'
    damping = dense(nominal, [], 'nuisance_dampings', **{path: math.log(5.0)})
    for effect in ('shaft_torsion_compliance', 'shaft_bending_compliance'):
        soft = Cause(find(effect), 'x_rotate', find(effect).typical(nominal, 'x_rotate'))
        for causes in ((damping, soft), (soft, damping)):
            shaft = apply_all(nominal, causes).description.connections[
                f'x_rotate_shaft_{effect.split("_")[1]}'
            ]
            assert shaft.flexible
            assert shaft.loss_factor == pytest.approx(5.0 * 0.003)


def test_the_damping_of_what_does_not_give_is_held(nominal):
    """Without any effect it has no part in a fit; beside a compliance that of its part is free."""
    problem = SimpleNamespace(nominal=nominal)
    every = dense(nominal, [], 'nuisance_dampings')
    (rigid,) = each_once(problem, (every,))
    assert rigid.free == 0
    for effect in ('bearing_moment_compliance', 'bearing_radial_compliance'):
        soft = Cause(find(effect), 'x_rotate', find(effect).typical(nominal, 'x_rotate'))
        _, once = each_once(problem, (soft, rigid))
        (free,) = every.values.keys() - set(once.held)
        assert free.removeprefix('connections.').removesuffix('.damping_factor') in BEARING
    assert each_once(problem, (soft, rigid, dense(nominal, [])))[-1].held == ()


def test_what_a_cause_had_changed_deviates_again_when_it_is_gone(nominal, monkeypatch):
    monkeypatch.setattr(single_effects, 'to_the_end', lambda problem, found, workers: found)
    monkeypatch.setattr(
        single_effects, 'evaluate', lambda problem, causes: SimpleNamespace(causes=causes)
    )
    constant = Cause(find('force_constant'), 'x_rotate', {'ratio': 0.8})
    problem = SimpleNamespace(nominal=nominal)
    both = each_once(problem, (constant, dense(nominal, [])))
    effects = tuple(
        SingleEffect((Member(SimpleNamespace(causes=(cause,)), 9.0, 0.0, 1.0),), 0.0)
        for cause in both
    )
    posterior = Posterior(None, SimpleNamespace(causes=both), effects, 2)
    assert both[1].held
    left = posterior.without(problem, [constant])
    assert left.effects == effects[1:]
    assert [cause.held for cause in left.found.causes] == [()]


def test_where_there_is_no_such_machine_that_is_for_its_simulation_to_say(nominal):
    """A load within its bounds, heavy and far out at once, is more than the bearing's chart has."""
    parameters = find('load').parameters(nominal, 'x_rotate')
    beyond = Cause(find('load'), 'x_rotate', {item.name: item.high for item in parameters})
    with pytest.raises(UserError, match='beyond the last point'):
        apply_all(nominal, (beyond,)).build(Timing())
    every = dense(nominal, [], 'nuisance_dampings')
    _, once = each_once(SimpleNamespace(nominal=nominal), (beyond, every))
    assert once.held == ()
