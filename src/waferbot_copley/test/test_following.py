# SPDX-License-Identifier: Apache-2.0
"""An amplifier that follows another one's voltages, met in the middle of its work."""

import numpy as np
import pytest

from waferbot_copley.amplifier import follow_voltage, initial_state, step
from waferbot_copley.current_loop import FIELD_ORIENTED

MET = 200


def work_of(stand, ticks=600):
    """Run a stand with its motor; return angles' counts, line currents and voltages of every tick."""
    counts, currents, voltages = [], [], []
    for tick in range(ticks):
        currents.append(stand.currents.copy())
        stand.tick(12.0, 0.02 * tick)
        counts.append(stand.counts.copy())
        voltages.append(stand.voltage.copy())
    return np.array(counts), np.array(currents), np.array(voltages)


def missing_voltage(stand, share, work):
    """Follow what was recorded from tick `MET` on; return what the follower lacks, V (n, 9)."""
    state, missing = initial_state(stand.parameters), []
    computed = np.zeros(9)
    for counts, currents, voltage in zip(*(signal[MET:] for signal in work), strict=True):
        step(state, stand.parameters, 2, stand.command, currents, counts, computed)
        missing.append(voltage - computed)
        follow_voltage(state, stand.parameters, counts, missing[-1], share)
    return np.array(missing)


@pytest.mark.parametrize('mode', [0, FIELD_ORIENTED])
@pytest.mark.parametrize('update_delay', [0, 1])
def test_follower_ends_with_the_same_voltages(drive_stand, mode, update_delay):
    """Its integrators begin at R i, without the voltage that turns the motor: that dies out."""
    stand = drive_stand(mode=mode, update_delay=update_delay)
    missing = missing_voltage(stand, 0.3, work_of(stand))
    assert np.abs(missing[2:6]).max() > 0.05
    assert np.abs(missing[200:]).max() < 1e-9


def test_without_following_the_wrong_beginning_stays(drive_stand):
    stand = drive_stand()
    missing = missing_voltage(stand, 0.0, work_of(stand))
    assert missing[-1] == pytest.approx(missing[0], abs=1e-9)
    assert np.abs(missing[-1]).max() > 0.05


def test_the_error_dies_out_by_the_share(drive_stand):
    """In phase mode a missing voltage is e (1 - share)^n after n ticks."""
    stand = drive_stand()
    missing = missing_voltage(stand, 0.02, work_of(stand))[:, 3:6]
    expected = missing[0] * 0.98 ** np.arange(len(missing))[:, None]
    assert missing == pytest.approx(expected, abs=1e-9)


def test_what_is_common_to_the_terminals_is_left_out(drive_stand):
    stand = drive_stand()
    for tick in range(50):
        stand.tick(5.0, 0.02 * tick)
    before = stand.field('integrator').copy()
    follow_voltage(stand.state, stand.parameters, stand.counts, np.full(9, 7.0), 0.5)
    assert stand.field('integrator') == pytest.approx(before)
