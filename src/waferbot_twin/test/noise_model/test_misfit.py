# SPDX-License-Identifier: Apache-2.0
"""Misfit: residuals that are formulas of an axis' state, in white noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_twin.noise_model.misfit import (
    InLog,
    StateFunctions,
    covariance_of,
    log_likelihood_ratio,
    taken_by,
)

RATE_HZ = 1000.0
SAMPLES = 6000

SEED = 11


def motions(random, logs=2):
    """Return positions (m) and speeds (m/s) of some logs: sums of sines."""
    found = []
    for _ in range(logs):
        time_s = np.arange(SAMPLES) / RATE_HZ
        wave, phase = 2.0 * np.pi * random.uniform(0.2, 1.0, 3), random.uniform(0.0, 6.0, 3)
        angle = np.outer(time_s, wave) + phase
        found.append((0.1 * np.sin(angle).sum(axis=1), 0.1 * (wave * np.cos(angle)).sum(axis=1)))
    return found


def in_logs(axes):
    functions = StateFunctions(tuple(way for way, _ in axes), (RATE_HZ,) * len(axes))
    return [InLog(functions, place) for place in range(len(axes))]


def power_along(left, change, logs, taken=0.0):
    """Return the power of noise and misfit along a change, white noise having 1."""
    (more,) = covariance_of([one[:, None] for one in change], left, logs, taken).ravel()
    return 1.0 + float(more) / sum(float(one @ one) for one in change)


def ahead_by(left, change, logs):
    """Return by how much what leaves `left` is ahead of what leaves a change more."""
    squares = sum(float((2.0 * e + d) @ d) for e, d in zip(left, change, strict=True))
    return log_likelihood_ratio(left, change, logs, squares)


def test_the_functions_are_orthonormal_over_all_logs_together(random) -> None:
    columns = np.concatenate(in_logs(motions(random))[0].functions.columns)
    count = columns.shape[1]
    assert 40 <= count <= 71
    assert columns.T @ columns == pytest.approx(np.eye(count), abs=1e-6)


def test_white_noise_is_no_misfit(random) -> None:
    axes = motions(random)
    logs = in_logs(axes)
    change = [np.tanh(speed / 0.01) for _, speed in axes]
    values = [
        power_along([random.standard_normal(SAMPLES) for _ in axes], change, logs)
        for _ in range(40)
    ]
    # phi of white noise has the standard deviation (2 / k)^(1/2), 0.18.
    assert 1.0 <= np.mean(values) < 1.15
    assert max(values) < 1.8


def test_white_noise_is_no_misfit_where_much_was_fitted(random) -> None:
    """What was fitted has taken a third of what the functions show: not less than noise is left."""
    axes = motions(random)
    logs = in_logs(axes)
    columns = np.concatenate(
        [
            np.column_stack([way**n * speed**m for n in range(5) for m in range(5)])
            for way, speed in axes
        ]
    )
    fitted, _ = np.linalg.qr(columns)
    parts = np.split(fitted, len(axes))
    taken = taken_by([log.along(part) for log, part in zip(logs, parts, strict=True)])
    assert 8.0 < taken < 25.0
    found = []
    for _ in range(60):
        noise = random.standard_normal(SAMPLES * len(axes))
        left = np.split(noise - fitted @ (fitted.T @ noise), len(axes))
        squares = sum(log.along(one) for log, one in zip(logs, left, strict=True))
        found.append(float(squares @ squares) / (logs[0].count - taken))
    assert np.mean(found) == pytest.approx(1.0, abs=4.0 * np.std(found) / math.sqrt(len(found)))


def misfit_of(axes, random):
    """Return friction that falls with speed, in white noise: it lacks."""
    return [
        random.standard_normal(SAMPLES) + np.sign(speed) * np.exp(-np.abs(speed) / 0.2)
        for _, speed in axes
    ]


def test_a_cause_has_to_gain_more_than_the_misfit_in_other_directions(random) -> None:
    """A force over position gains a little of what lacks by chance."""
    axes = motions(random)
    logs = in_logs(axes)
    left = misfit_of(axes, random)
    over_position = [np.cos(20.0 * way) for way, _ in axes]
    along_it = power_along(left, over_position, logs)
    assert along_it > 5.0
    square = sum(float(one @ one) for one in over_position)
    size = sum(float(one @ e) for one, e in zip(over_position, left, strict=True)) / square
    change = [size * one for one in over_position]
    fitted = [e - d for e, d in zip(left, change, strict=True)]
    assert ahead_by(fitted, change, logs) < 3.0
    # What is finer than these functions is no part of it.
    ripple = [np.cos(2000.0 * way) for way, _ in axes]
    assert power_along(left, ripple, logs) - 1.0 < 0.1 * (along_it - 1.0)


def test_what_is_finer_than_misfit_counts_in_full_whatever_else_differs(random) -> None:
    """A ripple alone, and beside a force over position that is among the functions of the state."""
    axes = motions(random)
    logs = in_logs(axes)
    left = misfit_of(axes, random)
    ripple = [0.2 * np.cos(2000.0 * way) for way, _ in axes]
    both = [one + 0.2 * np.cos(20.0 * way) for one, (way, _) in zip(ripple, axes, strict=True)]
    alone = ahead_by(left, ripple, logs)
    assert alone > 0.5 * 0.5 * sum(float(one @ one) for one in ripple)
    assert ahead_by(left, both, logs) > 0.75 * alone


def test_what_gains_in_misfit_and_loses_elsewhere_is_not_ahead(random) -> None:
    """Coulomb friction for one that falls with speed, with a ripple that is not there."""
    axes = motions(random)
    logs = in_logs(axes)
    lacks = misfit_of(axes, random)
    coulomb = [np.tanh(speed / 0.05) for _, speed in axes]
    size = sum(float(f @ e) for f, e in zip(coulomb, lacks, strict=True))
    size /= sum(float(f @ f) for f in coulomb)
    change = [size * f for f in coulomb]
    without_ripple = [e - d for e, d in zip(lacks, change, strict=True)]
    assert ahead_by(without_ripple, change, logs) > 3.0
    ripple = [0.2 * np.cos(2000.0 * way) for way, _ in axes]
    fitted = [e + r for e, r in zip(without_ripple, ripple, strict=True)]
    both = [d - r for d, r in zip(change, ripple, strict=True)]
    assert sum(float(e @ e) for e in fitted) < sum(float(e @ e) for e in lacks)
    assert ahead_by(fitted, both, logs) == 0.0


def test_what_differs_from_log_to_log_is_noise(random) -> None:
    axes = motions(random, 6)
    logs = in_logs(axes)
    change = [np.tanh(speed / 0.01) for _, speed in axes]
    same, other = (
        power_along(
            [
                sign * np.tanh(way / 0.05) + random.standard_normal(SAMPLES)
                for sign, (way, _) in pairs
            ],
            change,
            logs,
        )
        for pairs in (
            [(1.0, one) for one in axes],
            [((-1.0) ** place, one) for place, one in enumerate(axes)],
        )
    )
    assert other < 0.3 * same


def test_an_axis_that_stands_has_no_misfit() -> None:
    logs = in_logs([(np.zeros(SAMPLES), np.zeros(SAMPLES))])
    nothing = np.zeros(SAMPLES)
    assert power_along([np.ones(SAMPLES)], [np.ones(SAMPLES)], logs) == 1.0
    assert log_likelihood_ratio([np.ones(SAMPLES)], [nothing], logs, 7.0) == 3.5
