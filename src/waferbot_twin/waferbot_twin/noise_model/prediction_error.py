# SPDX-License-Identifier: Apache-2.0
"""
Least squares with coloured residuals.

Residuals of real machines are correlated: friction, vibration and the controller colour them. Taken as
white, their likelihood is far too sharp and any regressor seems significant. So each channel's residual
is an autoregressive process,

    r[n] = a_1 r[n-1] + ... + a_p r[n-p] + w[n],        w white with variance s^2,

whose coefficients follow by least squares, and is compared after filtering with
1 - a_1 z^-1 - ...: generalised least squares, iterated as by Cochrane and Orcutt. With N samples per
channel the logarithm of the likelihood is, up to a constant,

    ln L = - sum over channels of N/2 (ln s^2 + <w^2> / s^2 - 1),

s^2 = <w^2>, but not less than the resolution of the channel allows (the floor).

Two encoders of one axis, a motor's and its load's, see the same force and the same motion. Taken as
independent, what shakes both counts twice; and a model whose observer uses one of them profits when
another model's uses both, whatever is true. So the residuals r, q of such a pair are one process,

    r[n] = sum of a_i r[n-i] + sum of b_i q[n-i] + w[n],                        i = 1 ... p,
    q[n] = sum of c_i q[n-i] + sum of d_i r[n-i] + d_0 r[n] + v[n],

a vector autoregression in its triangular form: w and v are independent of each other, and ln L is the
sum as above. What one observer makes of the readings is, for a linear machine, a filter of what another
one makes of them, and a vector autoregression that is long enough takes any such filter out.

Sources: J. D. Hamilton, Time Series Analysis, Princeton 1994, chapters 5, 8 and 11; L. Ljung, System
Identification, 1999, section 7.4 (likelihood of innovations).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.noise_model.fir_filter import filtered
from waferbot_twin.noise_model.gram import SMALLEST, spanning
from waferbot_twin.noise_model.leverage import Leverage
from waferbot_twin.noise_model.misfit import InLog
from waferbot_twin.noise_model.variance_components import Shapes, prediction_filter

Array = NDArray[np.float64]

EVEN_TO_HZ, FEWEST_FREEDOM = 8.0, 16
"""
Up to which frequency the power of noise is taken for even, and the fewest lines that are averaged.

A log of T s has 2 T f lines up to f Hz.
"""


def freedom_of(duration_s: float) -> int:
    """Return how many degrees of freedom the power of noise is found with in a log."""
    return max(FEWEST_FREEDOM, round(2.0 * EVEN_TO_HZ * duration_s))


@dataclass(frozen=True)
class Noise:
    """
    What is known of the noise in a channel.

    `floor` is the smallest standard deviation that it can have, that of the channel's resolution: a
    perfect fit is not infinitely likely. `order` is that of the autoregression, 0 for white noise.
    `freedom` is how many degrees of freedom its power is found with (`freedom_of`).
    `beside` says how many places further on in the list of channels that one is with which it makes
    a pair, negative for the second of them, 0 for a channel by itself. Both have as many samples, of
    the same times. With `shapes` the spectrum of a channel by itself is a sum of those
    (`variance_components`), not any one. `state` has the functions of the state of the channel's axis,
    of which what a model lacks may be made (`misfit`), in this log.
    """

    floor: float
    order: int
    beside: int = 0
    shapes: Shapes | None = None
    freedom: int = FEWEST_FREEDOM
    state: InLog | None = None

    def alone(self) -> Noise:
        """Return the noise of the channel by itself."""
        return replace(self, beside=0)


@dataclass(frozen=True)
class PredictionError:
    """
    The filter that leaves of a channel what its past, and that of the other one of a pair, do not tell.

    `own` (p + 1,) is (1, -a_1, ..., -a_p), `other` (p + 1,) likewise (-b_0, ..., -b_p), for the
    channel `beside` places further on; empty without one.
    """

    own: Array
    other: Array
    beside: int

    @property
    def order(self) -> int:
        """The order p: how many samples at the beginning are lost."""
        return len(self.own) - 1

    def __call__(self, channels: Sequence[Array] | Mapping[int, Array], place: int) -> Array:
        """Return channel number `place`, (N,) or (N, k), filtered, without its first p samples."""
        left = filtered(self.own, channels[place])
        if self.beside:
            left += filtered(self.other, channels[place + self.beside])
        return left


@dataclass(frozen=True)
class Colour:
    """
    The colour of the noise in a channel: its filter, and the deviation of what that leaves.

    `freedom` is that of its power (`Noise`).
    """

    error: PredictionError
    deviation: float
    freedom: int = FEWEST_FREEDOM

    @property
    def block(self) -> int:
        """Over how many samples sums show what the filter does not see: it is white in faster ones."""
        return max(1, self.error.order // 2)


RIDGE = 1e-10
"""Share of its variance added to a channel's: a line spectrum, or zero, has a filter then, too."""


