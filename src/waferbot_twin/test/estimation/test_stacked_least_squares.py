# SPDX-License-Identifier: Apache-2.0
"""One value for all blocks that a cause shows in, against least squares done at once."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.estimation.stacked_least_squares import by_channel, fit_jointly, side_by_side
from waferbot_twin.noise_model.prediction_error import Noise

SEED = 20261121


class TwoBlocks:
    """Stands for a problem: the noises of two blocks."""

    def noises(self, block):
        return [Noise(1e-6, 0)] * (2 if block == 'plant' else 1)


def test_a_value_is_found_from_all_blocks_weighed_by_their_noise():
    random = np.random.default_rng(SEED)
    deviations = {'plant': (2.0, 0.5), 'windings': (0.1,)}
    truth = np.array([0.7, -0.2])
    signature = {
        'plant': random.normal(size=(3000, 2)),
        'windings': np.column_stack([random.normal(size=1500), np.zeros(1500)]),
    }
    residuals = {}
    for block, matrix in signature.items():
        parts = np.split(matrix, len(deviations[block]))
        residuals[block] = [
            random.normal(scale=deviation, size=1500) - part @ truth
            for part, deviation in zip(parts, deviations[block], strict=True)
        ]
    found = fit_jointly(TwoBlocks(), residuals, signature)
    rows, right = [], []
    for block, matrix in signature.items():
        for part, left, deviation in zip(
            by_channel(matrix, residuals[block]), residuals[block], deviations[block], strict=True
        ):
            rows.append(part / deviation)
            right.append(-left / deviation)
    expected, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)
    assert found.value == pytest.approx(expected, abs=1e-3)
    assert found.value == pytest.approx(truth, abs=0.02)
    # The first is known from the quiet windings, the second from the plant alone.
    assert found.covariance[0, 0] == pytest.approx(0.1**2 / 1500, rel=0.1)


def test_causes_side_by_side_have_zeros_where_they_do_not_show():
    one, other = np.ones((4, 1)), 2.0 * np.ones((3, 2))
    found = side_by_side([{'plant': one}, {'windings': other}], [1, 2])
    assert found['plant'].tolist() == [[1.0, 0.0, 0.0]] * 4
    assert found['windings'].tolist() == [[0.0, 2.0, 2.0]] * 3
