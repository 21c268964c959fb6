# SPDX-License-Identifier: Apache-2.0
"""What columns span is what a singular value decomposition finds, in any units."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.noise_model.gram import spanning

SEED = 20261125


@pytest.mark.parametrize('complex_columns', [False, True])
def test_the_basis_spans_what_the_columns_span(complex_columns):
    """Units of 1e-6 to 1e6, one column the sum of two others, one of zeros."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    columns = random.normal(size=(400, 7))
    if complex_columns:  # as the lines of real signals: coefficients stay real
        columns = columns + 1j * random.normal(size=columns.shape)
    columns[:, 5] = columns[:, 0] - 2.0 * columns[:, 1]
    columns[:, 6] = 0.0
    columns *= np.geomspace(1e-6, 1e6, 7)
    basis = columns @ spanning((columns.conj().T @ columns).real)
    assert basis.shape == (400, 5)
    assert (basis.conj().T @ basis).real == pytest.approx(np.eye(5), abs=1e-9)
    rows = np.vstack([columns.real, columns.imag])
    unit = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    left, size, _ = np.linalg.svd(unit, full_matrices=False)
    true = left[:, size > 1e-6]
    found = np.vstack([basis.real, basis.imag])
    assert found @ found.T == pytest.approx(true @ true.T, abs=1e-8)


def test_no_columns_span_nothing():
    assert spanning(np.zeros((0, 0))).shape == (0, 0)
    assert spanning(np.zeros((3, 3))).shape == (3, 0)
