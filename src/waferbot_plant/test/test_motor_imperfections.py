# SPDX-License-Identifier: Apache-2.0
"""Saturation, ripple, imbalance and warm starts: hand formulas, an ODE solver, energy."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.integrate import solve_ivp

from waferbot_lockstep.errors import UserError
from waferbot_plant import motors, plant, statics
from waferbot_plant.plant import load_machine

BACK_EMF = 127.0
RESISTANCE = 2.0
INDUCTANCE = 0.012
PITCH = 0.032
MASS = 2.0
RIPPLE = [{'order': 6, 'cosine': 0.03, 'sine': -0.02}, {'order': 2, 'sine': 0.04}]
EVERYTHING = {'saturation_current_a': 9.0, 'ripple': RIPPLE, 'phase_imbalance': [0.05, -0.03]}
EACH = {
    'saturation': {'saturation_current_a': 9.0},
    'ripple': {'ripple': RIPPLE},
    'imbalance': {'phase_imbalance': [0.05, -0.03]},
    'everything': EVERYTHING,
}


def machine_with(winding: str, gravity: float = 0.0, substeps: int = 1, **imperfections):
    """Return a linear motor on a vertical slide of 2 kg."""
    return load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, -gravity, 0],
            substeps=substeps,
            motors={
                'y_linear': {
                    'coordinate': 'travel',
                    'winding': winding,
                    'resistance_lead_to_lead_ohm': RESISTANCE,
                    'inductance_lead_to_lead_h': INDUCTANCE,
                    'back_emf_lead_to_lead_v_s_m': BACK_EMF,
                    'electrical_cycle_m': PITCH,
                    **imperfections,
                }
            },
        )
    )


def factor_of_ripple(angle: float, ripple=RIPPLE) -> float:
    return 1.0 + sum(
        one.get('cosine', 0.0) * math.cos(one['order'] * angle)
        + one.get('sine', 0.0) * math.sin(one['order'] * angle)
        for one in ripple
    )


def lines(angle: float, q: float, d: float) -> np.ndarray:
    """Return the three line currents of a current vector."""
    angles = angle - 2.0 * math.pi / 3.0 * np.arange(3)
    return q * np.sin(angles) + d * np.cos(angles)


def mean_force(machine, position: float, q: float, d: float) -> float:
    """Return the force that the step's equations have at a position with given line currents."""
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['position'][0] = position
    first, second, _ = lines(2.0 * math.pi * position / PITCH, q, d)
    motors.set_line_currents(state, parameters, 0, (first, second))
    motors.begin_step(state[0], parameters[0], state[0]['position'], np.zeros(9), 1e-12)
    return motors.force_and_damping(state[0], parameters[0], 0)[0]


def force_by_hand(winding: str, position: float, q: float, d: float, what: dict) -> float:
    """Return the force as the sum over the windings, each from its own formula."""
    angle = 2.0 * math.pi * position / PITCH
    one, two, three = lines(angle, q, d)
    if winding == 'wye':
        constant = BACK_EMF / math.sqrt(3.0)
        currents = [one, two, three]
        lead = 0.0
    else:
        constant = BACK_EMF
        currents = [(one - two) / 3.0, (two - three) / 3.0, (three - one) / 3.0]
        lead = math.pi / 6.0
    imbalance = [*what.get('phase_imbalance', (0.0, 0.0)), 0.0]
    force = sum(
        constant * (1.0 + imbalance[w]) * math.sin(angle + lead - 2.0 * math.pi / 3.0 * w) * i
        for w, i in enumerate(currents)
    )
    saturation = what.get('saturation_current_a', 0.0)
    if saturation:
        force /= math.sqrt(1.0 + (q * q + d * d) / saturation**2)
    return force * factor_of_ripple(angle, what.get('ripple', []))


