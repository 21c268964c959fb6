# SPDX-License-Identifier: Apache-2.0
"""What the logs cannot tell from a cause, and how sure that leaves it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.alike import (
    UNRIVALLED,
    alike,
    confidence_in,
    parameters_told,
    weighed_by_evidence,
)
from waferbot_twin.diagnosis.search_state import Rival, Search
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.synthesis import with_noise

SEED = 20261203
COULOMB = Cause(find('coulomb_friction'), 'y_linear', {'friction': 3.0})


def along_the_way(share=0.4):
    """Return a friction that changes by a share of it every 0.2 m."""
    values = {'mean': 3.0, 'cosine': share, 'sine': 0.1, 'period': 0.2}
    return Cause(find('position_dependent_friction'), 'y_linear', values, held=('period',))


def log_of(motion):
    """Return the log of a machine with dry friction."""
    nominal = Variant.of(load_model('rigid'))
    timing = Timing()
    machine = COULOMB.effect.apply(nominal, COULOMB.axis, COULOMB.values)
    noisy = with_noise(machine, nominal, 1.0, np.random.default_rng(SEED))
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(motion), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.8)))])


@pytest.fixture(scope='module')
def short():
    return log_of('step')


@pytest.mark.slow
def test_what_goes_by_a_part_of_its_period_is_little_more_than_one_number(short):
    print(f'seed {SEED}')
    assert parameters_told(short, [COULOMB], 0) == 1.0
    assert parameters_told(short, [along_the_way()], 0) == pytest.approx(1.0, abs=0.4)
    far = parameters_told(log_of('full_stroke_y_linear'), [along_the_way()], 0)
    assert far == pytest.approx(1.6, abs=0.2)  # 9 and 28 times, of 8000 samples


@pytest.mark.slow
def test_a_rival_with_parameters_that_the_logs_do_not_tell_is_as_likely(short):
    """Schwarz' criterion would have it 2 ln N behind, and the cause beyond doubt."""
    print(f'seed {SEED}')
    found = evaluate(short, (COULOMB,))
    behind = 2.0 * math.log(2.0 * found.samples)
    rivals = [
        Rival(along_the_way(), behind - 0.5, -0.5),
        Rival(Cause(find('wafer'), 'y_linear', {'mass': 0.1}), 300.0, 300.0),
    ]
    search = Search(found, found, found, found, rivals={COULOMB.name: rivals})
    first, far = weighed_by_evidence(short, short, search, 0)
    a_parameter = math.log(2.0 * found.samples)
    assert first.by_evidence == pytest.approx(-0.5 + (first.told - 1.0) * a_parameter)
    assert first.behind < 0.3 * behind
    assert (far.told, far.behind) == (1, 300.0)  # too far behind to be asked
    assert confidence_in([far], 1) == 1.0
    assert confidence_in([first, far], 1) == pytest.approx(
        1.0 / (1.0 + math.exp(-0.5 * first.behind))
    )
    (named,) = alike(short, search, COULOMB, [first, far])
    assert named.cause.name == 'position_dependent_friction:y_linear'
    assert named.correlation > 0.99
    simple = replace(
        first, rival=replace(first.rival, behind=-1.0, less_likely=20.0), by_evidence=18.0
    )
    assert (
        confidence_in([simple], 1) < 0.5
    )  # its parameters are paid for in full, if that is less sure
    assert len(list(alike(short, search, COULOMB, [simple]))) == 1
    elsewhere = Rival(Cause(find('coulomb_friction'), 'y_rotate', {'friction': 0.1}), 1.0, 1.0)
    search.rivals = {COULOMB.name: [elsewhere]}
    weighed = weighed_by_evidence(short, short, search, 0)
    assert list(alike(short, search, COULOMB, weighed)) == []  # as likely, but something else


def test_a_cause_without_rivals_is_sure_only_if_it_was_found_alone():
    assert confidence_in([], 1) == 1.0
    assert confidence_in([], 2) == UNRIVALLED
