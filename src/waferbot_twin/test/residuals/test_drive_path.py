# SPDX-License-Identifier: Apache-2.0
"""What a drive does between samples, against the current loop itself, integrated by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import AXES
from waferbot_twin.logs.measured import Signal
from waferbot_twin.residuals.drive_path import no_path, with_signal

STEP_S, TICKS = 1e-3, 8
TICK_S = STEP_S / TICKS


def drive(value, hold=''):
    return Signal('current', 'x_rotate', 'A', STEP_S * np.arange(len(value)), value, hold=hold)


def path_of(signal, ticks, per_unit=1.0):
    edges_s = TICK_S * np.arange(ticks + 1)
    return with_signal(no_path(ticks + 1, 3), 0, signal, edges_s, per_unit), edges_s


def early(time_s):
    return np.array([time_s, *[0.0] * (len(AXES) - 1)])


def sampled_loop(random, tau_s, samples):
    """Return samples of a first-order loop with a new command at each, and its means over ticks."""
    command = random.standard_normal(samples)
    value, means, now = [0.0], [], 0.0
    for wanted in command:
        since_s = np.arange(TICKS + 1) * TICK_S
        area = wanted * since_s + (now - wanted) * tau_s * -np.expm1(-since_s / tau_s)
        means.append(np.diff(area) / TICK_S)
        now = wanted + (now - wanted) * np.exp(-STEP_S / tau_s)
        value.append(now)
    return np.array(value), np.concatenate(means)


@given(st.floats(0.05e-3, 3e-3), st.integers(0, 2**32 - 1))
@settings(derandomize=True, deadline=None, max_examples=40)
def test_a_path_is_that_of_a_current_loop(tau_s, seed):
    value, means = sampled_loop(np.random.default_rng(seed), tau_s, 12)
    signal = drive(value)
    path, edges_s = path_of(signal, len(means))
    bend = STEP_S / tau_s
    early_s = STEP_S * (1.0 / -np.expm1(-bend) - 1.0 / bend - 0.5)
    found = signal.means(edges_s) + path.earlier_by(early(early_s), TICK_S)[:, 0]
    np.testing.assert_allclose(found, means, atol=1e-6)


@pytest.mark.parametrize('share', [-0.49, -0.3, -1e-5, 1e-5, 0.2, 0.45])
def test_on_average_a_path_is_earlier_by_what_was_asked_for(share):
    """The integral over a ramp between two levels is larger by the rise times that."""
    value = np.array([1.0, 1.0, 3.0, 3.0])
    path, _ = path_of(drive(value), 3 * TICKS, per_unit=2.0)
    change = path.earlier_by(early(share * STEP_S), TICK_S)[:, 0]
    assert np.sum(change) * TICK_S == pytest.approx(share * STEP_S * 2.0 * 2.0, rel=1e-6)
    assert not change[:TICKS].any()
    np.testing.assert_allclose(change[2 * TICKS :], 0.0, atol=1e-12)


def test_beyond_half_a_step_a_path_stands_or_jumps():
    value = np.random.default_rng(1).standard_normal(20)
    path, edges_s = path_of(drive(value), 19 * TICKS)
    straight = drive(value).means(edges_s)
    jumps = straight + path.earlier_by(early(STEP_S), TICK_S)[:, 0]
    stands = straight + path.earlier_by(early(-STEP_S), TICK_S)[:, 0]
    inside = np.arange(len(jumps)) % TICKS
    np.testing.assert_allclose(
        jumps[inside > 0], np.repeat(value[1:], TICKS)[inside > 0], atol=1e-6
    )
    np.testing.assert_allclose(
        stands[inside < TICKS - 1], np.repeat(value[:-1], TICKS)[inside < TICKS - 1], atol=1e-6
    )


def test_what_is_held_or_in_a_gap_has_no_path():
    value = np.random.default_rng(2).standard_normal(80)
    path, _ = path_of(drive(value, hold='zero_order'), 79 * TICKS)
    assert not path.earlier_by(early(3e-4), TICK_S).any()
    time_s = STEP_S * np.concatenate([np.arange(40), 400.0 + np.arange(40)])
    gap = Signal('current', 'x_rotate', 'A', time_s, value)
    edges_s = TICK_S * np.arange(439 * TICKS + 1)
    path = with_signal(no_path(len(edges_s), 3), 0, gap, edges_s, 1.0)
    change = path.earlier_by(early(3e-4), TICK_S)[:, 0]
    assert not change[39 * TICKS : 400 * TICKS].any()
    assert change[: 39 * TICKS].any()
    assert change[400 * TICKS :].any()


def test_a_part_and_longer_ticks_have_the_same_path():
    value = np.random.default_rng(3).standard_normal(20)
    path, _ = path_of(drive(value), 19 * TICKS)
    whole = path.earlier_by(early(2e-4), TICK_S)
    part = path.part(slice(24, 80)).earlier_by(early(2e-4), TICK_S)
    np.testing.assert_allclose(part, whole[24:80], atol=1e-9)
    longer = path.in_longer_ticks(2).earlier_by(early(2e-4), 2.0 * TICK_S)
    np.testing.assert_allclose(longer, whole.reshape(-1, 2, 3).mean(axis=1), atol=1e-9)