@pytest.mark.parametrize('winding', ['wye', 'delta'])
@pytest.mark.parametrize('name', EACH)
@pytest.mark.parametrize(('q', 'd'), [(7.0, 0.0), (-11.0, 4.0), (0.0, 20.0)])
def test_force_is_the_sum_over_the_windings(winding: str, name: str, q: float, d: float) -> None:
    machine = machine_with(winding, **EACH[name])
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    for position in (0.0, 0.003, -0.0137, 0.4):
        expected = force_by_hand(winding, position, q, d, EACH[name])
        assert mean_force(machine, position, q, d) == pytest.approx(expected, rel=1e-7, abs=1e-7)
        state[0]['position'][0] = position
        found = motors.force_of_currents(state[0], parameters[0], 0, q, d)
        assert found == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_force_of_currents_of_a_perfect_motor_is_its_force_constant() -> None:
    for model in ('rigid', 'flexible'):
        machine = load_machine(model)
        parameters = machine.parameters()
        state = machine.initial_state(parameters, {'y_linear': 0.0123, 'x_rotate': 0.4})
        for place, motor in enumerate(machine.description.motors.values()):
            expected = 3.0 * motors.force_constant(motor)
            found = motors.force_of_currents(state[0], parameters[0], place, 3.0, 5.0)
            assert found == pytest.approx(expected, rel=1e-12)


def test_a_place_without_a_motor_makes_no_force() -> None:
    parameters = machine_with('wye').parameters()
    assert motors.force_at_angle(parameters[0], 2, 0.3, 5.0, 1.0) == 0.0


def test_saturation_current_is_where_the_force_is_root_half_of_the_linear_one() -> None:
    machine = machine_with('wye', saturation_current_a=9.0)
    parameters = machine.parameters()[0]
    linear = math.sqrt(3.0) / 2.0 * BACK_EMF
    assert motors.force_at_angle(parameters, 0, 0.7, 9.0, 0.0) == pytest.approx(
        linear * 9.0 / math.sqrt(2.0), rel=1e-12
    )
    assert motors.force_at_angle(parameters, 0, 0.7, 1e6, 0.0) == pytest.approx(
        linear * 9.0, rel=1e-9
    )


def reference_motion(winding: str, what: dict, voltage: np.ndarray, seconds: float):
    """
    Return (position, speed, winding currents) of the motor's equations by a general ODE solver.

    Written from Kirchhoff's laws: in a wye the potential of the star point is what makes the
    currents sum to zero, in a delta the windings lie between the terminals.
    """
    wye = winding == 'wye'
    r = RESISTANCE / 2 if wye else 1.5 * RESISTANCE
    inductance = INDUCTANCE / 2 if wye else 1.5 * INDUCTANCE
    k = BACK_EMF / math.sqrt(3.0) if wye else BACK_EMF
    scale = 1.0 + np.array([*what.get('phase_imbalance', (0.0, 0.0)), 0.0])
    lead = 0.0 if wye else math.pi / 6.0

    def rates(_, y):
        position, speed, current = y[0], y[1], y[2:]
        angle = 2.0 * math.pi * position / PITCH
        shape = k * scale * np.sin(angle + lead - 2.0 * math.pi / 3.0 * np.arange(3))
        shape = shape * factor_of_ripple(angle, what.get('ripple', []))
        if 'saturation_current_a' in what:
            line = current if wye else current - np.roll(current, 1)
            amplitude_squared = 2.0 / 3.0 * float(line @ line)
            shape = shape / math.sqrt(1.0 + amplitude_squared / what['saturation_current_a'] ** 2)
        emf = shape * speed
        if wye:
            star = (voltage - emf).mean()
            across = voltage - star
        else:
            across = voltage - np.roll(voltage, -1)
        return [
            speed,
            float(shape @ current) / MASS,
            *((across - emf - r * current) / inductance),
        ]

    solution = solve_ivp(
        rates, (0.0, seconds), np.zeros(5), method='DOP853', rtol=1e-11, atol=1e-12
    )
    return solution.y[0, -1], solution.y[1, -1], solution.y[2:, -1]


