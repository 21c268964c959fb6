# SPDX-License-Identifier: Apache-2.0
"""Motors: Kirchhoff, power balance, force constant, delta against wye, exact circuit solution."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.linalg import expm

from waferbot_plant import motors, plant
from waferbot_plant.plant import load_machine


def motor_on_slide(winding: str, heating=None, **more):
    """Return a machine of one linear motor on a horizontal mass."""
    return load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, 0, 0],
            motors={
                'y_linear': {
                    'coordinate': 'travel',
                    'winding': winding,
                    'resistance_lead_to_lead_ohm': 2.0,
                    'inductance_lead_to_lead_h': 0.012,
                    'back_emf_lead_to_lead_v_s_m': 127.0,
                    'electrical_cycle_m': 0.032,
                    **({'heating': heating} if heating else {}),
                }
            },
            **more,
        )
    )


@pytest.mark.parametrize('winding', ['wye', 'delta'])
@pytest.mark.parametrize('position', [0.0, 0.003, -0.0137, 0.4])
def test_phased_line_currents_give_the_largest_positive_force(
    winding: str, position: float
) -> None:
    machine = motor_on_slide(winding)
    parameters = machine.parameters()
    amplitude = 7.0
    expected = math.sqrt(3.0) / 2.0 * 127.0 * amplitude
    description = machine.description.motors['y_linear']
    assert motors.force_constant(description) * amplitude == pytest.approx(expected, rel=1e-14)
    angle = 2.0 * math.pi * position / 0.032

    def mean_force(advance_angle: float) -> float:
        state = machine.initial_state(parameters)
        state[0]['position'][0] = position
        lines = [amplitude * math.sin(angle + advance_angle - 2 * math.pi / 3 * k) for k in (0, 1)]
        motors.set_line_currents(state, parameters, 0, tuple(lines))
        measured = np.zeros(6)
        motors.measure_line_currents(state[0], parameters[0], measured)
        assert measured[:2] == pytest.approx(lines, rel=1e-13, abs=1e-13)
        motors.begin_step(state[0], parameters[0], state[0]['position'], np.zeros(9), 1e-12)
        return motors.force_and_damping(state[0], parameters[0], 0)[0]

    assert mean_force(0.0) == pytest.approx(expected, rel=1e-8)
    assert mean_force(0.3) == pytest.approx(expected * math.cos(0.3), rel=1e-8)
    assert mean_force(-0.3) == pytest.approx(expected * math.cos(0.3), rel=1e-8)


def test_delta_and_wye_of_the_same_data_sheet_are_the_same_at_the_terminals() -> None:
    """Equal lead-to-lead data: line currents and motion agree, tick by tick."""
    runs = []
    for winding in ('delta', 'wye'):
        machine = motor_on_slide(winding)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        voltage = np.zeros(9)
        lines = np.zeros(6)
        record = []
        for tick in range(3000):
            for phase in range(3):
                voltage[phase] = 20.0 * math.sin(0.004 * tick - 2.0 * math.pi / 3.0 * phase) + 3.0
            plant.advance(state, parameters, voltage)
            motors.measure_line_currents(state[0], parameters[0], lines)
            record.append([*lines[:2], state[0]['position'][0], state[0]['velocity'][0]])
        runs.append(np.array(record))
    scale = np.abs(runs[0]).max(axis=0)
    assert (np.abs(runs[0] - runs[1]).max(axis=0) / scale).max() < 1e-10


def test_star_point_carries_no_current() -> None:
    """Kirchhoff (3.15), under voltages that are not balanced."""
    seed = 7
    print('seed', seed)
    random = np.random.default_rng(seed)
    machine = motor_on_slide('wye')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    for _ in range(500):
        plant.advance(state, parameters, random.uniform(-160.0, 160.0, 9))
        current = state[0]['winding_current'][0]
        assert abs(current.sum()) < 1e-12 * max(1.0, np.abs(current).max())


def test_circulating_current_of_a_delta_decays_with_its_time_constant() -> None:
    machine = motor_on_slide('delta')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['winding_current'][0] = 5.0
    for _ in range(180):
        plant.advance(state, parameters, np.zeros(9))
    assert state[0]['winding_current'][0] == pytest.approx(
        [5.0 * math.exp(-0.01 * 2.0 / 0.012)] * 3, rel=1e-4
    )
    assert state[0]['velocity'][0] == pytest.approx(0.0, abs=1e-12)
    lines = np.ones(6)
    motors.measure_line_currents(state[0], parameters[0], lines)
    assert lines[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_locked_rotor_current_follows_the_exact_circuit() -> None:
    """A held wye motor is R and L: step response against the matrix exponential."""
    machine = motor_on_slide('wye')
    parameters = machine.parameters()
    parameters[0]['mass'][0] = 1e12
    parameters[0]['substeps'] = 8
    parameters[0]['step'] /= 8
    state = machine.initial_state(parameters)
    voltage = np.zeros(9)
    voltage[:3] = [30.0, -10.0, -10.0]
    ticks = 90
    for _ in range(ticks):
        plant.advance(state, parameters, voltage)
    time = ticks / 18000
    resistance, inductance = 1.0, 0.006
    across = voltage[:3] - voltage[:3].mean()
    decay = expm(np.array([[-resistance / inductance * time]]))[0, 0]
    expected = across / resistance * (1.0 - decay)
    assert state[0]['winding_current'][0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize('winding', ['wye', 'delta'])
def test_electrical_power_becomes_heat_and_motion(winding: str) -> None:
    """Energy taken from the amplifier = copper loss + magnetic + kinetic, to rounding."""
    machine = motor_on_slide(winding)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    voltage = np.zeros(9)
    for tick in range(9000):
        for phase in range(3):
            voltage[phase] = 40.0 * math.sin(0.002 * tick - 2.0 * math.pi / 3.0 * phase)
        plant.advance(state, parameters, voltage)
    stored = np.zeros(4)
    plant.energy(state, parameters, stored)
    s = state[0]
    assert abs(s['electrical_energy'][0]) > 1.0
    balance = s['electrical_energy'][0] - s['copper_loss'][0] - stored.sum()
    assert abs(balance) < 1e-9 * s['electrical_energy'][0]


def test_open_terminals_carry_no_current_and_brake_nothing() -> None:
    machine = motor_on_slide('delta')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    motors.set_line_currents(state, parameters, 0, (4.0, -1.0))
    state[0]['terminals_open'][0] = 1
    state[0]['velocity'][0] = 0.5
    stored = np.zeros(4)
    plant.energy(state, parameters, stored)
    before = stored.sum()
    for _ in range(100):
        plant.advance(state, parameters, np.full(9, 50.0))
    assert state[0]['velocity'][0] == 0.5
    lines = np.ones(6)
    motors.measure_line_currents(state[0], parameters[0], lines)
    assert lines[:2] == pytest.approx([0.0, 0.0], abs=1e-15)
    plant.energy(state, parameters, stored)
    given_back = -state[0]['electrical_energy'][0]
    assert before - stored.sum() == pytest.approx(given_back, rel=1e-12)


def test_shorted_motor_brakes() -> None:
    """With shorted terminals a moving motor turns motion into heat; nothing else."""
    machine = motor_on_slide('wye')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['velocity'][0] = 0.2
    for _ in range(18000):
        plant.advance(state, parameters, np.zeros(9))
    assert abs(state[0]['velocity'][0]) < 1e-6
    assert state[0]['copper_loss'][0] == pytest.approx(0.5 * 2.0 * 0.2**2, rel=1e-9)


HEATING = {
    'state': 'warming',
    'winding_to_air_k_w': 0.5,
    'winding_capacity_j_k': 4.0,
    'air_degc': 20.0,
    'resistance_at_degc': 25.0,
    'resistance_rise_1_k': 0.00393,
}
"""Like a real motor, but warm within seconds."""


def warming_motor(**changes):
    """Return (machine, parameters, state) of a motor that is held and warms up."""
    machine = motor_on_slide('wye', heating={**HEATING, **changes})
    parameters = machine.parameters()
    parameters[0]['mass'][0] = 1e12
    state = machine.initial_state(parameters)
    return machine, parameters, state


def test_winding_warms_up_as_one_capacity_on_one_resistance() -> None:
    """Constant current, resistance held: T = T_air + P R_th (1 - exp(-t / (R_th C)))."""
    _, parameters, state = warming_motor(resistance_rise_1_k=0.0)
    s = state[0]
    assert s['winding_temperature'][0] == 20.0
    voltage = np.zeros(9)
    voltage[:3] = [8.0, -4.0, -4.0]
    s['winding_current'][0] = voltage[:3]  # 1 ohm each
    power = 8.0**2 + 2 * 4.0**2
    for tick in range(1, 36001):
        plant.advance(state, parameters, voltage)
        if tick % 9000 == 0:
            expected = 20.0 + power * 0.5 * (1.0 - math.exp(-tick / 18000 / (0.5 * 4.0)))
            assert s['winding_temperature'][0] == pytest.approx(expected, rel=1e-9)
    stored = 4.0 * (s['winding_temperature'][0] - 20.0)
    assert s['copper_loss'][0] == pytest.approx(power * 2.0, rel=1e-9)
    assert stored + s['heat_given_to_air'][0] == pytest.approx(s['copper_loss'][0], rel=1e-12)


@pytest.mark.slow
def test_warm_copper_resists_more() -> None:
    """At constant voltage the current falls to where heat made and heat given away balance."""
    _, parameters, state = warming_motor()
    s = state[0]
    voltage = np.zeros(9)
    voltage[:3] = [8.0, -4.0, -4.0]
    for _ in range(18000 * 20):
        plant.advance(state, parameters, voltage)
    squares = 8.0**2 + 2 * 4.0**2
    # rise x over 25 degC: x + 5 = 0.5 squares / (1 + a x), a quadratic in x
    a = 0.00393
    rise = (-(1 + 5 * a) + math.sqrt((1 + 5 * a) ** 2 - 4 * a * (5 - 0.5 * squares))) / (2 * a)
    assert s['winding_temperature'][0] == pytest.approx(25.0 + rise, abs=0.01)
    assert s['winding_current'][0][0] == pytest.approx(8.0 / (1 + a * rise), rel=1e-4)
    heat = motors.copper_loss_power(s, parameters[0], 0)
    assert heat == pytest.approx(squares / (1 + a * rise), rel=1e-4)
    books = s['electrical_energy'][0] - s['copper_loss'][0]
    stored = np.zeros(4)
    plant.energy(state, parameters, stored)
    assert abs(books - stored[3]) < 1e-9 * s['electrical_energy'][0]
    in_copper = 4.0 * (s['winding_temperature'][0] - 20.0)
    assert in_copper + s['heat_given_to_air'][0] == pytest.approx(s['copper_loss'][0], rel=1e-9)


def test_cold_motor_is_the_one_without_heating() -> None:
    """`state: cold` changes nothing, whatever the other numbers are: the same to the last bit."""
    ends = []
    for more in ({}, {'heating': {**HEATING, 'state': 'cold'}}):
        machine = motor_on_slide('delta', **more)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(200):
            plant.advance(state, parameters, np.linspace(-30.0, 40.0, 9))
        ends.append(state.tobytes())
    assert ends[0] == ends[1]


def test_shipped_models_stay_cold_unless_asked() -> None:
    for model in ('rigid', 'simplified', 'flexible'):
        assert all(
            motor.heating is None for motor in load_machine(model).description.motors.values()
        )
    warm = {axis: {'heating': {'state': 'warming'}} for axis in ('y_linear', 'x_rotate')}
    machine = load_machine('rigid', overlays=[{'motors': warm}])
    parameters = machine.parameters()[0]
    assert parameters['heat_capacity'].tolist() == [1800.0, 1500.0, 0.0]
    assert machine.description.motors['x_rotate'].heating.coefficient == 0.00393


@pytest.mark.parametrize('lag_s', [1e-6, 2e-4, 3e-3])
def test_what_lags_is_the_exact_solution_for_what_is_held(lag_s: float) -> None:
    """Its mean over each step by the matrix exponential of T di/dt = u - i, dm/dt = i, du/dt = 0."""
    step_s, told = 5e-5, np.random.default_rng(1).normal(size=(300, 3))
    told[100:120, 1] = np.nan
    system = np.array([[-1.0, 0.0, 1.0], [lag_s, 0.0, 0.0], [0.0, 0.0, 0.0]]) / lag_s
    moves = expm(system * step_s)
    found = motors.lagged(told, np.array([lag_s, 0.0, 2.0 * lag_s]), step_s)
    acting = told[0, 0]
    for tick, now in enumerate(told[:, 0]):
        acting, integral, _ = moves @ (acting, 0.0, now)
        assert found[tick, 0] == pytest.approx(integral / step_s, rel=1e-9, abs=1e-12)
    assert np.array_equal(found[:, 1], told[:, 1], equal_nan=True)
    assert found[0, 2] == pytest.approx(told[0, 2])


def test_what_lags_begins_anew_behind_a_gap() -> None:
    told = np.array([[1.0], [np.nan], [3.0], [3.0]])
    found = motors.lagged(told, np.array([1e-3]), 1e-4)[:, 0]
    assert np.isnan(found[1])
    assert found[[0, 2, 3]] == pytest.approx([1.0, 3.0, 3.0])
