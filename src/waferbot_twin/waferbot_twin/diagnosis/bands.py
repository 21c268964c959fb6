# SPDX-License-Identifier: Apache-2.0
"""
In which band of frequencies something unexplained lies.

The band holds the middle `HELD` of its power: a tenth lies below it, and a tenth above. What is
unexplained, of the residual r of the extended model, depends on what it goes with:

- a force over speed or position is in the extended model: what it changes in r;
- a block that follows from its inputs to the last bit has no noise: r itself;
- what goes with the commanded motion: the power of r above that of the noise,

      max(W(f) - 1, 0) s^2 / |A(f)|^2,                                                            (1)

  with W the averaged periodogram of the white residual, 1 where there is nothing but noise, and A and s
  the prediction-error filter of the noise and its deviation (`noise_model`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.discrepancy import WORDS, goes_with, is_discrepancy
from waferbot_twin.diagnosis.inference.unexplained import Unexplained
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.noise_model.prediction_error import Colour
from waferbot_twin.noise_model.residual_spectrum import BAND, FEWEST, spectrum
from waferbot_twin.plain_values import significant
from waferbot_twin.residuals.record import Array

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import Diagnosis

HELD = 0.8
"""Share of the power that lies in the band."""

CLEARLY = 5.0
"""Standard deviations above the level of noise from which on it is no noise."""

Band = tuple[float, float]
"""Lowest and highest frequency, Hz."""


def band_of(diagnosis: Diagnosis, item: Unexplained) -> Band | None:
    """Return the band of something unexplained; None where no frequency stands out."""
    problem, after = diagnosis.problem, diagnosis.after
    residuals = after.residuals[item.block]
    forces = item.with_what in WORDS.values()
    if forces:
        others = tuple(
            cause
            for cause in after.causes
            if not (
                is_discrepancy(cause)
                and cause.axis == item.axis
                and goes_with(cause) == item.with_what
            )
        )
        try:
            without = evaluate(problem, others).residuals[item.block]
        except UserError:
            return None
        residuals = [one - other for one, other in zip(without, residuals, strict=True)]
    frequencies, powers = [], []
    for place, channel in enumerate(problem.channels(item.block)):
        if channel.axis != item.axis:
            continue
        rate_hz = 1.0 / float(np.median(np.diff(channel.log.times_s(channel.name))))
        fit = after.fits[item.block]
        if forces or not fit.colours[place].error.order:
            power = np.abs(np.fft.rfft(residuals[place] - np.mean(residuals[place]))) ** 2
            count = len(residuals[place])
        else:
            count = len(fit.whitened[place])
            power = count * _above_noise(fit.whitened[place], fit.colours[place])
        frequencies.append(np.fft.rfftfreq(count, 1.0 / rate_hz)[1:])
        powers.append(power[1:])
    if not powers:
        return None
    return middle_band(np.concatenate(frequencies), np.concatenate(powers))


def _above_noise(white: Array, colour: Colour) -> Array:
    """Return equation (1) at the frequencies of the transform of a white residual (N,)."""
    response = np.abs(np.fft.rfft(colour.error.own, len(white))) ** 2
    above = spectrum(white) - 1.0
    averaged = 2.0 * np.maximum(FEWEST, BAND * np.arange(len(above))) + 1.0
    above[above < CLEARLY / np.sqrt(averaged)] = 0.0
    return above * colour.deviation**2 / response


def middle_band(frequency_hz: Array, power: Array) -> Band | None:
    """Return the band that holds the middle of the power of lines (n,); None of no power."""
    order = np.argsort(frequency_hz, kind='stable')
    held = np.cumsum(power[order])
    if not len(held) or held[-1] <= 0.0:
        return None
    outside = 0.5 * (1.0 - HELD)
    low, high = np.searchsorted(held, [outside * held[-1], (1.0 - outside) * held[-1]])
    return float(frequency_hz[order[low]]), float(frequency_hz[order[high]])


def band_text(band: Band | None) -> str:
    """Return a band with its unit."""
    if band is None:
        return 'none stands out'
    low, high = (significant(end, 2) for end in band)
    return f'{low} Hz' if low == high else f'{low} to {high} Hz'
