# SPDX-License-Identifier: Apache-2.0
"""What an input in real time uses, holds back, passes over and counts; it stops nobody."""

import math
import random

import pytest

from waferbot_lockstep.contract import (
    ALL_AXES,
    ALL_ENCODERS,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_VOLTAGES,
)
from waferbot_lockstep.errors import LockstepError
from waferbot_lockstep.newest_input import HORIZON, NewestInput
from waferbot_lockstep.timing import Timing

TIMING = Timing()


def volts(tick, shift=0.0):
    return (*(tick * 10.0 + place + shift for place in range(9)), 0)


def push(box, tick, valid=ALL_AXES, values=None, now_s=0.0):
    return box.push(tick, TIMING.stamp_ns(tick), valid, values or volts(tick), now_s)


def voltages_at(tick, needed=ALL_AXES):
    """Return an input that has been given all ticks up to `tick`, each in time."""
    box = NewestInput(PHASE_VOLTAGES, TIMING, needed)
    for own in range(tick + 1):
        box.reach(own, own * 1e-3)
        push(box, own, now_s=own * 1e-3)
    return box


def counts_at(tick):
    box = NewestInput(ENCODERS_TOPIC, TIMING, ALL_ENCODERS)
    for own in range(0, tick + 1, box.spacing):
        push(box, own, ALL_ENCODERS, (own, 0, 0, 0))
    return box


def test_the_newest_is_used_and_a_late_one_counted_with_its_lateness():
    box = voltages_at(3)
    for tick in (4, 5, 6):
        box.reach(tick, tick * 1e-3)
    assert push(box, 4, now_s=0.0065)
    assert box.values.tolist() == list(volts(4)[:9])
    assert box.behind == 2
    assert (box.arrivals.received, box.arrivals.late, box.arrivals.missed) == (5, 1, 0)
    assert box.arrivals.worst_s == pytest.approx(0.0025)
    assert box.arrivals.percentile_s(50) == 0.0


def test_missed_counts_messages_and_not_places():
    box = voltages_at(0)
    box.reach(4, 0.0)
    push(box, 4)
    assert box.arrivals.missed == 3


def test_publishers_that_share_a_topic_each_miss_their_own():
    box = voltages_at(0)
    box.reach(4, 0.0)
    push(box, 4, 0b001)
    push(box, 4, 0b110)
    assert box.arrivals.missed == 6
    assert (box.newest_tick, box.behind) == (4, 0)


def test_a_message_that_comes_after_its_successor_is_late_and_no_longer_missed():
    box = voltages_at(0)
    box.reach(3, 0.0)
    push(box, 3)
    assert not push(box, 2)
    assert (box.arrivals.missed, box.arrivals.late, box.arrivals.doubled) == (1, 1, 0)
    assert not push(box, 2), 'and the same again is a repetition'
    assert (box.arrivals.missed, box.arrivals.late, box.arrivals.doubled) == (1, 1, 1)
    assert box.values.tolist() == list(volts(3)[:9])


def test_repetitions_do_no_harm_and_a_second_voice_is_counted():
    box = voltages_at(5)
    assert not push(box, 5)
    assert (box.arrivals.doubled, box.arrivals.trouble) == (1, 0)
    assert not push(box, 5, values=volts(5, 0.5))
    assert (box.arrivals.doubled, box.arrivals.contradicting) == (1, 1)
    assert box.values.tolist() == list(volts(5)[:9])


def test_an_early_message_is_held_back_until_its_tick():
    box = voltages_at(5)
    assert not push(box, 8)
    assert box.values.tolist() == list(volts(5)[:9])
    assert box.arrivals.early == 1
    for tick in (6, 7, 8):
        box.reach(tick, 0.0)
        assert box.newest_tick == (8 if tick == 8 else 5)
    assert box.values.tolist() == list(volts(8)[:9])


def test_a_message_from_far_ahead_shuts_nobody_out():
    box = voltages_at(5)
    push(box, 5 + HORIZON + 1)
    assert box.arrivals.early == 1
    for tick in range(6, 10):
        box.reach(tick, 0.0)
        assert push(box, tick)
    assert box.newest_tick == 9


def test_before_the_time_is_known_the_newest_is_kept_for_it():
    box = NewestInput(CURRENT_COMMAND, TIMING, ALL_AXES)
    push(box, 54320, values=(1.0, 2.0, 3.0))
    assert not box.complete
    box.reach(54325, 0.0)
    assert box.values.tolist() == [1.0, 2.0, 3.0]
    assert box.arrivals.trouble == 1, 'it came before us, but its tick was over'


