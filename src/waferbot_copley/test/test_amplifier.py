# SPDX-License-Identifier: Apache-2.0
"""The amplifier as a whole: independence of the axes, repeatability, command conditioning."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from waferbot_copley import filters
from waferbot_copley.amplifier import initial_state, report, step
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import AXES

axis_settings = st.fixed_dictionaries(
    {
        'mode': st.integers(0, 1),
        'voltage_limit': st.integers(0, 2),
        'limit_order': st.integers(0, 1),
        'update_delay': st.integers(0, 1),
        'bus_voltage': st.floats(50.0, 420.0),
        'proportional_gain': st.integers(0, 5000),
        'integral_gain': st.integers(0, 3000),
        'current_offset': st.floats(-5.0, 5.0),
        'i2t_time': st.floats(0.001, 0.01),
        'user_peak_current': st.sampled_from([0.0, 30.0]),
        'filter_1_kind': st.sampled_from([1, 2, 3, 4, 7]),
        'filter_2_kind': st.sampled_from([1, 7]),
        'counts_per_electrical_cycle': st.floats(100.0, 1e6),
        'commutation_offset': st.floats(-3.0, 3.0),
    }
)


def random_inputs(seed, ticks):
    """Return command (ticks, 3), line currents (ticks, 6) and counts (ticks, 4)."""
    random = np.random.default_rng(seed)
    return (
        30 * random.normal(size=(ticks, 3)),
        np.repeat([25.0, 10.0, 40.0], 2) * random.normal(size=(ticks, 6)),
        random.integers(-(10**9), 10**9, (ticks, 4)),
    )


def run(parameters, groups, inputs):
    """Advance the groups of axes, each with its own state; return voltages, reports and states."""
    states = [initial_state(parameters) for _ in groups]
    voltage = np.zeros(9)
    voltages = []
    for command, currents, counts in zip(*inputs, strict=True):
        for state, axes in zip(states, groups, strict=True):
            step(state, parameters, axes, command, currents, counts, voltage)
        voltages.append(voltage.copy())
    reports = np.zeros(3), np.zeros(3), np.zeros(3, np.uint8), np.zeros(3, np.uint32)
    for state, axes in zip(states, groups, strict=True):
        report(state, parameters, axes, *reports)
    return np.array(voltages), np.array([field.astype(float) for field in reports])


@settings(deadline=None, max_examples=40)
@given(st.tuples(axis_settings, axis_settings, axis_settings), st.integers(0, 2**32 - 1))
def test_one_amplifier_for_all_or_one_each(chosen, seed):
    """
    Three axes in one call, one by one, or in reverse order: every bit is the same.

    And over all settings: voltages are finite; the three terminals sum to zero, or with a limit
    lie within the bus and are centred on it.
    """
    parameters = amplifier_parameters(dict(zip(AXES, chosen, strict=True)))
    inputs = random_inputs(seed, 60)
    together = run(parameters, [0b111], inputs)
    for groups in ([0b001, 0b010, 0b100], [0b100, 0b011], [0b101, 0b010]):
        for one, other in zip(together, run(parameters, groups, inputs), strict=True):
            assert one.tobytes() == other.tobytes()

    voltages = together[0].reshape(-1, 3, 3)
    assert np.isfinite(voltages).all()
    for axis, setting in enumerate(chosen):
        terminals, bus = voltages[:, axis], setting['bus_voltage']
        if setting['voltage_limit']:
            assert np.abs(terminals).max() <= bus / 2 * (1 + 1e-12)
            assert terminals.max(1) == pytest.approx(-terminals.min(1), abs=1e-9)
        else:
            assert terminals.sum(1) == pytest.approx(0.0, abs=1e-12 * np.abs(terminals).max())


def test_other_axes_are_left_alone():
    """A call for one axis touches neither the voltages nor the state of the others."""
    parameters = amplifier_parameters({})
    state, voltage = initial_state(parameters), np.full(9, 7.0)
    before = state.copy()
    step(state, parameters, 0b010, np.ones(3), np.ones(6), np.ones(4, np.int64), voltage)
    assert (voltage[[0, 1, 2, 6, 7, 8]] == 7.0).all()
    assert (voltage[3:6] != 7.0).all()
    for name in state.dtype.names:
        assert np.array_equal(state[name][0, [0, 2]], before[name][0, [0, 2]])
    assert not np.array_equal(state['integrator'], before['integrator'])


def test_a_run_repeats_itself():
    """Two runs over the same inputs are bit-identical; the inputs are not touched."""
    parameters = amplifier_parameters({})
    inputs = random_inputs(1, 300)
    copies = [array.copy() for array in inputs]
    first, second = (run(parameters, [0b111], inputs) for _ in range(2))
    assert first[0].tobytes() == second[0].tobytes()
    assert first[1].tobytes() == second[1].tobytes()
    assert all(np.array_equal(*pair) for pair in zip(inputs, copies, strict=True))


def test_each_axis_reads_its_encoder():
    """Turning one encoder by a quarter cycle moves the voltages of its axis only."""
    parameters = amplifier_parameters({axis: {'integral_gain': 0} for axis in AXES})

    def voltages(counts):
        voltage = np.zeros(9)
        step(
            initial_state(parameters), parameters, 0b111, np.ones(3), np.zeros(6),
            np.array(counts), voltage,
        )  # fmt: skip
        return voltage.reshape(3, 3)

    still = voltages([0, 0, 0, 0])
    for encoder, axis in ((0, 0), (1, 1), (2, None), (3, 2)):
        counts = [0, 0, 0, 0]
        counts[encoder] = 25000
        moved = [i for i in range(3) if not np.array_equal(voltages(counts)[i], still[i])]
        assert moved == ([] if axis is None else [axis])


def wanted_current(stand, command, angle):
    """Return the conditioned line currents; the stand has Ci = 0 and no current."""
    return stand.amplifier_only(command, angle) / stand.loop_gains()[0]


@pytest.mark.parametrize('limit_order', [0, 1])
def test_filters_shape_the_command(drive_stand, limit_order):
    """Both filters in a row act on the command; scipy gives the same from its own designs."""
    stand = drive_stand(
        integral_gain=0, limit_order=limit_order,
        filter_1_kind=filters.LOW_PASS, filter_1_frequency=2000.0, filter_1_poles=1,
        filter_2_kind=filters.NOTCH, filter_2_frequency=700.0, filter_2_width=200.0,
    )  # fmt: skip
    commands = np.random.default_rng(2).normal(size=200)
    angle = 0.9  # standing still, filtering before or after the phasing is the same
    lines = np.array([wanted_current(stand, command, angle) for command in commands])
    expected = signal.lfilter(*signal.butter(1, 2000.0, fs=18000), commands)
    expected = signal.lfilter(*signal.iirnotch(700.0, 3.5, fs=18000), expected)
    assert lines == pytest.approx(np.outer(expected, stand.phasing(angle)), abs=1e-6)


def test_offset_before_and_after_the_phasing(drive_stand):
    """Before the phasing an offset is a force; after it a direct current in lines 1 and 2."""
    for angle in (0.0, 1.0, 4.0):
        stand = drive_stand(integral_gain=0, limit_order=0, current_offset=0.5)
        expected = 2.5 * stand.phasing(angle)
        assert wanted_current(stand, 2.0, angle) == pytest.approx(expected, abs=1e-6)
        stand = drive_stand(integral_gain=0, limit_order=1, current_offset=0.5)
        expected = 2.0 * stand.phasing(angle) + np.array([0.5, 0.5, -1.0])
        assert wanted_current(stand, 2.0, angle) == pytest.approx(expected, abs=1e-6)


def test_commutation_offset_turns_the_current(drive_stand):
    """An offset of the electrical angle costs its cosine in force current."""
    stand = drive_stand(integral_gain=0, commutation_offset=math.radians(20.0))
    lines = wanted_current(stand, 3.0, 1.0)
    assert lines == pytest.approx(3.0 * stand.phasing(1.0 + math.radians(20.0)), abs=1e-6)
    force_current = 2 / 3 * lines @ stand.phasing(1.0)
    assert force_current == pytest.approx(3.0 * math.cos(math.radians(20.0)), abs=1e-6)


def test_update_delay_is_one_tick(drive_stand):
    """With the delay every voltage comes out one tick later, otherwise unchanged."""
    prompt, late = (
        drive_stand(integral_gain=100, voltage_limit=2, update_delay=delay) for delay in (0, 1)
    )
    previous = np.zeros(3)
    for command in np.random.default_rng(4).normal(size=50) * 20:
        now = prompt.amplifier_only(command, 0.3)
        assert (late.amplifier_only(command, 0.3) == previous).all()
        previous = now
