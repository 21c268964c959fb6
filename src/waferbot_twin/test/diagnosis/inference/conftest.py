# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of the inference."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.nuisance import nuisance, prior_groups
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Problem, apply_all


@pytest.fixture(scope='session')
def pool_of():
    """Return a function that makes a pool of effects for the log of a machine in an experiment."""

    def pool_of(experiment, names, progress=lambda *_: None, hidden=(), with_dense=False):
        """
        Return a pool of effects for the log of the nominal model in an experiment.

        Or that of one with something hidden; `with_dense` the dense effects are candidates as well.
        """
        nominal, timing = Variant.of(load_model('rigid')), Timing()
        motion = load_experiment(experiment)
        parameters = servo_parameters(nominal.pmac, nominal.name)
        commanded = commanded_positions(motion, parameters, timing.servo_hz)
        variant = apply_all(nominal, hidden)
        signals = run_commanded(variant, timing, commanded, timing.ticks(0.3))
        records, settings = [record_of_signals('log', signals)], Settings()
        problem, effects = Problem(nominal, records), [find(name) for name in names]
        if with_dense:
            dense, numbers = nuisance(nominal, records, settings)
            problem = problem.with_prior(
                prior_groups(numbers), settings.prior_scales, settings.unrated_scales
            )
            effects += dense
        return CandidatePool(problem, effects, settings, progress)

    return pool_of
