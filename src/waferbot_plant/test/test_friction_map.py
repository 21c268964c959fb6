# SPDX-License-Identifier: Apache-2.0
"""A friction's map over load and speed: interpolation, constant speed, rest, energy, mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from test_friction_laws import MASS, NO_VOLTAGE, TICK, slide
from test_integrator import run

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, plant
from waferbot_plant.friction_laws import table_part
from waferbot_plant.plant import load_machine

SPEEDS = [0.0, 0.1, 0.5]
LOADS = [0.0, 10.0, 30.0]
ROWS = [[1.0, 0.5, 2.0], [2.0, 1.5, 2.5], [5.0, 4.0, 7.0]]
MAP = {'speed_m_s': SPEEDS, 'load_n': LOADS, 'force_n': ROWS}
OPEN_MOTOR = {
    'y_linear': {
        'coordinate': 'travel', 'winding': 'wye', 'electrical_cycle_m': 1e6,
        'resistance_lead_to_lead_ohm': 1e9, 'inductance_lead_to_lead_h': 1e3,
        'back_emf_lead_to_lead_v_s_m': 50.0,
    },
}  # fmt: skip
"""A motor with open terminals, for which a force from outside stands."""


def from_map(speed: float, load: float) -> float:
    """The map by scipy, held constant beyond its ends."""
    inside = [min(abs(load), LOADS[-1]), min(abs(speed), SPEEDS[-1])]
    return float(RegularGridInterpolator((LOADS, SPEEDS), np.array(ROWS))(inside)[0])


def loaded(force: float, against: float, friction: dict, speed: float):
    """The slide at a speed, pushed by a force of its motor and by another against it, N."""
    machine, parameters, state = slide(
        friction,
        motors=OPEN_MOTOR,
        disturbances={
            'against': {'kind': 'constant', 'coordinate': 'travel', 'force_n': -against}
        },
    )
    state[0]['terminals_open'][0] = 1
    state[0]['velocity'][0] = speed
    state[0]['external_force'][0] = force
    return machine, parameters, state


@given(speed=st.floats(0.0, 0.8), load=st.floats(0.0, 50.0))
def test_it_is_bilinear_as_scipy_has_it(speed: float, load: float) -> None:
    parameters = BILINEAR[0]
    assert table_part(parameters, 0, speed, load) == pytest.approx(
        from_map(speed, load), rel=1e-12
    )


BILINEAR = slide(MAP)[1]


@pytest.mark.parametrize('direction', [1.0, -1.0])
@pytest.mark.parametrize(
    ('speed', 'force'),
    [(0.1, 10.0), (0.3, 20.0), (0.05, 4.0), (0.05, -4.0), (0.4, -25.0), (0.8, 25.0), (0.3, 45.0)],
)
def test_at_constant_speed_and_load_the_loss_is_the_map(
    direction: float, speed: float, force: float
) -> None:
    """Driving and driven, on nodes, between and beyond: what the motor gives less T comes out."""
    loss = from_map(speed, force)
    motor, out = direction * force, direction * (force - loss)
    machine, parameters, state = loaded(motor, out, MAP, direction * speed)
    before = audit.books(machine, state, parameters)
    ticks = 400
    run(state, parameters, ticks, np.zeros(3), np.zeros((ticks, 1)))
    assert state[0]['velocity'][0] == pytest.approx(direction * speed, rel=1e-9)
    assert state[0]['friction_loss'][0] == pytest.approx(loss * speed * ticks * TICK, rel=1e-9)
    assert abs(audit.imbalance(before, audit.books(machine, state, parameters))) < 1e-9


@pytest.mark.parametrize('force', [0.0, 8.0, 20.0, 40.0])
def test_at_rest_its_first_column_at_the_load_holds_times_breakaway(force: float) -> None:
    limit = 1.5 * from_map(0.0, force)
    for share in (0.5, 0.999999):
        _, parameters, state = loaded(force, force - share * limit, {**MAP, 'breakaway': 1.5}, 0.0)
        run(state, parameters, 50, np.zeros(3), np.zeros((50, 1)))
        assert state[0]['velocity'][0] == 0.0
        assert state[0]['position'][0] == 0.0
    _, parameters, state = loaded(force, force - 1.001 * limit, {**MAP, 'breakaway': 1.5}, 0.0)
    plant.advance(state, parameters, NO_VOLTAGE)
    assert state[0]['velocity'][0] > 0.0


def test_the_other_laws_are_on_top_of_it() -> None:
    """Deceleration with drag, asymmetry, position and cold; with bristles their steady force."""
    speed, force = 0.3, 20.0
    laws = {
        'asymmetry': 0.2, 'position_amplitude': 0.5, 'period_m': 1e6, 'cold_amplitude': 0.4,
        'cold_time_s': 1e6, 'drag': {'force_n': 3.0, 'at_speed_m_s': 0.3}, 'per_motor_force': 0.1,
    }  # fmt: skip
    limit = (from_map(speed, force) + 3.0 + 0.1 * force) * 1.5 * 1.4 * 1.2
    _, parameters, state = loaded(force, force, {**MAP, **laws}, speed)
    plant.advance(state, parameters, NO_VOLTAGE)
    assert speed - state[0]['velocity'][0] == pytest.approx(limit / MASS * TICK, rel=1e-3)
    bristles = {**MAP, 'presliding': {'stiffness_n_m': 1e6, 'damping_n_s_m': 10.0}}
    loss = from_map(speed, force)
    _, parameters, state = loaded(force, force - loss, bristles, speed)
    state[0]['bristle'][0] = loss / 1e6
    run(state, parameters, 1800, np.zeros(3), np.zeros((1800, 1)))
    assert state[0]['velocity'][0] == pytest.approx(speed, rel=1e-9)


@pytest.mark.parametrize('breakaway', [1.0, 1.4])
def test_a_map_that_is_constant_in_load_is_the_table_to_the_bit(breakaway: float) -> None:
    """On the rigid machine, through a gear, sliding and sticking."""
    speeds, row = [0.0, 1.0, 9.0], [0.05, 0.02, 0.04]
    found = []
    for more in ({'torque_nm': row}, {'load_nm': [0.0, 0.5, 3.0], 'torque_nm': [row] * 3}):
        gears = {
            'coordinate': 'y_rotate_motor', 'speed_rad_s': speeds, 'breakaway': breakaway, **more
        }  # fmt: skip
        machine = load_machine('rigid', overlays=[{'frictions': {'gears': gears}}])
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        record = []
        for tick in range(2000):
            plant.advance(state, parameters, 8.0 * np.sin(5e-3 * tick * np.arange(1, 10)))
            record.append(
                [*state[0]['position'], *state[0]['velocity'], *state[0]['friction_loss']]
            )
        found.append(np.array(record))
    assert np.array_equal(*found)
    assert np.abs(found[0]).max() > 1e-3


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'load_n': [0.0, 10.0]}, r'.guide.force_n: 2 loads but 3 rows'),
        ({'load_n': [1.0, 10.0, 30.0]}, r'.guide.load_n: loads must rise from 0; they are \[1'),
        ({'load_n': [0.0, 10.0, 10.0]}, r'.guide.load_n: loads must rise from 0'),
        ({'speed_m_s': [0.0, 0.5, 0.1]}, r'.guide: speeds must rise from 0'),
        ({'force_n': [[1.0, 1.0, 1.0], [1.0, 1.0], [1.0, 1.0, 1.0]]},
         r'.guide.force_n\[1\]: 3 speeds but 2 values'),
        ({'force_n': [[1.0, 1.0, 1.0], 2.0, [1.0, 1.0, 1.0]]},
         r'.guide.force_n\[1\]: is 2.0; with loads it is a row'),
        ({'force_n': [1.0, 1.0, 1.0]}, r'.guide.force_n\[0\]: is 1.0; with loads it is a row'),
        ({'force_n': [[1.0, -0.5, 1.0]] * 3},
         r'.guide.force_n\[0\]\[1\]: is -0.5; it must be at least 0'),
        ({'load_n': [-1.0, 0.0, 1.0]}, r'.guide.load_n\[0\]: is -1.0; it must be at least 0'),
        ({'load_n': list(range(9))}, r'.guide.load_n: .*at most 8 entries'),
        ({'load_nm': LOADS}, r'.guide.load_nm: wrong unit.*give load_n'),
    ],
)  # fmt: skip
def test_mistakes_are_named(change: dict, message: str) -> None:
    with pytest.raises(UserError, match=rf'machine_\d+.yaml, line \d+: frictions{message}'):
        slide({**MAP, **change})


def test_rows_need_loads_and_parts_have_none() -> None:
    with pytest.raises(
        UserError, match=r'frictions.guide.force_n: rows are for loads: give load_n'
    ):
        slide({'speed_m_s': SPEEDS, 'force_n': ROWS})
    with pytest.raises(UserError, match=r'frictions.gearbox.load_nm: the friction of a part'):
        load_machine('flexible', overlays=[{'frictions': {'gearbox': {'load_nm': [0.0]}}}])


def test_a_factor_is_on_all_of_it() -> None:
    machine, _, _ = slide({**MAP, 'factor': 2.0})
    friction = machine.description.frictions['guide']
    assert np.array_equal(friction.resistances, 2.0 * np.array(ROWS))
    assert np.array_equal(friction.loads, LOADS)
