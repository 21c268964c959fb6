# SPDX-License-Identifier: Apache-2.0
"""
A diagnosis from beginning to end in memory: an effect in each block, two of them at once, and none.

Logs of a second, of noise with a fixed seed, as the bench makes them; the whole library is tried.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / 'bench'))

from diagnosis_matrix import trial
from diagnosis_matrix.motions import draw_experiment

from waferbot_twin.diagnosis.diagnose import diagnose
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.residuals.problem import Cause, apply_all

pytestmark = [pytest.mark.slow, pytest.mark.long(180), pytest.mark.timeout(3600)]

SEED = 20261214


def diagnosed(*hidden, settings=None):
    """Return the diagnosis of two logs of a machine with hidden causes."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    nominal = trial.nominal('rigid')
    causes = [Cause(find(name), axis, values) for name, axis, values in hidden]
    motions = [(draw_experiment(nominal, random), SEED + place) for place in range(2)]
    first, second = trial.logs(apply_all(nominal, causes), 'rigid', 1.0, motions)
    return diagnose(nominal, [first], [second], lambda *_: None, settings=settings)


COULOMB = ('coulomb_friction', 'x_rotate', {'friction': 1.0})
DERIVATIVE = ('wrong_derivative_gain', 'y_linear', {'ratio': 0.98})
DEAD_TIME = ('dead_time', 'x_rotate', {'voltage': 0.5})


@pytest.mark.parametrize(
    'hidden',
    [(COULOMB, DERIVATIVE), (DEAD_TIME,)],
    ids=['plant and controller at once', 'amplifier'],
)
def test_effects_of_each_block_are_named_with_their_sizes(hidden):
    result = diagnosed(*hidden)
    print([found.cause.name for found in result.causes], result.unexplained)
    for name, axis, values in hidden:
        (found,) = (one for one in result.causes if one.cause.name == f'{name}:{axis}')
        assert found.probability > 0.5
        assert found.cause in [one.cause for one in found.credible_set]
        neutral = 1.0 if 'ratio' in values else 0.0
        for key, value in values.items():
            assert found.cause.values[key] - neutral == pytest.approx(value - neutral, rel=0.1)
        assert 0.0 < found.share <= 1.0
    assert result.verdict in ('explained', 'partly')
    assert result.estimation == ['log_0']
    assert result.validation == ['log_1']


def test_where_nothing_is_hidden_nothing_is_named():
    result = diagnosed()
    assert [found.cause.name for found in result.causes] == []
    assert result.unexplained == []
    assert result.verdict == 'consistent'
    assert result.withdrawn == []


def test_what_is_not_sure_enough_for_a_name_is_not_in_the_extended_model():
    name, axis, _ = COULOMB
    sure = Settings(named_from=float(np.nextafter(1.0, 0.0)))
    result = diagnosed((name, axis, {'friction': 0.07}), settings=sure)
    print([(found.cause.name, found.inclusion) for found in result.possible])
    assert result.causes == []
    (found,) = result.possible
    assert found.cause.name == f'{name}:{axis}'
    assert 0.5 <= found.inclusion < 1.0
    assert (
        'frictions' in found.cause.effect.apply(result.nominal, axis, found.cause.values).machine
    )
    assert 'frictions' not in result.extended.machine
    assert all(abs(gain.improvement_percent) < 5.0 for gain in result.gains)