@pytest.mark.parametrize('winding', ['wye', 'delta'])
@pytest.mark.parametrize('name', EACH)
def test_motion_is_that_of_an_ode_solver(winding: str, name: str) -> None:
    """Constant voltages, 20 ms: about a fifth of a pole pitch; second order in the step."""
    voltage = np.zeros(9)
    voltage[:3] = [40.0, -35.0, -8.0]
    position, speed, current = reference_motion(winding, EACH[name], voltage[:3], 0.02)
    assert abs(position) > 1e-3
    errors = []
    for substeps in (2, 4):
        machine = machine_with(winding, substeps=substeps, **EACH[name])
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(360):
            plant.advance(state, parameters, voltage)
        s = state[0]
        assert s['position'][0] == pytest.approx(position, rel=2e-4)
        assert s['velocity'][0] == pytest.approx(speed, rel=2e-4)
        largest = np.abs(current).max()
        assert s['winding_current'][0] == pytest.approx(current, abs=2e-4 * largest)
        errors.append(abs(s['position'][0] - position) + 1e-12)
    assert errors[0] / errors[1] > 3.0


@pytest.mark.parametrize('winding', ['wye', 'delta'])
@pytest.mark.parametrize('name', EACH)
def test_energy_is_conserved_also_with_open_terminals(winding: str, name: str) -> None:
    """Supplied = copper + magnetic + kinetic; the bridge opens for a while in the middle."""
    machine = machine_with(winding, **EACH[name])
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    s = state[0]
    voltage = np.zeros(9)
    stored = np.zeros(4)
    for tick in range(6000):
        s['terminals_open'][0] = 3000 <= tick < 3500
        for phase in range(3):
            voltage[phase] = 40.0 * math.sin(0.002 * tick - 2.0 * math.pi / 3.0 * phase)
        plant.advance(state, parameters, voltage)
    plant.energy(state, parameters, stored)
    supplied = s['electrical_energy'][0]
    assert s['copper_loss'][0] > 0.5
    assert abs(supplied - s['copper_loss'][0] - stored.sum()) < 1e-9 * s['copper_loss'][0]


def test_imbalance_of_an_open_delta_brakes_by_the_current_in_the_triangle() -> None:
    """Held at constant speed: i = -(sum of EMFs) / (3 R) once settled, none in the lines."""
    machine = machine_with('delta', phase_imbalance=[0.3, 0.0])
    parameters = machine.parameters()
    parameters[0]['mass'][0] = 1e12
    parameters[0]['electrical_gain'][0] = 0.0  # the angle stays; the EMF is a direct voltage
    state = machine.initial_state(parameters)
    s = state[0]
    s['velocity'][0] = 0.1
    s['terminals_open'][0] = 1
    for _ in range(3000):
        plant.advance(state, parameters, np.zeros(9))
    emfs = BACK_EMF * 0.1 * np.array([1.3 * 0.5, -1.0, 0.5])
    expected = -emfs.sum() / (3 * 1.5 * RESISTANCE)
    assert s['winding_current'][0] == pytest.approx([expected] * 3, rel=1e-9)


@pytest.mark.parametrize('name', EACH)
def test_holding_current_holds_the_weight(name: str) -> None:
    """The run begins at rest: with the voltages of the holding currents nothing moves."""
    machine = machine_with('wye', gravity=9.81, **EACH[name])
    parameters = machine.parameters()
    weight = MASS * 9.81
    for position in (0.0, 0.0137):
        state = machine.initial_state(parameters, {'y_linear': position}, holding=True)
        angle = 2.0 * math.pi * position / PITCH
        current = statics.holding_currents(machine, parameters, {'y_linear': position})['y_linear']
        assert force_by_hand('wye', position, current, 0.0, EACH[name]) == pytest.approx(
            weight, rel=1e-10
        )
        voltage = np.zeros(9)
        voltage[:3] = RESISTANCE / 2 * lines(angle, current, 0.0)
        for _ in range(100):
            plant.advance(state, parameters, voltage)
        assert abs(state[0]['velocity'][0]) < 1e-9


