# SPDX-License-Identifier: Apache-2.0
"""
The noise beside a fit: what that has taken of it, and the spectrum of the rest while its axis moves.

Friction that holds an axis holds it against what shakes it, too. So where an axis stands for half of a
log, its noise is louder while it moves than in all of the log, and there is where causes show. Slow
noise of so short a time has few lines, and what is fitted takes most of them. But that noise has one of
a few shapes, and what it is at frequencies at which more is left tells what it is at low ones. So with
m(n) 1 where the axis moves and 0 where it stands, in units of its root mean square,

    S(f) = sum over k of s_k B_k(f) |A(f)|^2,                                                      (1)

B_k the shapes of `variance_components` with coloured forces and A the filter of the residual e, as sums
over blocks of samples show them, is the likeliest spectrum of m e (Whittle), of which a line counts as
the share that the fit has left of it,

    1 - sum over j of |F m U_j|^2 / n                                                              (2)

(`leverage`). With forces up to 3 to 60 Hz that are there while an axis moves only, and nine columns
fitted, 16 of 1000 directions seemed to be one of a thousand beside the leverage alone; 2 do by equation
(1) (`test_noise_beside_fit`, in more draws).

Limit: noise that has another shape, a hum for one, is seen by the periodogram alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from waferbot_twin.noise_model.leverage import Leverage, directions_of, sums_of
from waferbot_twin.noise_model.prediction_error import Colour, Noise
from waferbot_twin.noise_model.variance_components import (
    COLOURED_HZ,
    LEAST_LINES,
    ROUNDS,
    Shapes,
    bands,
    likeliest,
)

Array = NDArray[np.float64]


def leverages_of(
    rows: Sequence[Array],
    left: Sequence[Array],
    noises: Sequence[Noise],
    colours: Sequence[Colour],
    prior: Array,
) -> list[Leverage]:
    """
    Return the leverage of what is fitted in every channel, and the noise beside it.

    `rows` (N, k) are its white signatures, `left` what it leaves over, white, `prior` (k,) is the
    precision of every parameter.
    """
    directions = directions_of(rows, prior)
    return [_in_channel(*one, directions) for one in zip(rows, left, noises, colours, strict=True)]


def _in_channel(
    rows: Array, left: Array, noise: Noise, colour: Colour, directions: Array
) -> Leverage:
    found = Leverage(sums_of(rows, colour.block) @ directions, colour.block)
    if noise.state is not None:
        found = replace(found, of_state=noise.state.along(rows) @ directions)
    if noise.shapes is None or noise.beside:
        return found
    return replace(found, while_moving=while_moving(left, colour, noise.shapes, found))


def while_moving(white: Array, colour: Colour, shapes: Shapes, leverage: Leverage) -> Array:
    """
    Return equation (1) at the lines of sums over blocks, (n // 2 + 1,), white noise having 1.

    Of what a fit leaves over in a channel. Empty if its axis does not move there.
    """
    block = colour.block
    slow = sums_of(white, block) / math.sqrt(block)
    count = len(slow)
    share = sums_of(shapes.moves[len(shapes.moves) - len(white) :].astype(float), block)
    if len(share) != count or not share.any():
        return np.zeros(0)
    window = share / math.sqrt(float(np.mean(share**2)))
    power = np.abs(rfft(window * slow))[1:] ** 2 / count
    kept = np.maximum(1.0 - leverage.lines_within(window)[1:], 0.0)
    each = _in_sums(colour, shapes, count)
    each /= each.mean(axis=1, keepdims=True)
    band = bands(len(power))
    lines = np.bincount(band)
    sums = np.maximum(np.bincount(band, kept), LEAST_LINES)
    base = np.stack([np.bincount(band, one) / lines for one in each])
    total = float(power.mean())
    if not total > 0.0:
        return np.zeros(0)
    shares = np.full(len(each), total / len(each))
    for _ in range(ROUNDS):
        shares = likeliest(base, np.bincount(band, power) / sums, sums, total, shares)
    found = shares @ each
    return np.concatenate([found[:1], found])


def _in_sums(colour: Colour, shapes: Shapes, count: int) -> Array:
    """
    Return B_k |A|^2, (k, n // 2), at the lines but zero of n = `count` sums over blocks of samples.

    With b samples in a block, what is at f + m f_s / b shows at f, each by sin^2(b w) / (b sin w)^2 at
    its w = pi f / f_s.
    """
    block, lines = colour.block, np.arange(1, count // 2 + 1) / (colour.block * count)
    folded = np.arange(block)[:, None] / block + lines  # f / f_s, 0 to 1
    angle = np.pi * folded
    shown = (np.sin(block * angle) / (block * np.sin(angle))) ** 2
    taps = colour.error.own
    gain = np.abs(np.polynomial.polynomial.polyval(np.exp(-2j * angle), taps)) ** 2
    frequency_hz = np.asarray(np.minimum(folded, 1.0 - folded) * shapes.rate_hz, np.float64)
    each = shapes.as_they_are(frequency_hz, COLOURED_HZ)
    return np.asarray(np.sum(each * (gain * shown), axis=1))
