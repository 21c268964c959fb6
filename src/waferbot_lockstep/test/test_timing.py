# SPDX-License-Identifier: Apache-2.0
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing


@given(st.integers(0, 10**12))
def test_stamp_is_the_exact_time_rounded_down(tick):
    stamp = Timing().stamp_ns(tick)
    assert stamp == tick * 500000 // 9
    assert 0 <= Fraction(tick, 18000) * 10**9 - stamp < 1


@given(st.integers(0, 10**7), st.integers(1, 100))
def test_messages_counts_multiples(ticks, divider):
    assert Timing().messages(ticks, divider) == len(range(0, ticks, divider))


def test_rates_of_the_thesis():
    timing = Timing()
    assert (timing.encoder_hz, timing.servo_hz) == (9000.0, 2250.0)
    assert timing.ticks(0.5) == 9000
    assert timing.seconds(9000) == 0.5


@pytest.mark.parametrize('rates', [(0, 2, 8), (18000, 0, 8), (18000, 3, 8), (18000, 4, 2)])
def test_rates_that_do_not_nest_are_refused(rates):
    with pytest.raises(UserError, match='timing'):
        Timing(*rates)


@pytest.mark.parametrize('current_loop_hz', [18000, 7, 10**9])
def test_stamps_of_many_ticks_are_those_of_each(current_loop_hz):
    timing = Timing(current_loop_hz=current_loop_hz)
    ticks = np.array([0, 1, 7, 17999, 18000, 10**9 - 1, 5 * 10**11])  # a year at 18 kHz
    stamps = timing.stamps_ns(ticks[ticks // current_loop_hz < 9 * 10**9])
    assert stamps.tolist() == [timing.stamp_ns(int(tick)) for tick in ticks][: len(stamps)]
