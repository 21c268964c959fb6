# SPDX-License-Identifier: Apache-2.0
"""Round after round of screening: nothing is asked twice, and nothing else comes out."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis import screening_rounds
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.diagnosis.screening_rounds import Rounds
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import CONTROLLER, PLANT, Cause, Problem, apply_all

EFFECTS = (
    'coulomb_friction',
    'viscous_friction',
    'wrong_bias',
    'wrong_proportional_gain',
    'notch',
)

pytestmark = pytest.mark.slow


def quiet(what, done, total):
    """Show no progress."""


@pytest.fixture(scope='module')
def problem():
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    hidden = (
        Cause(find('wrong_bias'), 'x_rotate', {'difference': 40.0}),
        Cause(find('coulomb_friction'), 'x_rotate', {'friction': 0.5}),
    )
    variant = apply_all(nominal, hidden)
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('random_x_rotate'), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.4)))])


def told(screened):
    return [(item.cause.name, item.cause.values, item.score, *item.value) for item in screened]


def test_beside_a_wrong_setting_the_plant_is_not_asked_again(problem, monkeypatch):
    asked = []

    def screen(problem, base, rivals, *rest):
        asked.extend(rival.name for rival in rivals)
        return screening(problem, base, rivals, *rest)

    def screen_lines(*rest):
        asked.append('lines')
        return lines(*rest)

    screening, lines = screening_rounds.screen, screening_rounds.screen_lines
    monkeypatch.setattr(screening_rounds, 'screen', screen)
    monkeypatch.setattr(screening_rounds, 'screen_lines', screen_lines)
    effects = [find(name) for name in EFFECTS]
    bias = Cause(find('wrong_bias'), 'x_rotate', {'difference': 40.0})
    friction = Cause(find('coulomb_friction'), 'x_rotate', {'friction': 0.5})
    nothing, setting, both = (
        evaluate(problem, causes) for causes in ((), (bias,), (bias, friction))
    )

    rounds = Rounds(problem, effects, quiet)
    rounds.begin(nothing)
    first = rounds.screen(nothing)
    assert first[0].cause.name in (bias.name, friction.name)
    assert 'lines' in asked
    asked.clear()
    second = rounds.screen(setting)
    assert asked
    assert 'lines' not in asked
    of_plant = {
        item.name
        for item in candidates(problem, effects)
        if PLANT in problem.touched(item.effect, item.axis)
    }
    assert of_plant
    assert not of_plant.intersection(asked)
    assert second[0].cause.name == friction.name
    asked.clear()
    third = rounds.screen(both)
    assert of_plant - {friction.name} <= set(asked)

    # Without what was remembered the same comes out, to the last bit.
    for causes, remembered in ((setting, second), (both, third)):
        alone = Rounds(problem, effects, quiet)
        alone.begin(nothing)
        assert told(alone.screen(causes)) == told(remembered)
    asked.clear()
    assert told(rounds.screen(setting)) == told(second)
    assert not asked


def test_a_search_that_begins_with_a_cause_keeps_what_that_does_not_change(problem, monkeypatch):
    asked = []

    def signatures(problem, base, rivals, *rest):
        asked.extend(rival.name for rival in rivals)
        return finding(problem, base, rivals, *rest)

    finding = screening_rounds.signatures
    monkeypatch.setattr(screening_rounds, 'signatures', signatures)
    effects = [find(name) for name in EFFECTS]
    bias = Cause(find('wrong_bias'), 'x_rotate', {'difference': 40.0})
    nothing, setting = (evaluate(problem, causes) for causes in ((), (bias,)))
    rounds = Rounds(problem, effects, quiet)
    rounds.begin(nothing)
    assert {item.name for item in candidates(problem, effects)} == set(asked)
    at_first = told(rounds.screen(nothing))
    asked.clear()
    rounds.begin(setting)
    assert asked
    assert all(
        CONTROLLER in problem.touched(find(name.split(':')[0]), name.split(':')[1])
        for name in asked
    )

    alone = Rounds(problem, effects, quiet)
    alone.begin(setting)
    assert told(alone.screen(setting)) == told(rounds.screen(setting))
    asked.clear()
    rounds.begin(nothing)
    assert told(rounds.screen(nothing)) == at_first
    assert not asked
