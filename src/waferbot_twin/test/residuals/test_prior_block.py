# SPDX-License-Identifier: Apache-2.0
"""What is known before any log counts as a measurement of each parameter."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import likelihood
from waferbot_twin.residuals.prior_block import KNOWN_FROM, PriorBlock, log_normaliser

NAMES = ('mass', 'friction', 'force_constant')


def likelihood_of(deviations):
    block = PriorBlock(SimpleNamespace(), NAMES)
    variant = replace(Variant.of(load_model('rigid')), deviations=deviations)
    return likelihood(block.residuals(variant), block.noises).log_likelihood


@pytest.mark.parametrize('deviations', [{}, {'mass': 0.5}, {'mass': -6.0, 'friction': 400.0}])
def test_its_likelihood_is_that_of_students_t_however_large_deviations_are(deviations):
    prior = multivariate_t(np.zeros(len(NAMES)), np.eye(len(NAMES)), df=KNOWN_FROM)
    found = likelihood_of(deviations) - likelihood_of({})
    place = [deviations.get(name, 0.0) for name in NAMES]
    assert found == pytest.approx(prior.logpdf(place) - prior.logpdf(np.zeros(len(NAMES))))


def test_its_normaliser_is_what_students_t_has_in_the_middle_beside_normal_parameters():
    for count in (1, 3, 26):
        middle = np.zeros(count)
        t = multivariate_t(middle, np.eye(count), df=KNOWN_FROM).logpdf(middle)
        normal = multivariate_normal(middle, np.eye(count)).logpdf(middle)
        assert log_normaliser(count) == pytest.approx(t - normal)


def test_a_few_parameters_that_are_far_off_are_less_likely_than_many():
    """Of a machine that differs a lot one more is no surprise."""
    alone = likelihood_of({'mass': 5.0}) - likelihood_of({})
    others = {'friction': 5.0, 'force_constant': 5.0}
    beside = likelihood_of({'mass': 5.0, **others}) - likelihood_of(others)
    assert alone < beside < 0.0
