# SPDX-License-Identifier: Apache-2.0
"""What an inbox takes, ignores and refuses."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from waferbot_lockstep.contract import (
    ALL_AXES,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_VOLTAGES,
)
from waferbot_lockstep.errors import LockstepError
from waferbot_lockstep.inbox import Inbox
from waferbot_lockstep.timing import Timing

TIMING = Timing()


def volts(tick, shift=0.0):
    return (*(tick * 10.0 + place + shift for place in range(9)), 0)


def push(inbox, tick, valid=ALL_AXES, values=None, stamp_ns=None):
    stamp = TIMING.stamp_ns(tick) if stamp_ns is None else stamp_ns
    return inbox.push(tick, stamp, valid, volts(tick) if values is None else values)


def inbox_at(tick, topic=PHASE_VOLTAGES, needed=ALL_AXES):
    inbox = Inbox(topic, TIMING, needed)
    for earlier in range(0, tick, inbox.spacing):
        push(inbox, earlier)
        inbox.consumed()
    return inbox


def test_complete_message_is_taken():
    inbox = inbox_at(0)
    values = inbox.values
    assert push(inbox, 0)
    assert inbox.complete
    assert values is inbox.values, 'compiled functions keep the array'
    assert tuple(values) == volts(0)[:9]


def test_axes_may_come_one_by_one_in_any_order():
    inbox = inbox_at(5)
    for axis in (2, 0, 1):
        assert not inbox.complete
        assert push(inbox, 5, 1 << axis)
    assert inbox.complete
    assert tuple(inbox.values) == volts(5)[:9]


def test_missing_axes_are_named():
    inbox = inbox_at(5)
    push(inbox, 5, 0b010)
    assert inbox.missing == 'y_linear, y_rotate'


def test_other_axes_are_passed_over():
    inbox = inbox_at(0, needed=0b010)
    assert push(inbox, 0, 0b101) is False
    assert not inbox.complete
    assert push(inbox, 0, 0b111)
    assert inbox.complete
    assert inbox.values[:3].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize('consumed', [False, True])
def test_repetition_is_ignored(consumed):
    inbox = inbox_at(3)
    push(inbox, 3)
    if consumed:
        inbox.consumed()
    assert push(inbox, 3) is False
    assert inbox.due == (4 if consumed else 3)


@pytest.mark.parametrize(
    ('tick', 'change', 'what'),
    [
        (1, {}, 'stale or out of order: tick 3 is due'),
        (2, {'values': volts(2, 0.5)}, 'stale or out of order'),
        (4, {}, 'tick 3.*is missing: tick 4 came instead'),
        (3, {'valid': 0}, 'do not exist'),
        (3, {'valid': 0b1001}, 'do not exist'),
        (3, {'values': (*volts(3)[:8], math.nan, 0)}, 'no finite number'),
        (3, {'values': (math.inf, *volts(3)[1:])}, 'no finite number'),
        (3, {'stamp_ns': 5}, 'stamp 5 ns'),
    ],
)
def test_what_does_not_fit_is_an_error(tick, change, what):
    inbox = inbox_at(3)
    with pytest.raises(LockstepError, match=what) as raised:
        push(inbox, tick, **change)
    assert 'phase_voltages' in str(raised.value)
    assert 'copley' in str(raised.value)
    assert 'tick' in str(raised.value)


def test_two_voices_for_one_axis_are_an_error():
    inbox = inbox_at(3)
    push(inbox, 3, 0b001)
    with pytest.raises(LockstepError, match=r'y_linear.*two nodes'):
        push(inbox, 3, 0b001, volts(3, 1.0))


def test_open_bridges_are_merged_by_axis():
    inbox = inbox_at(0)
    push(inbox, 0, 0b001, (*volts(0)[:9], 0b111))
    assert inbox.mask == 0b001, 'a message only speaks for its own axis'
    push(inbox, 0, 0b110, (*volts(0)[:9], 0b100))
    assert inbox.mask == 0b101
    inbox.consumed()
    push(inbox, 1)
    assert inbox.mask == 0


def test_tick_of_another_rate_is_an_error():
    inbox = Inbox(CURRENT_COMMAND, TIMING, ALL_AXES)
    with pytest.raises(LockstepError, match='every 8th'):
        inbox.push(3, TIMING.stamp_ns(3), ALL_AXES, (1.0, 2.0, 3.0))


def test_whole_counts_stay_whole():
    inbox = Inbox(ENCODERS_TOPIC, TIMING, 0b1111)
    inbox.push(0, 0, 0b1111, (2**53 + 1, -1, 0, 7))
    assert inbox.values.tolist() == [2**53 + 1, -1, 0, 7]


@given(st.lists(st.sampled_from(['all', 'again', 0, 1, 2]), max_size=60))
def test_any_legal_traffic_keeps_order(actions):
    """However axes and repetitions interleave, every tick is consumed once, with its own values."""
    inbox = Inbox(PHASE_VOLTAGES, TIMING, ALL_AXES)
    sent = []
    given = set()
    for action in actions:
        if action == 'again':
            if sent:
                assert inbox.push(*sent[-1]) is False
        elif action == 'all' or action not in given:
            valid = (
                ALL_AXES & ~sum(1 << axis for axis in given) if action == 'all' else 1 << action
            )
            given |= {axis for axis in range(3) if valid >> axis & 1}
            message = (inbox.due, TIMING.stamp_ns(inbox.due), valid, volts(inbox.due))
            inbox.push(*message)
            sent.append(message)
        if inbox.complete:
            assert tuple(inbox.values) == volts(inbox.due)[:9]
            inbox.consumed()
            given = set()


def test_only_what_a_message_speaks_for_must_be_finite():
    inbox = inbox_at(0)
    assert push(inbox, 0, 0b001, (*volts(0)[:3], *[math.nan] * 6, 0))
    with pytest.raises(LockstepError, match='finite'):
        push(inbox, 0, 0b010, (*volts(0)[:3], *[math.nan] * 6, 0))


def test_large_finite_values_are_no_infinity():
    inbox = inbox_at(0)
    assert push(inbox, 0, values=(*[1.7e308] * 9, 0))
