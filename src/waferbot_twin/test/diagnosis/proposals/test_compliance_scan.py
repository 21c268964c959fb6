# SPDX-License-Identifier: Apache-2.0
"""A ring that is damped too quickly for a line in the spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.search import infer
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals import compliance_scan
from waferbot_twin.diagnosis.proposals.compliance_scan import screen_damped
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.diagnosis.proposals.spectral_lines import lines
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.synthesis import with_noise

HIDDEN, AXIS = 'counterweight_bearing_compliance', 'y_linear'
SHARE = 0.028
"""Of its typical value."""

RIVALS = (HIDDEN, 'shaft_torsion_compliance', 'gearbox_compliance', 'coulomb_friction')
SEEDS = 20261123, 20261124

pytestmark = pytest.mark.slow


def quiet(*_):
    """Show no progress."""


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def problem_of(nominal, variant, experiment, seed):
    print(f'seed {seed}')
    timing = Timing()
    noisy = with_noise(variant, nominal, 0.5, np.random.default_rng(seed))
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(experiment), twin.servo_parameters, timing.servo_hz
    )
    log = record_of_signals(experiment, twin.advance(timing.ticks(1.0)))
    return Problem(nominal, [log])


@pytest.fixture(scope='module')
def logs(nominal):
    """Two logs of a machine that rings; the same two of one that does not."""
    effect = find(HIDDEN)
    (parameter,) = effect.parameters(nominal, AXIS)
    ringing = effect.apply(nominal, AXIS, {'compliance': SHARE * parameter.typical})
    return tuple(
        tuple(
            problem_of(nominal, variant, experiment, seed)
            for experiment, seed in zip(('random_y_linear', 'step_y_linear'), SEEDS, strict=True)
        )
        for variant in (ringing, nominal)
    )


def test_a_ring_that_makes_no_line_is_found_by_trying(nominal, logs):
    effects = [find(name) for name in RIVALS]
    (parameter,) = find(HIDDEN).parameters(nominal, AXIS)
    (problem, _), _ = logs
    base = evaluate(problem)
    assert not [line for line in lines(problem, base) if line.channel == AXIS]
    pool = CandidatePool(problem, effects, Settings(), quiet)
    pool.begin(base)
    assert all(item.score < 0.0 for item in pool.screen(base) if item.cause.effect.name == HIDDEN)
    screened = screen_damped(problem, base, candidates(problem, effects))
    best = max(screened, key=lambda item: item.score)
    assert best.cause.name == f'{HIDDEN}:{AXIS}'
    assert best.cause.values['compliance'] == pytest.approx(SHARE * parameter.typical, rel=0.03)


def test_noise_that_makes_stiff_parts_ring_promises_nothing(logs):
    effects = [find(name) for name in RIVALS]
    _, quiet_logs = logs
    for problem in quiet_logs:
        base = evaluate(problem)
        assert not screen_damped(problem, base, candidates(problem, effects))


def test_what_no_log_could_hold_is_not_tried(nominal, logs):
    """A soft cable would leave more over than there is; near the hidden value all are tried."""
    problem, _ = logs[0]
    base = evaluate(problem)
    quick = compliance_scan.noise_free(problem, base).in_quick_steps()

    def tried(name, axis):
        (parameter,) = find(name).parameters(nominal, axis)
        typical = Cause(find(name), axis, {parameter.name: parameter.typical})
        values = compliance_scan.times_its_value(problem, typical, compliance_scan.DAMPED)
        found = compliance_scan._within_reach(base, quick, values)
        every = [compliance_scan.promise(base, quick, cause) for cause, _ in found]
        np.testing.assert_array_equal([gain for _, gain in found], every)
        return [cause.values[parameter.name] / parameter.typical for cause, _ in found]

    assert (
        len(tried('cable_compliance', 'y_linear'))
        <= len(compliance_scan.DAMPED) // compliance_scan.APART + 2
    )
    about = [value for value in compliance_scan.DAMPED if 0.5 * SHARE < value < 2.0 * SHARE]
    assert len(about) >= 5
    near = [value for value in tried(HIDDEN, AXIS) if 0.5 * SHARE < value < 2.0 * SHARE]
    np.testing.assert_allclose(near, about)


def test_values_are_tried_in_the_log_that_shows_most_of_them_for_its_length(nominal, logs):
    """Not in one in which the axis stands."""
    (parameter,) = find(HIDDEN).parameters(nominal, AXIS)
    cause = Cause(find(HIDDEN), AXIS, {'compliance': SHARE * parameter.typical})
    (moving,) = logs[0][1].records
    (standing,) = problem_of(nominal, nominal, 'random_y_rotate', SEEDS[0]).records
    both = Problem(nominal, [standing, moving])
    most = compliance_scan._shown_most_in(both, evaluate(both), cause)
    assert most is moving
    assert [part.record for part in both.of_log(most).plants] == [moving]


def test_where_nothing_else_is_found_it_is_tried(nominal, logs):
    effects = [find(name) for name in RIVALS]
    (parameter,) = find(HIDDEN).parameters(nominal, AXIS)
    ringing = Problem(nominal, [record for log in logs[0] for record in log.records])
    causes = infer(CandidatePool(ringing, effects, Settings(), quiet)).found.causes
    (found,) = (cause for cause in causes if cause.axis == AXIS)
    assert found.effect.name == HIDDEN
    assert found.values['compliance'] == pytest.approx(SHARE * parameter.typical, rel=0.02)


def test_in_noise_alone_nothing_is_found(logs):
    _, (nothing, _) = logs
    effects = [find(name) for name in RIVALS]
    assert not infer(CandidatePool(nothing, effects, Settings(), quiet)).found.causes
