# SPDX-License-Identifier: Apache-2.0
"""How fast the observer of a log is: as fast as a model predicts its readings best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals import observer_bandwidth
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.observer_bandwidth import with_observers
from waferbot_twin.residuals.plant_block import OBSERVER_HZ, PlantBlock

X_ROTATE = ENCODERS.index('x_rotate')


@pytest.fixture(scope='module')
def noisy():
    """A log of the nominal machine with noise of ten counts in its readings, and that machine."""
    seed = 5
    print(f'seed {seed}')
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    twin = Twin(built(nominal, timing), nominal.pmac, nominal.copley, timing, nominal.name)
    twin.commanded = commanded_positions(
        load_experiment('random_x_rotate'), twin.servo_parameters, timing.servo_hz
    )
    record = record_of_signals('log', twin.advance(timing.ticks(0.8)))
    noise = np.random.default_rng(seed).normal(scale=10.0, size=record.reading.shape)
    return nominal, replace(record, reading=np.round(record.reading + noise))


def spread(record, nominal, frequency_hz):
    """Return the RMS of what is predicted wrong with an observer, without the first 0.2 s."""
    block = PlantBlock(record, nominal, frequency_hz)
    place = block.channels.index('x_rotate')
    late = block.times_s('x_rotate') > 0.2
    return np.sqrt(np.mean(block.innovations(nominal)[place][late] ** 2))


def test_readings_are_predicted_better_than_an_octave_away(noisy):
    nominal, record = noisy
    (found,) = with_observers([record], nominal, nominal)
    best_hz = found.observer_hz[X_ROTATE]
    assert best_hz < OBSERVER_HZ
    best = spread(record, nominal, best_hz)
    assert best < spread(record, nominal, 2.0 * best_hz)
    assert best < 0.95 * spread(record, nominal, OBSERVER_HZ)


def test_a_model_that_lacks_something_is_followed_faster(noisy):
    nominal, record = noisy
    effect = find('coulomb_friction')
    wrong = effect.apply(nominal, 'x_rotate', effect.typical(nominal, 'x_rotate'))
    (right,), (lacking,) = (with_observers([record], nominal, one) for one in (nominal, wrong))
    assert right.observer_hz[X_ROTATE] < lacking.observer_hz[X_ROTATE] <= OBSERVER_HZ
    (again,) = with_observers([right], nominal, wrong)
    assert again.observer_hz == right.observer_hz  # no faster than before


def test_the_plant_follows_as_the_record_says_and_so_do_its_noise_free_logs(noisy):
    nominal, record = noisy
    (found,) = with_observers([record], nominal, nominal)
    assert PlantBlock(found, nominal).observer_hz == min(found.observer_hz)
    assert PlantBlock(found, nominal, 40.0).observer_hz == 40.0
    assert simulate(nominal, found).observer_hz == found.observer_hz
    assert found.part(0.2, 0.6).observer_hz == found.observer_hz


def test_a_log_in_which_the_model_does_not_run_stays(noisy, monkeypatch):
    nominal, record = noisy

    def innovations(block, variant):
        raise UserError('it blew up')

    monkeypatch.setattr(observer_bandwidth.PlantBlock, 'innovations', innovations)
    (found,) = with_observers([record], nominal, nominal)
    assert found is record


@pytest.mark.filterwarnings('error')
def test_a_log_with_gaps_in_quick_succession_is_followed_as_usual(noisy):
    """No stretch between two gaps is as long as the slowest observer takes to settle."""
    nominal, record = noisy
    reading = record.reading.copy()
    rows = np.arange(len(reading))
    reading[rows % 500 < 50] = np.nan
    (found,) = with_observers([replace(record, reading=reading)], nominal, nominal)
    assert found.observer_hz == (OBSERVER_HZ,) * len(ENCODERS)
