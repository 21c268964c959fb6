# SPDX-License-Identifier: Apache-2.0
"""When an extension that was found is withdrawn for what it does to the positions."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.diagnosis import rivalry, withdrawal
from waferbot_twin.diagnosis.roles import taken_out
from waferbot_twin.diagnosis.search_state import Rival, Search
from waferbot_twin.diagnosis.withdrawal import loses
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.validation.gain import AxisGain

AXES = ('y_linear', 'x_rotate', 'y_rotate')
SAMPLES = 2000
BEFORE = 2e-6 * np.sin(np.linspace(0.0, 120.0 * np.pi, SAMPLES))


def gain(axis, before, after):
    time_s = np.arange(SAMPLES) * 1e-3
    return AxisGain('log', axis, 'm', time_s, np.zeros(SAMPLES), before, after, True)


@pytest.mark.parametrize(
    ('ratios', 'worse'),
    [
        ((1.000001, 1.0, 1.0), False),  # as of a warm winding
        ((0.7, 1.02, 1.0), False),
        ((1.0, 1.05, 1.0), True),
        ((0.98, 1.3, 0.99), True),
        ((), False),
    ],
)
def test_an_extension_is_withdrawn_if_it_plainly_loses(ratios, worse):
    gains = [gain(axis, BEFORE, ratio * BEFORE) for axis, ratio in zip(AXES, ratios, strict=False)]
    assert loses(gains) is worse


def test_what_is_lost_in_one_stretch_alone_may_be_chance():
    after = BEFORE.copy()
    after[300:400] *= 1.5  # 3 % more in RMS, by one stretch of twenty
    assert np.std(after) / np.std(BEFORE) > 1.02
    assert not loses([gain('x_rotate', BEFORE, after)])


def test_what_is_lost_in_one_stretch_alone_counts_if_it_is_much():
    after = BEFORE.copy()
    after[300:400] *= 4.0
    assert np.std(after) / np.std(BEFORE) > 1.3
    assert loses([gain('x_rotate', BEFORE, after)])


def test_noise_of_the_machine_makes_no_true_model_lose():
    seed = 20261121
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    lost = 0
    for _ in range(100):
        white = random.normal(size=SAMPLES + 39)
        noise = np.convolve(white, np.ones(40) / 40.0, 'valid')
        moved = 0.05 * np.roll(noise, int(random.integers(SAMPLES)))
        lost += loses([gain('x_rotate', noise, noise + moved)])
    assert lost <= 5


def test_a_count_that_noise_moved_an_axis_by_counts_for_nothing():
    count = 6.3e-6  # for the whole log, and the wrong model makes up for a part of it by chance
    better = [gain('x_rotate', BEFORE + 0.5 * count, 0.3 * BEFORE + count)]
    assert np.mean(better[0].error_after ** 2) > 1.5 * np.mean(better[0].error_before ** 2)
    assert not loses(better)
    assert loses([gain('x_rotate', BEFORE + 0.5 * count, 1.5 * BEFORE + count)])


def test_a_rival_that_wins_takes_the_place_of_a_cause_that_loses(monkeypatch):
    nominal = Variant.of(load_model('rigid'))
    wrong, right, far_off = (
        Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
        for name in ('force_constant', 'torque_ripple', 'coulomb_friction')
    )

    def hypothesis(*causes):
        return Hypothesis(tuple(causes), {}, {})

    found = Search(hypothesis(wrong), hypothesis(wrong), hypothesis(), hypothesis())
    found.gains = {wrong.name: 40.0}
    found.rivals = {wrong.name: [Rival(far_off, 90.0, 80.0), Rival(right, 9.0, 2.0)]}
    asked, problem = [], Problem(nominal, [])

    def gains(nominal, extended, records):
        asked.append(extended)
        loses = extended != right.effect.apply(nominal, 'x_rotate', right.values)
        return [gain('x_rotate', BEFORE, (2.0 if loses else 0.5) * BEFORE)]

    monkeypatch.setattr(withdrawal, 'gains', gains)
    monkeypatch.setattr(rivalry, 'fit_causes', lambda problem, causes: hypothesis(*causes))
    monkeypatch.setattr(rivalry, 'evaluate', lambda problem, causes: hypothesis(*causes))
    winning = withdrawal.that_wins(problem, problem, found, [])
    assert [cause.name for cause in winning.found.causes] == [right.name]
    assert winning.gains[right.name] == 40.0 - 9.0
    assert winning.rivals[right.name][0] == Rival(wrong, -9.0, -2.0)
    found.rivals = {wrong.name: [Rival(far_off, 90.0, 80.0)]}
    asked.clear()
    assert withdrawal.that_wins(problem, problem, found, []) is None
    assert len(asked) == 1


def test_no_rival_is_fitted_if_what_was_found_wins(monkeypatch):
    nominal = Variant.of(load_model('rigid'))
    own, rival = (
        Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
        for name in ('force_constant', 'torque_ripple')
    )
    causes = Hypothesis((own,), {}, {})
    found = Search(causes, causes, causes, causes)
    found.rivals = {own.name: [Rival(rival, 9.0, 2.0)]}

    def no_fit(*arguments):
        raise AssertionError('a rival was fitted')

    monkeypatch.setattr(rivalry, 'fit_causes', no_fit)
    monkeypatch.setattr(
        withdrawal, 'gains', lambda *rest: [gain('x_rotate', BEFORE, 0.5 * BEFORE)]
    )
    problem = Problem(nominal, [])
    assert withdrawal.that_wins(problem, problem, found, []) is found


def test_the_one_cause_that_makes_a_loop_swing_is_withdrawn_alone(monkeypatch):
    nominal = Variant.of(load_model('rigid'))
    causes = tuple(
        Cause(find(name), axis, find(name).typical(nominal, axis))
        for name, axis in (
            ('force_constant', 'x_rotate'),
            ('shaft_torsion_compliance', 'x_rotate'),
            ('coulomb_friction', 'y_linear'),
        )
    )
    harm = causes[1]
    covariance = np.diag([4.0, 1e-18, 9.0])
    covariance[0, 2] = covariance[2, 0] = 3.0
    both = Hypothesis(causes, {}, {}, covariance)
    found = Search(both, both, Hypothesis((), {}, {}), Hypothesis((), {}, {}))

    def gains(nominal, extended, records):
        swings = 'x_rotate_shaft_torsion' in extended.description.connections and (
            extended.description.connections['x_rotate_shaft_torsion'].flexible
        )
        return [
            gain('x_rotate', BEFORE, (14.0 if swings else 0.1) * BEFORE),
            gain('y_linear', BEFORE, 0.5 * BEFORE),
        ]

    monkeypatch.setattr(withdrawal, 'gains', gains)
    monkeypatch.setattr(
        withdrawal, 'evaluate', lambda problem, causes: Hypothesis(tuple(causes), {}, {})
    )
    problem = Problem(nominal, [])
    winning = withdrawal.that_wins(problem, problem, found, [])
    assert winning.found.causes == (causes[0], causes[2])
    np.testing.assert_allclose(winning.found.covariance, covariance[np.ix_([0, 2], [0, 2])])
    assert taken_out(found, winning) == [harm]