def autoregression(residual: Array, order: int) -> Array:
    """
    Return the prediction-error filter (1, -a_1, ..., -a_p) of a residual by itself.

    Least squares on the lagged samples (the covariance method).
    """
    return _prediction_error([residual], 0, Noise(0.0, order)).own


def _prediction_error(channels: Sequence[Array], place: int, noise: Noise) -> PredictionError:
    """Return the prediction-error filter of channel number `place`, by least squares."""
    order = noise.order
    if order == 0:
        return PredictionError(np.ones(1), np.zeros(0), 0)
    if noise.shapes is not None and not noise.beside:
        taps = prediction_filter(channels[place], order, noise.shapes)
        return PredictionError(taps, np.zeros(0), 0)
    both = [channels[place + further] for further in dict.fromkeys((0, noise.beside))]
    both = [channel - channel.mean() for channel in both]
    moments = np.block([[_moments(x, y, order) for y in both] for x in both])
    variances = np.repeat(np.diag(moments)[:: order + 1], order + 1)
    # Samples n - p to n, channel by channel: the present of a channel is told by its past, by the
    # other's, and that of the second of a pair by the present of the first.
    told_by = variances > 0.0
    told_by[order] = False
    if noise.beside > 0:
        told_by[-1] = False
    taps = np.zeros(len(moments))
    if variances[0] > 0.0:
        known = moments[np.ix_(told_by, told_by)] + np.diag(RIDGE * variances[told_by])
        taps[told_by] = -np.linalg.solve(known, moments[told_by, order])
    taps[order] = 1.0
    mine, others = taps[: order + 1][::-1], taps[order + 1 :][::-1]
    return PredictionError(mine, others, noise.beside)


def _moments(x: Array, y: Array, order: int) -> Array:
    """
    Return the sums m_ij = sum over n = p ... N - 1 of x[n - p + i] y[n - p + j], for i, j = 0 ... p.

    Down a diagonal only the first and the last product change:
    m_(i+1)(j+1) = m_ij - x[i] y[j] + x[N - p + i] y[N - p + j].
    """
    rows = len(x) - order
    moments = np.zeros((order + 1, order + 1))
    moments[0] = np.correlate(y, x[:rows], 'valid')
    moments[:, 0] = np.correlate(x, y[:rows], 'valid')
    change = np.outer(x[rows:], y[rows:]) - np.outer(x[:order], y[:order])
    for i in range(order):
        moments[i + 1, 1:] = moments[i, :-1] + change[i]
    return moments


@dataclass(frozen=True)
class Fit:
    """
    A fit of residual + signature @ value = noise.

    `value` (k,) and its covariance (k, k); `log_likelihood`; `samples` how many went in; `whitened`
    the white residual of each channel, divided by its standard deviation; `colours` and what was known
    of the `noises` those of each channel. `leverages` are those of all that was fitted, channel by
    channel; None where they are not known.
    """

    value: Array
    covariance: Array
    log_likelihood: float
    samples: int
    whitened: tuple[Array, ...]
    colours: tuple[Colour, ...]
    noises: tuple[Noise, ...]
    leverages: tuple[Leverage | None, ...]


