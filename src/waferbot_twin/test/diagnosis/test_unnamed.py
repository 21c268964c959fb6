# SPDX-License-Identifier: Apache-2.0
"""The gain is told for the causes alone, and with what has no name: forces, and possible causes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.diagnosis.inference.discrepancy import tables
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.report import gain_with_unnamed
from waferbot_twin.diagnosis.unnamed import gains_with_unnamed
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.validation.gain import gains


@pytest.fixture(scope='module')
def diagnosis():
    """Return a diagnosis that named nothing: a viscous friction is left as a force over speed."""
    nominal = Variant.of(load_model('rigid'))
    rubs = Cause(find('viscous_friction'), 'x_rotate', {'damping': 3.0})
    timing = Timing()
    records = []
    for name in ('estimation', 'validation'):
        model = apply_all(nominal, [rubs]).model()
        twin = Twin.of(model, timing, load_experiment('wafer_exchange'))
        records.append(record_of_signals(name, twin.advance(timing.ticks(0.8))))
    over_speed = tables(nominal, records)[0]
    force = Cause(over_speed, 'x_rotate', over_speed.typical(nominal, 'x_rotate'))
    problem = Problem(nominal, records)
    return SimpleNamespace(
        nominal=nominal,
        problem=problem,
        estimation=['estimation'],
        settings=Settings(),
        after=evaluate(problem, (force,)),
        possible=[],
        gains=gains(nominal, nominal, records[1:]),
    )


def test_the_force_makes_up_for_what_no_cause_explains(diagnosis):
    found = {item.axis: item for item in gains_with_unnamed(diagnosis)}
    assert found['x_rotate'].log == 'validation'
    assert found['x_rotate'].improvement_percent > 90.0
    line = next(one for one in gain_with_unnamed(diagnosis) if one.startswith('X-Rotate'))
    assert line.startswith('X-Rotate: 0.0 % with the extended model, 9')


def test_so_does_a_cause_that_is_possible(diagnosis):
    friction = Cause(find('viscous_friction'), 'x_rotate', {'damping': 1.0})
    nothing = evaluate(diagnosis.problem, ())
    possible = SimpleNamespace(
        **{**vars(diagnosis), 'after': nothing, 'possible': [SimpleNamespace(cause=friction)]}
    )
    found = {item.axis: item for item in gains_with_unnamed(possible)}
    assert found['x_rotate'].improvement_percent > 95.0


def test_without_such_a_force_nothing_is_told(diagnosis):
    named = SimpleNamespace(after=SimpleNamespace(causes=()), possible=[], gains=[])
    assert gains_with_unnamed(named) == []
    assert gain_with_unnamed(named) == []
