# SPDX-License-Identifier: Apache-2.0
"""Room for more than a machine has: it is shared, grows in steps, and changes no bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_integrator import run

from waferbot_lockstep.layout import SHIPPED
from waferbot_plant import room
from waferbot_plant.plant import description_names, load_machine

OVERLAYS = (
    {},
    {'connections': {'gearbox': {'gap_rad': 1e-3}, 'cable': {'rope_mass_kg': 2.0}}},
    {'disturbances': {'wind': {'coordinate': 'y_linear', 'kind': 'constant', 'force_n': 3.0}}},
    {'dampers': {'air': {'coordinate': 'y_linear', 'damping_n_s_m': 3.0}}},
    {'motors': {'y_linear': {'ripple': [{'order': 6, 'cosine': 0.02}]}}},
    {'encoders': {'y_linear': {'noise_counts': 0.5}}},
)


@given(st.fixed_dictionaries({part: st.integers(0, 500) for part in room.STEPS}))
def test_room_is_the_least_number_of_whole_steps_that_all_fit_into(in_use: dict[str, int]) -> None:
    for part, length in room.lengths(in_use).items():
        step = room.STEPS[part]
        assert length % step == 0
        assert max(in_use[part], 1) <= length < max(in_use[part], 1) + step


def test_machines_of_the_package_with_as_many_places_share_one_compiled_code() -> None:
    """Whatever gives, rubs or is wrong in them."""
    loaded = [load_machine(name) for name in description_names()]
    assert {machine.description.name for machine in loaded if machine.layout != SHIPPED} == {
        'DFKI double pendulum C.1', 'PUMA 560', 'SCARA of four axes', 'UR10e base', 'UR10e elbow',
    }  # fmt: skip
    machines = [machine for machine in loaded if machine.layout == SHIPPED]
    machines += [load_machine('flexible', overlays=[overlay]) for overlay in OVERLAYS]
    machines += [load_machine('flexible', 'rigid')]
    assert len({len(machine.coordinates) for machine in machines}) > 4
    assert len({machine.parameter_dtype for machine in machines}) == 1
    assert len({machine.state_dtype for machine in machines}) == 1


@pytest.mark.slow
def test_room_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays just as long as what the machine has (compiled anew) give the same run."""
    found = []
    for steps in (room.STEPS, dict.fromkeys(room.STEPS, 1)):
        monkeypatch.setattr(room, 'STEPS', steps)
        machine = load_machine('flexible')
        parameters = machine.parameters()
        state = machine.initial_state(parameters, {}, holding=True)
        record = np.zeros((4000, len(machine.coordinates)))
        run(state, parameters, 4000, np.array([60.0, 60.0, 20.0]), record)
        found.append((machine.state_dtype, record))
    assert found[0][0] != found[1][0]
    assert np.abs(found[0][1]).max() > 0.05
    assert np.array_equal(found[0][1], found[1][1])