def fit(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    noises: Sequence[Noise],
    rounds: int = 4,
    known: Sequence[Colour] = (),
) -> Fit:
    """
    Fit the signatures (N, k) of all channels to their residuals (N,).

    The noise is what is left of the residuals without them, at first all of it. `known` is the colour
    of the residuals as they stand, channel by channel, if somebody has it already.
    """
    count = signatures[0].shape[1]
    value: Array = np.zeros(count)
    if not count:
        return _result(residuals, value, np.zeros((0, 0)), noises)
    standing = known or _colours(residuals, noises)
    # What no signature changes keeps its colour.
    changes = [
        bool(signatures[place].any() or (noise.beside and signatures[place + noise.beside].any()))
        for place, noise in enumerate(noises)
    ]
    parts: list[Normal] = []
    for number in range(rounds):
        colours = standing
        if number:
            colours = _colours(_left(residuals, signatures, value), noises, standing, changes)
        parts = normal_equations(residuals, signatures, colours, parts)
        matrix, right = reduced(parts)
        value = np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], np.float64)
    covariance = np.asarray(np.linalg.pinv(matrix.T @ matrix, SMALLEST**2, hermitian=True))
    return _result(
        _left(residuals, signatures, value), value, covariance, noises, standing, changes
    )


@dataclass(frozen=True)
class Normal:
    """Normal equations A' A x = A' b of the white rows of a channel, (k, k) and (k,), in its colour."""

    products: Array
    moments: Array
    colour: Colour


def normal_equations(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    colours: Sequence[Colour],
    known: Sequence[Normal] = (),
) -> list[Normal]:
    """
    Return the normal equations of every channel, white; those `known` stand where the colour does.

    What changes nothing in a channel is not filtered.
    """
    found = []
    for place, colour in enumerate(colours):
        if known and known[place].colour is colour:
            found.append(known[place])
            continue
        pair = signatures[place], signatures[place + colour.error.beside]
        own = np.flatnonzero(np.any([part.any(axis=0) for part in pair], axis=0))
        count = signatures[place].shape[1]
        products, moments = np.zeros((count, count)), np.zeros(count)
        if len(own):
            beside = {place: pair[0][:, own], place + colour.error.beside: pair[1][:, own]}
            rows = colour.error(beside, place) / colour.deviation
            right = colour.error(residuals, place) / colour.deviation
            products[np.ix_(own, own)] = rows.T @ rows
            moments[own] = -(rows.T @ right)
        found.append(Normal(products, moments, colour))
    return found


def reduced(parts: Sequence[Normal]) -> tuple[Array, Array]:
    """
    Return the least-squares problem |A x - b| of many rows (N, k) as one of k rows or fewer.

    W' A' A and W' A' b with the W of `gram.spanning`, a tenth of the time of a factorisation of A.
    """
    products = np.sum([part.products for part in parts], axis=0)
    moments = np.sum([part.moments for part in parts], axis=0)
    directions = spanning(products)
    return np.asarray(directions.T @ products), np.asarray(directions.T @ moments)


def likelihood(
    residuals: Sequence[Array], noises: Sequence[Noise], known: Sequence[Colour] = ()
) -> Fit:
    """
    Return how likely residuals (N,) are as they stand.

    Each channel, or both of one process, with the more likely one of the colour that is found in it and
    of that which is `known` already, in another model's residuals, with a deviation of its own: noise is
    the same whatever the model.
    """
    colours = _colours(residuals, noises)
    if known:
        colours = _more_likely(residuals, noises, colours, known)
    return _result(
        residuals, np.zeros(0), np.zeros((0, 0)), noises, colours, [False] * len(noises)
    )


