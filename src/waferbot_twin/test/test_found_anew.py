# SPDX-License-Identifier: Apache-2.0
"""What the logs that judge contradict is sought in them from the beginning."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.diagnose import diagnose
from waferbot_twin.effects import find, library
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.synthesis import with_noise

ONE_WAY = """
name: one_way
duration_s: 1.0
motion:
  x_rotate: {kind: random, start_s: 0.05, hold_s: 0.029, amplitude_counts: 409, seed: 188998935}
  y_rotate: {kind: linear, start_s: 0.05, acceleration_time_s: 0.1, s_curve_time_s: 0.02,
             speed_counts_per_s: 4910, distance_counts: 1100}
"""

BOTH_WAYS = """
name: both_ways
duration_s: 1.0
motion:
  x_rotate: {kind: linear, start_s: 0.05, acceleration_time_s: 0.1, s_curve_time_s: 0.02,
             speed_counts_per_s: 75000, distance_counts: 45000}
  y_rotate: {kind: random, start_s: 0.05, hold_s: 0.059, amplitude_counts: 344, seed: 1209296781}
"""

FRICTIONS = (
    'coulomb_friction',
    'stribeck_friction',
    'position_dependent_friction',
    'direction_dependent_friction',
)


@pytest.mark.slow
def test_a_friction_of_both_directions_is_found_where_the_first_log_shows_one_of_them():
    """One way, what a direction-dependent friction is beside Coulomb's is hardly seen."""
    seed = 1
    print(f'seed {seed}')
    nominal = Variant.of(load_model('rigid'))
    effect, axis = find('direction_dependent_friction'), 'y_rotate'
    hidden = {'forward': 0.2, 'backward': 0.13}
    timing = Timing()

    def log(name, experiment, number):
        random = np.random.default_rng([seed, number])
        noisy = with_noise(effect.apply(nominal, axis, hidden), nominal, 1.0, random)
        twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
        twin.commanded = commanded_positions(
            load_experiment(experiment), twin.servo_parameters, timing.servo_hz
        )
        return record_of_signals(name, twin.advance(timing.ticks(1.0)))

    one_way, both_ways = log('one_way', ONE_WAY, 0), log('both_ways', BOTH_WAYS, 1)
    without = [name for name in library() if name not in FRICTIONS]
    result = diagnose(nominal, [one_way], [both_ways], lambda *_: None, 1, without)
    (found,) = result.causes
    assert found.cause.name == 'direction_dependent_friction:y_rotate'
    assert any('found anew' in note for note in result.notes)
    assert result.verdict == 'explained'
    assert result.judging == ['one_way']
    assert found.cause.values == pytest.approx(hidden, rel=0.1)
