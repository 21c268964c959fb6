# SPDX-License-Identifier: Apache-2.0
"""The command filters against a filter shipped in a drive, and against scipy."""

import math

import numpy as np
import pytest
from scipy import signal

from waferbot_copley import filters

RATE = 18000.0


def as_scipy(section):
    """Return (b, a) with scipy's sign of a."""
    b0, b1, b2, a1, a2 = section
    return np.array([b0, b1, b2]), np.array([1.0, -a1, -a2])


def run(section, samples):
    """Pass samples through the compiled section."""
    coefficients, memory = np.array(section), np.zeros(2)
    return np.array([filters.filter_sample(coefficients, memory, x) for x in samples])


def test_golden_first_generation_filter():
    """
    A first-generation drive ships this filter as 16-bit words and calls it 200 Hz.

    Decoded, y = K (b x + a y) / 32768 / 4096, it is the two-pole Butterworth at a rate of 3 kHz.
    """
    words, gain = np.array([775, 1550, 775, 32763, -12774]), 5813
    shipped = words * gain / 32768 / 4096
    assert shipped == pytest.approx([0.033565, 0.067131, 0.033565, 1.418973, -0.553245], abs=6e-7)
    assert shipped[:3].sum() / (1 - shipped[3:].sum()) == pytest.approx(0.99992, abs=6e-6)
    designed = filters.low_pass(200.0, 3000.0, 2)
    assert designed == pytest.approx(shipped, abs=gain / 32768 / 4096)  # one step of the words


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('poles', [1, 2])
@pytest.mark.parametrize('kind', ['low', 'high'])
def test_butterworth_is_scipys(kind, poles, seed):
    """Coefficients and output equal scipy's over random cutoffs."""
    print('seed', seed)
    random = np.random.default_rng(seed)
    cutoff = 10 ** random.uniform(1, math.log10(0.49 * RATE))
    design = filters.low_pass if kind == 'low' else filters.high_pass
    section = design(cutoff, RATE, poles)
    b, a = signal.butter(poles, cutoff, kind, fs=RATE)
    ours = as_scipy(section)
    assert ours[0][: poles + 1] == pytest.approx(b, rel=1e-9, abs=1e-14)
    assert ours[1][: poles + 1] == pytest.approx(a, rel=1e-9, abs=1e-12)
    assert filters.is_stable(section)

    samples = random.standard_normal(300)
    expected = signal.sosfilt(signal.butter(poles, cutoff, kind, fs=RATE, output='sos'), samples)
    assert run(section, samples) == pytest.approx(expected, rel=1e-7, abs=1e-10)


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize(
    ('design', 'scipys'), [(filters.notch, signal.iirnotch), (filters.band_pass, signal.iirpeak)]
)
def test_notch_and_band_pass_are_scipys(design, scipys, seed):
    """Coefficients, and the -3 dB width, over random centres and widths."""
    print('seed', seed)
    random = np.random.default_rng(seed)
    centre = random.uniform(200, 8000)
    width = centre / random.uniform(1.5, 40)
    b, a = as_scipy(design(centre, width, RATE))
    expected_b, expected_a = scipys(centre, centre / width, fs=RATE)
    assert b == pytest.approx(expected_b, abs=1e-12)
    assert a == pytest.approx(expected_a, abs=1e-12)

    def gain(frequency):
        return abs(signal.freqz(b, a, [frequency], fs=RATE)[1][0])

    assert gain(centre) == pytest.approx(0.0 if design is filters.notch else 1.0, abs=1e-9)
    # The edges lie where tan(pi f / rate) is split evenly in the analogue sense.
    frequencies = np.linspace(1.0, RATE / 2 - 1, 200_001)
    gains = np.abs(signal.freqz(b, a, frequencies, fs=RATE)[1])
    inside = gains < math.sqrt(0.5) if design is filters.notch else gains > math.sqrt(0.5)
    assert np.ptp(frequencies[inside]) == pytest.approx(width, abs=0.15)


def test_biquad_is_lfilter():
    """A custom section over random coefficients is scipy's lfilter."""
    random = np.random.default_rng(7)
    for _ in range(20):
        poles = random.uniform(0, 0.95) * np.exp(1j * random.uniform(0, math.pi))
        a1, a2 = 2 * poles.real, -(abs(poles) ** 2)
        section = (*random.normal(size=3), a1, a2)
        samples = random.standard_normal(200)
        expected = signal.lfilter(*as_scipy(section), samples)
        assert run(section, samples) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_stability_is_that_of_the_poles(seed):
    """The rule for the coefficients agrees with the roots themselves."""
    print('seed', seed)
    for a1, a2 in np.random.default_rng(seed).uniform(-2.5, 2.5, (200, 2)):
        stable = np.abs(np.roots([1.0, -a1, -a2])).max() < 1.0
        assert filters.is_stable((1.0, 0.0, 0.0, a1, a2)) == stable


def test_pass_through_changes_nothing():
    """The disabled section returns its input bit for bit."""
    samples = np.random.default_rng(3).standard_normal(50)
    assert (run(filters.PASS_THROUGH, samples) == samples).all()
