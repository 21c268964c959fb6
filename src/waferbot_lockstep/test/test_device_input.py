# SPDX-License-Identifier: Apache-2.0
"""A device that is the clock: each of its messages is one cycle, whenever it comes."""

from __future__ import annotations

import pytest

from waferbot_lockstep.contract import ALL_AXES, CURRENT_COMMAND
from waferbot_lockstep.device_input import LONGEST_LEAD, DeviceInput
from waferbot_lockstep.errors import LockstepError
from waferbot_lockstep.timing import Timing

TIMING = Timing()


@pytest.fixture
def device():
    return DeviceInput(CURRENT_COMMAND, TIMING, ALL_AXES)


def push(device, cycle, value=None, valid=ALL_AXES):
    tick = 8 * cycle
    values = (float(cycle) if value is None else value,) * 3
    return device.push(tick, TIMING.stamp_ns(tick), valid, values)


def used(device):
    """Use what is there, cycle by cycle; return the values of the first axis."""
    values = []
    while device.complete:
        values.append(float(device.values[0]))
        device.consumed()
    return values


def test_each_message_is_one_cycle_in_order_however_far_ahead(device):
    assert not device.complete
    for cycle in range(5):
        assert push(device, cycle) == (cycle == 0)
    assert used(device) == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert device.due == 40
    assert push(device, 5)
    assert used(device) == [5.0]
    assert (device.missed, device.late, device.ramped) == (0, 0, 0)


def test_a_repetition_is_no_cycle(device):
    push(device, 0)
    assert not push(device, 0)
    assert used(device) == [0.0]
    assert not push(device, 0)
    assert used(device) == []


def test_cycles_that_were_passed_over_hold_the_value_before(device):
    push(device, 0, 7.0)
    push(device, 3, 9.0)
    assert used(device) == [7.0, 7.0, 7.0, 9.0]
    assert device.missed == 2


def test_a_ramp_goes_to_zero_and_stands_until_the_device_is_back(device):
    push(device, 0, 8.0)
    assert used(device) == [8.0]
    assert device.ramp(4)
    assert used(device) == [6.0, 4.0, 2.0, 0.0]
    assert not device.complete
    assert device.ramped == 4
    assert not push(device, 1)  # of a cycle that is over
    assert device.late == 1
    assert push(device, 5, 3.0)
    assert used(device) == [3.0]


def test_a_device_that_is_back_within_the_ramp_ends_it(device):
    push(device, 0, 8.0)
    used(device)
    device.ramp(4)
    device.consumed()
    assert not push(device, 2, 4.5)  # the ramp's value for it is in hand
    assert used(device) == [4.0]
    assert push(device, 3, 5.0)
    assert used(device) == [5.0]
    assert (device.late, device.missed, device.ramped) == (1, 0, 2)


@pytest.mark.parametrize(
    ('cycle', 'value', 'valid', 'says'),
    [
        (2, 1.0, 0b011, 'some axes only'),
        (2, float('nan'), ALL_AXES, 'no finite number'),
        (0, 1.0, ALL_AXES, 'stale or out of order'),
    ],
)
def test_what_no_honest_device_sends_is_refused(device, cycle, value, valid, says):
    push(device, 0)
    push(device, 1)
    with pytest.raises(LockstepError, match=f'topic current_command, tick {8 * cycle}.*{says}'):
        push(device, cycle, value, valid)


def test_a_device_that_runs_away_is_refused(device):
    for cycle in range(LONGEST_LEAD + 1):  # one is in hand
        push(device, cycle)
    with pytest.raises(LockstepError, match='cycles ahead of the twin'):
        push(device, LONGEST_LEAD + 1)
