# SPDX-License-Identifier: Apache-2.0
"""Which candidates can stand for a cause, beside what is known."""

from __future__ import annotations

import numpy as np

from waferbot_twin.diagnosis.proposals.screening import Beside, Change, alike
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import Noise, likelihood

PLANT, CONTROLLER = 'plant', 'controller'
SEED = 20261126


def test_what_gains_most_of_it_and_only_without_it_may_be_in_its_place():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    own, known, other, lacking, poor = random.standard_normal((5, 2000))
    whole = 2.0 * own + 4.0 * known
    # A cause need not explain well what it explains: here it leaves `poor` over, for which it is taken.
    left = {
        PLANT: [random.standard_normal(2000) + whole + 3.0 * lacking + 1.5 * poor],
        CONTROLLER: [random.standard_normal(500)],
    }
    fits = {block: likelihood(channels, [Noise(1e-9, 0)]) for block, channels in left.items()}
    base = Hypothesis((), left, fits)

    def mixed(share):
        return np.sqrt(share) * own + np.sqrt(1.0 - share) * other

    rivals = {
        'most of it': {PLANT: 3.0 * mixed(0.6)[:, None]},
        'less than half': {PLANT: mixed(0.4)[:, None]},
        'by two parameters': {PLANT: np.column_stack([mixed(0.4), other])},
        'with what is known': {PLANT: (own + 5.0 * known)[:, None]},
        'known alone': {PLANT: known[:, None]},
        'another that lacks': {PLANT: lacking[:, None]},
        'better than it': {PLANT: (2.0 * own + 1.5 * poor)[:, None]},
        'elsewhere': {CONTROLLER: random.standard_normal((500, 1))},
        'nothing': {PLANT: np.zeros((2000, 1))},
    }
    changes = [(name, Change(signature)) for name, signature in rivals.items()]
    causes = [{PLANT: one[:, None]} for one in (whole, 3.0 * lacking, 0.0 * own)]
    assert alike(base, causes, changes, Beside({PLANT: known[:, None]}, {})) == [
        ['most of it', 'by two parameters', 'with what is known', 'better than it'],
        ['another that lacks'],
        [],
    ]