def test_a_saturated_motor_that_cannot_hold_its_load_is_named() -> None:
    machine = machine_with('wye', gravity=9.81, saturation_current_a=0.1)
    with pytest.raises(UserError, match=r'y_linear.*saturat'):
        statics.holding_currents(machine, machine.parameters(), {'y_linear': 0.0})


def test_neutral_values_are_no_effect_at_all() -> None:
    neutral = {
        'saturation_current_a': 0.0,
        'ripple': [],
        'phase_imbalance': [0.0, 0.0],
    }
    ends = []
    for what in ({}, neutral):
        machine = machine_with('delta', **what)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(200):
            plant.advance(state, parameters, np.linspace(-30.0, 40.0, 9))
        ends.append((state.tobytes(), parameters.tobytes()))
    assert ends[0] == ends[1]


def test_effects_are_continuous_about_zero() -> None:
    """Half the parameter, half the change: each is linear near its neutral value."""

    def end(**fields) -> float:
        machine = machine_with('wye')
        parameters = machine.parameters()
        p = parameters[0]
        p['motor_imperfect'][0] = 1
        p['ripple_count'][0] = 1
        p['ripple_order'][0, 0] = 6.0
        for name, value in fields.items():
            p[name][0] = value
        state = machine.initial_state(parameters)
        voltage = np.zeros(9)
        voltage[:3] = [40.0, -35.0, -5.0]
        for _ in range(360):
            plant.advance(state, parameters, voltage)
        return state[0]['position'][0]

    neutral = end()
    for name, value in (
        ('saturation', 1e-5),
        ('phase_imbalance', [1e-4, 0.0]),
        ('ripple_cosine', [1e-4, 0.0, 0.0, 0.0]),
    ):
        full = end(**{name: value}) - neutral
        half = end(**{name: np.array(value) / 2}) - neutral
        assert abs(full) > 1e-9
        assert full / half == pytest.approx(2.0, rel=0.01), name


HEATING = {
    'state': 'warming',
    'winding_to_air_k_w': 0.5,
    'winding_capacity_j_k': 400.0,
    'air_degc': 20.0,
    'resistance_at_degc': 25.0,
    'resistance_rise_1_k': 0.00393,
}


def test_winding_starts_as_warm_as_the_description_says() -> None:
    machine = machine_with('wye', heating={**HEATING, 'winding_start_degc': 95.0})
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    assert state[0]['winding_temperature'][0] == 95.0
    assert motors.winding_resistance(state[0], parameters[0], 0) == pytest.approx(
        1.0 + 0.00393 * 70.0, rel=1e-12
    )
    machine = machine_with('wye', heating=HEATING)
    assert machine.initial_state(machine.parameters())[0]['winding_temperature'][0] == 20.0


@pytest.mark.parametrize(
    ('overlay', 'field', 'ratio'),
    [
        ({'back_emf_lead_to_lead_v_s_m': 1.1 * 127.0}, 'back_emf', 1.1),
        ({'resistance_lead_to_lead_ohm': 2.4}, 'resistance', 1.2),
        ({'inductance_lead_to_lead_h': 0.006}, 'inductance', 0.5),
        (
            {'heating': {'state': 'warming', 'winding_start_degc': 80.0}},
            'start_temperature',
            80.0 / 25.0,
        ),
    ],
)
def test_an_overlay_changes_each_value_of_a_motor(overlay, field: str, ratio: float) -> None:
    nominal = load_machine('rigid').parameters()[0]
    changed = load_machine('rigid', overlays=[{'motors': {'y_linear': overlay}}]).parameters()[0]
    assert changed[field][0] / nominal[field][0] == pytest.approx(ratio, rel=1e-12)
    assert np.array_equal(changed[field][1:], nominal[field][1:])