def _more_likely(
    left: Sequence[Array],
    noises: Sequence[Noise],
    own: Sequence[Colour],
    known: Sequence[Colour],
) -> list[Colour]:
    rescaled = [
        replace(
            colour,
            deviation=max(math.sqrt(float(np.mean(colour.error(left, place) ** 2))), noise.floor),
        )
        for place, (colour, noise) in enumerate(zip(known, noises, strict=True))
    ]
    both = (own, rescaled)
    firsts = [min(place, place + noise.beside) for place, noise in enumerate(noises)]
    likely = [
        np.bincount(firsts, _log_likelihoods(in_deviations(colours, left), colours), len(firsts))
        for colours in both
    ]
    return [both[int(likely[1][first] > likely[0][first])][n] for n, first in enumerate(firsts)]


def _left(residuals: Sequence[Array], signatures: Sequence[Array], value: Array) -> list[Array]:
    return [r + s @ value for r, s in zip(residuals, signatures, strict=True)]


def _colours(
    left: Sequence[Array],
    noises: Sequence[Noise],
    known: Sequence[Colour] = (),
    changed: Sequence[bool] = (),
) -> list[Colour]:
    """Return the colour of what is left of every channel; it is `known` of those not `changed`."""
    found = []
    for place, noise in enumerate(noises):
        if known and not changed[place]:
            found.append(known[place])
            continue
        error = _prediction_error(left, place, noise)
        square = float(np.mean(error(left, place) ** 2))
        found.append(Colour(error, max(math.sqrt(square), noise.floor), noise.freedom))
    return found


def whitened(
    residuals: Sequence[Array], signatures: Sequence[Array], colours: Sequence[Colour]
) -> tuple[Array, Array]:
    """
    Return the rows A (N, k) and b (N,) of all channels, white and with a standard deviation of one.

    The value x that explains the residuals best is where |A x - b|^2 is least.
    """
    rows = in_deviations(colours, signatures)
    right = in_deviations(colours, residuals)
    return np.vstack(rows), -np.concatenate(right)


def in_deviations(colours: Sequence[Colour], channels: Sequence[Array]) -> list[Array]:
    """Return channels, (N,) or (N, k), each filtered and in its standard deviations."""
    return [one.error(channels, place) / one.deviation for place, one in enumerate(colours)]


def _result(
    left: Sequence[Array],
    value: Array,
    covariance: Array,
    noises: Sequence[Noise],
    known: Sequence[Colour] = (),
    changed: Sequence[bool] = (),
) -> Fit:
    """Judge what is left over: colour, variance and likelihood."""
    colours = _colours(left, noises, known, changed)
    in_units = in_deviations(colours, left)
    return Fit(
        value,
        covariance,
        sum(_log_likelihoods(in_units, colours)),
        sum(len(white) for white in in_units),
        tuple(in_units),
        tuple(colours),
        tuple(noises),
        (None,) * len(noises),
    )


def log_likelihoods_with(colours: Sequence[Colour], channels: Sequence[Array]) -> list[float]:
    """Return how likely each channel is, ln L up to a constant, with noise of given colours."""
    return _log_likelihoods(in_deviations(colours, channels), colours)


def _log_likelihoods(in_units: Sequence[Array], colours: Sequence[Colour]) -> list[float]:
    # <w^2> is s^2, unless the deviation is held up by the floor or is that of other residuals.
    return [
        -len(white) * (math.log(colour.deviation) + 0.5 * (float(np.mean(white**2)) - 1.0))
        for white, colour in zip(in_units, colours, strict=True)
    ]


def prediction_errors(fit: Fit, channels: Sequence[Array]) -> list[Array]:
    """Return channels, (N,) or (N, k), filtered as a fit found for them, in their deviations."""
    return in_deviations(fit.colours, channels)
