# SPDX-License-Identifier: Apache-2.0
"""Misfit: residuals that are formulas of an axis' state, in white noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_twin.noise_model.misfit import InLog, StateFunctions, power_along, taken_by

RATE_HZ = 1000.0
SAMPLES = 6000

SEED = 11


def motions(random, logs=2, samples=SAMPLES):
    """Return positions (m) and speeds (m/s) of some logs: sums of sines."""
    found = []
    for _ in range(logs):
        time_s = np.arange(samples) / RATE_HZ
        wave, phase = 2.0 * np.pi * random.uniform(0.2, 1.0, 3), random.uniform(0.0, 6.0, 3)
        angle = np.outer(time_s, wave) + phase
        found.append((0.1 * np.sin(angle).sum(axis=1), 0.1 * (wave * np.cos(angle)).sum(axis=1)))
    return found


def in_logs(axes):
    functions = StateFunctions(tuple(way for way, _ in axes), (RATE_HZ,) * len(axes))
    return [InLog(functions, place) for place in range(len(axes))]


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
        power_along([random.standard_normal(SAMPLES) for _ in axes], change, logs).value
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


def test_a_cause_has_to_gain_more_than_the_misfit_in_other_directions(random) -> None:
    """Friction that falls with speed lacks; a force over position gains a little of it by chance."""
    axes = motions(random)
    logs = in_logs(axes)
    left = [
        random.standard_normal(SAMPLES) + np.sign(speed) * np.exp(-np.abs(speed) / 0.2)
        for _, speed in axes
    ]
    over_position = [np.cos(20.0 * way) for way, _ in axes]
    power = power_along(left, over_position, logs)
    assert power.value > 5.0
    square = sum(float(one @ one) for one in over_position)
    gained = sum(float(one @ e) for one, e in zip(over_position, left, strict=True)) ** 2 / square
    assert power.log_likelihood_ratio(gained) < 3.0
    # What is finer than these functions is no part of it.
    ripple = [np.cos(2000.0 * way) for way, _ in axes]
    assert power_along(left, ripple, logs).value < 1.5


def test_misfit_is_seen_in_short_logs_as_well(random) -> None:
    """In two logs of 0.8 s, with functions of every second point: not every log is long."""
    axes = motions(random, samples=800)
    logs = in_logs(axes)
    columns = np.concatenate(logs[0].functions.columns)
    assert 0 < columns.shape[1] <= 31
    assert columns.T @ columns == pytest.approx(np.eye(columns.shape[1]), abs=1e-6)
    noise = [random.standard_normal(len(speed)) for _, speed in axes]
    change = [np.cos(20.0 * way) for way, _ in axes]
    assert power_along(noise, change, logs).value < 2.5
    lacks = [3.0 * np.sign(speed) * np.exp(-np.abs(speed) / 0.2) for _, speed in axes]
    left = [one + other for one, other in zip(noise, lacks, strict=True)]
    assert power_along(left, change, logs).value > 5.0


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
        ).value
        for pairs in (
            [(1.0, one) for one in axes],
            [((-1.0) ** place, one) for place, one in enumerate(axes)],
        )
    )
    assert other < 0.3 * same


def test_an_axis_that_stands_has_no_misfit() -> None:
    logs = in_logs([(np.zeros(SAMPLES), np.zeros(SAMPLES))])
    power = power_along([np.ones(SAMPLES)], [np.ones(SAMPLES)], logs)
    assert power.value == 1.0
    assert math.isinf(power.freedom)
    assert power.log_likelihood_ratio(7.0) == 3.5
