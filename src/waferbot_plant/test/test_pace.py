# SPDX-License-Identifier: Apache-2.0
"""Sim time against the wall clock, with a clock of the test's own."""

import math

import pytest

from waferbot_plant.pace import LONGEST_LAG_S, Pace

TICK_S = 1e-3


def running(factor=1.0, tick=100, now_s=50.0):
    pace = Pace(factor, TICK_S)
    pace.start(tick, now_s)
    return pace


def test_ticks_are_due_by_the_wall_clock():
    pace = running(factor=0.5)
    assert pace.due_s(100) == 50.0
    assert pace.due_s(103) == pytest.approx(50.006)


def test_nothing_is_due_while_time_stands_still():
    pace = running()
    pace.stop()
    assert not pace.running
    assert pace.due_s(0) == math.inf
    assert pace.rate(60.0) is None


def test_a_short_delay_is_made_up_for():
    pace = running()
    pace.come_to(101, 50.05)
    assert pace.worst_lag_s == pytest.approx(0.049)
    assert pace.written_off_s == 0.0
    assert pace.due_s(102) == pytest.approx(50.002)


def test_a_long_delay_is_written_off():
    pace = running()
    late_s = 50.001 + 1.5 * LONGEST_LAG_S
    pace.come_to(101, late_s)
    assert pace.written_off_s == pytest.approx(1.5 * LONGEST_LAG_S)
    assert pace.due_s(102) == pytest.approx(late_s + TICK_S)


def test_the_rate_is_what_sim_time_did_since_it_was_asked():
    pace = running(factor=2.0)
    for tick in range(101, 301):
        pace.come_to(tick, 50.0 + 2.0 * (tick - 100) * TICK_S)
    assert pace.rate(50.4) == pytest.approx(0.5)
    assert pace.rate(50.5) == 0.0