def test_after_a_message_that_never_came_the_next_is_waited_for():
    box = voltages_at(5)
    box.reach(6, 0.0)
    assert box.waits_for(6)
    box.give_up(6, gone=0)
    assert not box.waits_for(6)
    box.reach(7, 0.0)
    assert box.waits_for(7)
    held = NewestInput(CURRENT_COMMAND, TIMING, ALL_AXES)
    held.reach(0, 0.0)
    push(held, 0, values=(0.0,) * 3)
    held.give_up(8, gone=0)
    assert not held.waits_for(15), 'of the same servo cycle'
    assert held.waits_for(16)


def test_whoever_is_gone_is_not_waited_for_until_heard_again():
    box = voltages_at(5)
    box.reach(6, 0.0)
    assert box.waits_for(6)
    box.give_up(6, gone=ALL_AXES)
    assert not box.waits_for(6)
    box.reach(7, 0.0)
    assert not box.waits_for(7)
    push(box, 7, 0b001)
    box.reach(8, 0.0)
    assert box.waits_for(8), 'for the one that is back'
    push(box, 8, 0b001)
    assert not box.waits_for(8), 'but not for the others'


def test_what_is_held_when_time_begins_is_of_another_beginning():
    box = voltages_at(500)
    box.forget()
    box.reach(0, 1.0)
    push(box, 499, now_s=1.1)  # still on their way when the plant began anew
    push(box, 500, now_s=1.1)
    assert not box.complete
    push(box, 0, values=volts(0, 0.5), now_s=1.2)
    for tick in range(1, 500):
        box.reach(tick, 2.0)
        push(box, tick, values=volts(tick, 0.5), now_s=2.0)
    box.reach(500, 2.0)
    assert box.values.tolist() == list(volts(499, 0.5)[:9])
    push(box, 500, values=volts(500, 0.5), now_s=2.0)
    assert box.arrivals.contradicting == 0


def test_a_held_message_is_waited_for_only_at_its_own_ticks():
    box = NewestInput(CURRENT_COMMAND, TIMING, ALL_AXES)
    box.reach(0, 0.0)
    push(box, 0, values=(0.0,) * 3)
    assert not box.waits_for(7)
    assert box.waits_for(8)


def test_time_that_begins_anew_is_followed_once_it_is_certain():
    box = counts_at(200)
    assert not push(box, 0, ALL_ENCODERS, (7, 0, 0, 0)), 'one may be a stray'
    assert not box.began_anew
    assert push(box, 0, ALL_ENCODERS, (7, 0, 0, 0))
    assert box.began_anew
    assert (box.newest_tick, box.values[0]) == (0, 7)


def test_a_stray_between_honest_messages_begins_nothing():
    box = counts_at(5000)
    for tick in (5002, 5004, 5006):
        push(box, 0, ALL_ENCODERS, (7, 0, 0, 0))
        assert push(box, tick, ALL_ENCODERS, (tick, 0, 0, 0))
    assert not box.began_anew
    assert box.newest_tick == 5006


def test_forgetting_waits_for_a_first_message_again_but_keeps_the_account():
    box = voltages_at(5)
    box.forget()
    assert not box.complete
    assert box.missing == 'y_linear, x_rotate, y_rotate'
    assert box.arrivals.received == 6


@pytest.mark.parametrize('seed', range(20))
def test_whatever_the_network_does_the_account_adds_up(seed):
    """Messages are lost, doubled, swapped: never an error, and each is found in one of the counts."""
    rng = random.Random(seed)
    box = voltages_at(0)
    due = [tick for tick in range(1, 400) if rng.random() > 0.1]
    sent = [(tick + rng.choice((0, 0, 0, 2.5)), tick) for tick in due]
    sent += [(tick + 0.1, tick) for tick in due if rng.random() < 0.1]
    last = 0
    for at, tick in sorted(sent):
        box.reach(max(last, int(at)), at)
        last = max(last, int(at))
        push(box, tick, now_s=at)
    arrivals = box.arrivals
    came = set(due)
    assert box.newest_tick == max(came)
    assert arrivals.missed == len(set(range(1, max(came))) - came)
    assert arrivals.contradicting == arrivals.early == 0
    assert arrivals.received == 1 + len(came)  # tick 0, too
    assert arrivals.received + arrivals.doubled == 1 + len(sent)


def test_no_number_is_refused_as_in_lock_step():
    with pytest.raises(LockstepError, match='no finite number'):
        push(voltages_at(0), 0, values=(*(math.nan,) * 9, 0))
