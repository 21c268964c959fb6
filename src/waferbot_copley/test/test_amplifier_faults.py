# SPDX-License-Identifier: Apache-2.0
"""Faults: what raises each, what it switches off, how it goes away, what is reported."""

import math

import numpy as np
import pytest

from waferbot_copley import faults
from waferbot_copley.amplifier import changed, report, reset_faults


def fault_of(stand):
    """Return the fault bits of the axis."""
    return int(stand.field('faults'))


def advance(stand, command=5.0, angle=1.0, ticks=1):
    """Advance the amplifier; return the last terminal voltages."""
    for _ in range(ticks):
        voltage = stand.amplifier_only(command, angle)
    return voltage


def cause_over_current(stand, present):
    """Put 2.1 peak currents into line 3, or nothing."""
    stand.lines = (84.0 if present else 0.0) * np.array([-0.5, -0.5, 1.0])


def cause_hot_drive(stand, present):
    """Set the heat sink's temperature."""
    stand.set('heat_sink_temperature', 71.0 if present else 30.0)


def cause_hot_motor(stand, present):
    """Set the motor sensor's temperature."""
    stand.set('motor_temperature', 131.0 if present else 30.0)


def cause_high_bus(stand, present):
    """Set the bus voltage."""
    stand.parameters['bus_voltage'] = 401.0 if present else 325.0


def cause_low_bus(stand, present):
    """Set the bus voltage."""
    stand.parameters['bus_voltage'] = 59.0 if present else 325.0


def cause_wrong_halls(stand, present):
    """Turn the Hall sensors by half a turn against the encoder (angle 1 rad: 1 high, 2 low)."""
    right = sum(1 << k for k, value in enumerate(stand.phasing(1.0)) if value > 0)
    stand.set('hall_state', 7 - right if present else right)


def cause_following_error(stand, present):
    """Set the input of the position loop."""
    stand.set('following_error_input', present)


def cause_safe_torque_off(stand, present):
    """Open the safety circuit."""
    stand.set('safe_torque_off', present)


CAUSES = {
    faults.OVER_CURRENT: cause_over_current,
    faults.DRIVE_OVER_TEMPERATURE: cause_hot_drive,
    faults.MOTOR_OVER_TEMPERATURE: cause_hot_motor,
    faults.OVER_VOLTAGE: cause_high_bus,
    faults.UNDER_VOLTAGE: cause_low_bus,
    faults.PHASING: cause_wrong_halls,
    faults.FOLLOWING_ERROR: cause_following_error,
    faults.SAFE_TORQUE_OFF: cause_safe_torque_off,
}


def test_every_fault_has_a_name_and_its_own_bit():
    """The bits are distinct, and described in words."""
    assert len(faults.NAMES) == bin(faults.ALL_FAULTS).count('1') == 9
    assert faults.describe(faults.PHASING | faults.I2T) == 'phasing error, I2T'
    assert faults.describe(0) == 'none'


@pytest.mark.parametrize('latched', [False, True])
@pytest.mark.parametrize(
    ('bit', 'cause'), CAUSES.items(), ids=[faults.NAMES[bit] for bit in CAUSES]
)
def test_fault_appears_acts_and_goes(drive_stand, bit, cause, latched):
    """Each fault is found in the tick of its cause; latched ones wait for a reset."""
    stand = drive_stand(latched_faults=bit if latched else faults.ALL_FAULTS & ~bit)
    cause(stand, False)
    assert np.abs(advance(stand)).max() > 0
    assert fault_of(stand) == 0

    cause(stand, True)
    voltage = advance(stand)
    assert fault_of(stand) == bit
    assert (voltage == 0).all() == (bit != faults.FOLLOWING_ERROR)

    reset_faults(stand.state, 7)
    advance(stand)
    assert fault_of(stand) == bit  # the cause is still there

    cause(stand, False)
    advance(stand)
    assert fault_of(stand) == (bit if latched else 0)
    reset_faults(stand.state, ~(1 << stand.axis))  # of the other axes only
    advance(stand)
    assert fault_of(stand) == (bit if latched else 0)
    reset_faults(stand.state, 1 << stand.axis)
    assert np.abs(advance(stand)).max() > 0
    assert fault_of(stand) == 0


def test_default_latching():
    """What can destroy something waits for a reset; a bus that recovers does not."""
    latched = faults.LATCHED_BY_DEFAULT
    assert latched & faults.OVER_CURRENT
    assert latched & faults.PHASING
    assert not latched & (faults.OVER_VOLTAGE | faults.UNDER_VOLTAGE | faults.SAFE_TORQUE_OFF)


@pytest.mark.parametrize('mode', [0, 1])
def test_bridge_starts_afresh(drive_stand, mode):
    """After the bridge was off, the loop answers as a new one does, with nothing remembered."""
    settings = dict(mode=mode, filter_1_kind=1, filter_1_frequency=300.0, update_delay=1)
    stand, new = drive_stand(**settings), drive_stand(**settings)
    advance(stand, ticks=50)
    stand.set('safe_torque_off', 1)
    assert (advance(stand, ticks=3) == 0).all()
    stand.set('safe_torque_off', 0)
    for _ in range(5):
        assert (advance(stand) == advance(new)).all()


