# SPDX-License-Identifier: Apache-2.0
"""The band in which something unexplained lies, against signals of known frequency."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.bands import band_of, band_text, middle_band
from waferbot_twin.diagnosis.inference.unexplained import Unexplained
from waferbot_twin.noise_model.prediction_error import Noise, in_deviations, likelihood

RATE_HZ, SECONDS = 1000.0, 20.0
TIME_S = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)


def diagnosis_with(residual, noise=None):
    """Return a diagnosis with one channel of the plant: its residual, and the noise in it, if any."""
    known = likelihood(
        [residual if noise is None else noise], [Noise(0.0, 0 if noise is None else 1)]
    )
    fit = replace(known, whitened=in_deviations(known.colours, [residual]))
    channel = SimpleNamespace(
        axis='y_linear', name='y_linear', log=SimpleNamespace(times_s=lambda name: TIME_S)
    )
    return SimpleNamespace(
        problem=SimpleNamespace(channels=lambda block: [channel]),
        after=SimpleNamespace(residuals={'plant': [residual]}, fits={'plant': fit}, causes=()),
    )


def test_half_of_the_power_below_and_half_above():
    assert middle_band(np.arange(1.0, 101.0), np.ones(100)) == (10.0, 90.0)
    assert middle_band(np.arange(1.0, 101.0), np.zeros(100)) is None


def test_in_an_exact_block_it_is_where_the_residual_is():
    wave = np.sin(2.0 * np.pi * 7.0 * TIME_S)
    band = band_of(diagnosis_with(wave), Unexplained('y_linear', 'plant', 1.0, 'its input'))
    assert band == pytest.approx((7.0, 7.0))
    assert band_text(band) == '7 Hz'


def test_above_noise_it_is_where_the_motion_is():
    """White noise over 500 Hz, and a band at 20 to 40 Hz with ten times its density."""
    random = np.random.default_rng(5)
    noise = random.normal(size=len(TIME_S))
    lines = np.fft.rfft(random.normal(size=len(TIME_S)))
    frequency_hz = np.fft.rfftfreq(len(TIME_S), 1.0 / RATE_HZ)
    lines[(frequency_hz < 20.0) | (frequency_hz > 40.0)] = 0.0
    residual = noise + np.sqrt(10.0) * np.fft.irfft(lines, len(TIME_S))
    band = band_of(
        diagnosis_with(residual, noise), Unexplained('y_linear', 'plant', 0.3, 'the motion')
    )
    assert 14.0 < band[0] < 26.0
    assert 34.0 < band[1] < 50.0


def test_noise_alone_has_no_band():
    noise = np.random.default_rng(6).normal(size=len(TIME_S))
    band = band_of(
        diagnosis_with(noise, noise), Unexplained('y_linear', 'plant', 0.3, 'the motion')
    )
    assert band is None
    assert band_text(band) == 'none stands out'
