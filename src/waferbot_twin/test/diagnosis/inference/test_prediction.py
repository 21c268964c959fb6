# SPDX-License-Identifier: Apache-2.0
"""What logs predict of other logs, with a cause and without it."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference.prediction import Prediction
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import with_noise

SEED = 20261126

FRICTION = Cause(find('coulomb_friction'), 'y_linear', {'friction': 60.0})
PULLED = Cause(find('constant_force'), 'y_linear', {'force': 60.0})
DAMPING = Cause(find('viscous_friction'), 'y_linear', {'damping': 300.0})


def log(nominal, motion, seed, *hidden):
    """Return a noisy log of half a second."""
    timing = Timing()
    machine = with_noise(
        apply_all(nominal, hidden), nominal, 1.0, np.random.default_rng([SEED, seed])
    )
    parameters = servo_parameters(machine.pmac, machine.name)
    commanded = commanded_positions(load_experiment(motion), parameters, timing.servo_hz)
    signals = run_commanded(machine, timing, commanded, timing.ticks(0.5))
    return record_of_signals(motion, signals)


def prediction(nominal, estimation, validation, causes):
    problems = Problem(nominal, [estimation, validation]), Problem(nominal, [estimation])
    fits = ((one, fit_causes(one, causes)) for one in problems)
    return Prediction(*fits, Settings())


@pytest.mark.slow
def test_a_cause_of_both_logs_predicts_and_one_of_the_first_does_not():
    """Somebody leaned against the machine while the log for estimation was taken."""
    print(f'seed {SEED}')
    nominal = Variant.of(load_model('rigid'))
    first = log(nominal, 'step', 1, FRICTION, PULLED)
    second = log(nominal, 'random_y_linear', 2, FRICTION)
    found = prediction(nominal, first, second, (FRICTION, PULLED))
    assert found.log_ratio(FRICTION.name) > 10.0
    assert found.log_ratio(PULLED.name) < -10.0


@pytest.mark.slow
def test_a_true_cause_of_which_the_first_log_tells_the_value_badly_predicts():
    """At rest nothing is known of damping: the value of such a log alone is any."""
    print(f'seed {SEED}')
    nominal = Variant.of(load_model('rigid'))
    first = log(nominal, 'step_x_rotate', 3, DAMPING)
    second = log(nominal, 'random_y_linear', 4, DAMPING)
    found = prediction(nominal, first, second, (DAMPING,))
    assert found.log_ratio(DAMPING.name) > 10.0