def test_i2t_can_be_a_fault(drive_stand):
    """With i2t_fault the exhausted allowance switches off instead of limiting."""
    stand = drive_stand(i2t_fault=1, i2t_time=0.01)
    stand.lines = 40.0 * stand.phasing(1.0)
    advance(stand, 40.0, ticks=178)
    assert fault_of(stand) == 0
    assert (advance(stand, 40.0, ticks=4) == 0).all()
    assert fault_of(stand) == faults.I2T


def test_heat_sink_follows_its_losses(drive_stand):
    """A constant current warms it along an exponential to 1.5 R I^2 Rth above ambient."""
    constant, resistance, thermal, current = 0.1, 0.1, 0.5, 15.0
    stand = drive_stand(
        heat_sink_time_constant=constant, bridge_resistance=resistance,
        heat_sink_resistance=thermal, ambient_temperature=25.0,
    )  # fmt: skip
    stand.lines = current * stand.phasing(0.4)
    for ticks in (300, 1500):
        advance(stand, ticks=ticks)
    rise = 1.5 * resistance * current**2 * thermal * (1 - math.exp(-1800 / 18000 / constant))
    assert stand.field('heat_sink_temperature') == pytest.approx(25.0 + rise, rel=1e-9)


def test_hall_sensors_within_their_tolerance(drive_stand):
    """
    True Hall signals never fault; shifted ones fault if the shift is beyond the tolerance.

    Somewhere in the turn an edge is late by the whole shift.
    """
    tolerance = math.radians(30.0)
    for shift in np.radians([0.0, 20.0, -29.0, 31.0, -45.0, 120.0, 180.0]):
        stand = drive_stand(phasing_tolerance=tolerance, latched_faults=faults.PHASING)
        for angle in np.radians(np.arange(0.25, 360.0, 0.5)):
            halls = stand.phasing(angle + shift) > 0
            stand.set('hall_state', sum(1 << k for k in range(3) if halls[k]))
            advance(stand, angle=angle)
        assert fault_of(stand) == (faults.PHASING if abs(shift) > tolerance else 0)


def test_all_halls_high_is_a_fault(drive_stand):
    """Three high sensors are a broken cable at any angle."""
    stand = drive_stand(phasing_tolerance=math.pi / 2)
    stand.set('hall_state', 7)
    advance(stand)
    assert fault_of(stand) == faults.PHASING


class Reports:
    """Asks an amplifier for reports, as the node does."""

    def __init__(self, stand):
        self.stand = stand
        self.limits = np.zeros(3, np.uint8)
        self.faults = np.zeros(3, np.uint32)

    def take(self):
        """Take a report of all axes; return limits and faults of the stand's axis."""
        arrays = np.zeros(3), np.zeros(3), self.limits, self.faults
        report(self.stand.state, self.stand.parameters, 7, *arrays)
        return int(self.limits[self.stand.axis]), int(self.faults[self.stand.axis])


def test_changes_are_announced_once(drive_stand):
    """A new limit or fault asks for a report, its repetition does not, its end as documented."""
    stand = drive_stand(limit_order=0)
    reports, mine = Reports(stand), 1 << stand.axis
    advance(stand)
    assert changed(stand.state) == 0
    advance(stand, 50.0)
    assert changed(stand.state) == mine
    assert reports.take() == (1, 0)
    advance(stand, 50.0)
    assert changed(stand.state) == 0  # still the same limit
    assert reports.take() == (1, 0)
    advance(stand)
    assert changed(stand.state) == 0  # its end waits for the regular report
    assert reports.take() == (0, 0)

    stand.set('motor_temperature', 200.0)
    advance(stand)
    assert changed(stand.state) == mine
    assert reports.take() == (0, faults.MOTOR_OVER_TEMPERATURE)
    assert changed(stand.state) == 0
    stand.set('motor_temperature', 20.0)
    reset_faults(stand.state, mine)
    advance(stand)
    assert changed(stand.state) == mine
    assert reports.take() == (0, 0)


def test_i2t_is_announced_both_ways(drive_stand):
    """The report says when the allowance has run out, and when it is back."""
    stand = drive_stand(limit_order=0, i2t_time=0.01)
    reports, mine = Reports(stand), 1 << stand.axis
    stand.lines = 40.0 * stand.phasing(1.0)
    while not changed(stand.state):
        advance(stand, 40.0)
    assert reports.take()[0] & 2
    assert changed(stand.state) == 0
    stand.lines = np.zeros(3)
    ticks = 0
    while not changed(stand.state):
        advance(stand, 0.0)
        ticks += 1
    assert changed(stand.state) == mine
    assert reports.take() == (0, 0)
    assert ticks > 1
