# SPDX-License-Identifier: Apache-2.0
"""Machines that differ in memory: all that a search will want are known before it begins."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_twin.diagnosis.compile_ahead import compile_ahead, machines
from waferbot_twin.diagnosis.from_recording import record_of_signals
from waferbot_twin.diagnosis.problem import Problem, apply_all
from waferbot_twin.diagnosis.screening import candidates
from waferbot_twin.effects import library
from waferbot_twin.effects.host import built, host
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model


@pytest.fixture(scope='module')
def problem():
    nominal, timing = host(Variant.of(load_model('rigid'))), Timing()
    twin = Twin(built(nominal, timing), nominal.pmac, nominal.copley, timing, 'rigid')
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.1)))])


def layout(problem, causes):
    return built(apply_all(problem.nominal, causes), problem.records[0].timing).parameter_dtype


@pytest.mark.slow
def test_every_candidate_makes_a_machine_that_was_known_before(problem):
    effects = list(library().values())
    known = [layout(problem, causes) for causes in machines(problem, effects)]
    assert len(known) == len(set(known)) == 3
    assert known[0] == layout(problem, ())
    for cause in candidates(problem, effects):
        typical = cause.effect.typical(problem.nominal, cause.axis)
        for values in (cause.values, typical):
            assert layout(problem, (cause.with_values(values),)) in known, cause.name


def test_with_one_worker_nothing_is_compiled_before_it_is_wanted(problem, monkeypatch):
    def never(variant, block):
        raise AssertionError

    monkeypatch.setattr(problem, 'residuals', never)
    compile_ahead(problem, list(library().values()), 1)
