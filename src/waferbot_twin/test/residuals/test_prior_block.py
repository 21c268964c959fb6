# SPDX-License-Identifier: Apache-2.0
"""What is known before any log counts as a measurement of each parameter."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import likelihood
from waferbot_twin.residuals.prior_block import PriorBlock


@pytest.mark.parametrize('deviations', [{}, {'mass': 0.5}, {'mass': -6.0, 'friction': 4.0}])
def test_its_likelihood_is_that_of_normal_deviations_however_large(deviations):
    names = ('mass', 'friction', 'force_constant')
    block = PriorBlock(SimpleNamespace(), names)
    variant = replace(Variant.of(load_model('rigid')), deviations=deviations)
    (residual,) = block.residuals(variant)
    assert residual == pytest.approx([deviations.get(name, 0.0) for name in names])
    found, nothing = (
        likelihood([one], block.noises).log_likelihood for one in (residual, np.zeros(3))
    )
    expected = float(np.sum(norm.logpdf(residual) - norm.logpdf(0.0)))
    assert found - nothing == pytest.approx(expected)
