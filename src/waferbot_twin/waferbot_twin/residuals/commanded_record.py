# SPDX-License-Identifier: Apache-2.0
"""
What the command alone explains of a log whose loop cannot be closed, as nobody knows its controller.

In a loop, noise moves the axis and the controller answers: what is computed from a measured motion has
the noise in it that a residual has, too. The response to the command is found from the log itself,

    y(t) = c + sum over k of b_k m_k(t),                                                            (1)

m_k the mean of the commanded position over lags l_k to l_k+1, which grow by the same ratio: the response
of any linear loop, by least squares. The drive likewise, with the direction of (1) besides, as dry
friction makes it. With some dozens of numbers for thousands of samples nearly none of the noise is in
it, and what is computed from it knows nothing of the noise.

Source: the first of the two stages of P. Van den Hof, R. Schrama, An indirect method for transfer
function estimation from closed loop data, Automatica 29, 1993. Limit: what a loop does that is not
linear, but for the direction, is not in it.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from waferbot_twin.residuals.noise_free_motion import STANDS_COUNTS_S
from waferbot_twin.residuals.record import Array, Record

LONGEST_S = 0.25
"""How long a loop answers to a command, s; assumed: what takes longer is not explained."""

RATIO = 2.0**0.25
"""From lag to lag, beyond the first few rows."""


def tells_command(record: Record) -> bool:
    """Return whether an imported log has the commands of every axis that it shows, throughout."""
    return record.current is not None and all(
        record.path_commanded(record.layout.axis_of(name)) is not None
        for place, name in enumerate(record.layout.encoders)
        if np.isfinite(record.reading[:, place]).any()
    )


def as_commanded(record: Record) -> Record:
    """
    Return an imported log with readings and drives as the commands explain them.

    Those of an axis of which no command is known throughout are as measured, and so is a recording.
    """
    if record.current is None:
        return record
    timing = record.timing
    reading, current = record.reading.copy(), record.current.copy()
    cycles = np.arange(len(reading)) * timing.encoder_divider // timing.servo_divider
    rows = np.minimum(np.arange(record.ticks) // timing.encoder_divider, len(reading) - 1)
    layout = record.layout
    for place, axis in enumerate(layout.axes):
        path = record.path_commanded(axis)
        seen = [
            encoder
            for encoder, name in enumerate(layout.encoders)
            if layout.axis_of(name) == axis and np.isfinite(reading[:, encoder]).any()
        ]
        if path is None or not seen:
            continue
        means = _lagged_means(path[np.minimum(cycles, len(path) - 1)], timing.encoder_hz)
        responses = [_response(reading[:, encoder], means) for encoder in seen]
        for encoder, response in zip(seen, responses, strict=True):
            known = np.isfinite(reading[:, encoder])
            reading[known, encoder] = means[known] @ response
        speed = np.gradient(means @ responses[0]) * timing.encoder_hz
        columns = np.column_stack([means, np.tanh(speed / STANDS_COUNTS_S)])[rows]
        known = np.isfinite(current[:, place])
        current[known, place] = columns[known] @ _response(current[:, place], columns)
    return replace(record, reading=reading, current=current, path=None)


def _lagged_means(path: Array, rate_hz: float) -> Array:
    """Return m_k of equation (1) and ones, (n, k + 1); a path was before as it begins."""
    longest = max(2, round(LONGEST_S * rate_hz))
    powers = np.arange(np.ceil(np.log(longest) / np.log(RATIO)) + 1.0)
    lags = np.unique(np.minimum(np.round(RATIO**powers), longest)).astype(np.intp)
    lags = np.concatenate([[0], lags])
    total = np.concatenate([np.zeros(longest + 1), np.cumsum(path - path[0])])
    now = np.arange(len(path)) + longest + 1
    means = [
        (total[now - first] - total[now - last]) / (last - first)
        for first, last in itertools.pairwise(lags)
    ]
    return np.column_stack([*means, np.ones(len(path))])


def _response(signal: Array, columns: Array) -> Array:
    """Return what (k,) explains a signal (n,) by columns (n, k) best, where it is known."""
    known = np.isfinite(signal)
    solution, *_ = np.linalg.lstsq(columns[known], signal[known], rcond=1e-10)
    return np.asarray(solution)
