# SPDX-License-Identifier: Apache-2.0
"""The two derivations of the rigid plant against each other."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, plant, verification
from waferbot_plant.plant import load_machine


def test_both_plants_agree_over_random_machines_states_and_forces() -> None:
    """1000 draws; masses, centres of gravity, tensors, rotor and lever arms all random."""
    seed = 20240607
    print('seed', seed)
    worst = verification.random_agreement(seed, machines=40, states=25)
    print('worst relative difference', worst)
    assert 0.0 < worst < 1e-9


def test_a_difference_between_the_plants_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one mass wrong by a millionth in one of the two, the comparison says so."""
    sound = verification.mathematical_parameters

    def wrong(description):
        record = sound(description)
        record[0]['carriage_mass'] *= 1.0 + 1e-6
        return record

    monkeypatch.setattr(verification, 'mathematical_parameters', wrong)
    assert verification.random_agreement(1, machines=2, states=3) > 1e-9
    differences = verification.open_loop_differences(load_machine('rigid'))
    assert differences['y_linear'] > 1e-6


@pytest.mark.parametrize(
    'model', ['rigid', pytest.param('simplified', marks=pytest.mark.slow), 'flexible']
)
def test_energy_is_accounted_for(model: str) -> None:
    machine = load_machine(model)
    assert abs(verification.energy_imbalance(machine, 1800)) < 1e-8
    once, twice = (verification.lossless_drift(machine, substeps, 0.1) for substeps in (1, 2))
    assert once < 1e-6
    assert twice == pytest.approx(once / 4.0, rel=0.3)


def test_rigid_model_of_chapter_4_loses_energy_in_copper_only() -> None:
    machine = load_machine('rigid')
    assert not machine.description.frictions
    assert not machine.description.dampers
    assert not machine.assembly.springs
    assert not machine.assembly.cables
    parameters = machine.parameters()
    state = machine.initial_state(parameters, holding=True)
    state[0]['velocity'][:3] = 0.1, 0.0, 1.0
    for _ in range(900):
        plant.advance(state, parameters, np.zeros(9))
    lost = audit.books(machine, state, parameters).lost
    assert {name.split()[-1] for name in lost} == {'copper'}


def test_open_loop_of_chapter_3() -> None:
    differences = verification.open_loop_differences(load_machine('rigid'))
    print('differences, %', differences)
    for axis, limit in verification.THESIS_DIFFERENCE_PERCENT.items():
        assert differences[axis] < 1e-6 * limit


def test_other_machines_have_no_mathematical_plant() -> None:
    for name in ('planar_two_link_arm', 'single_mass'):
        with pytest.raises(UserError, match='three-axis machine'):
            verification.mathematical_parameters(load_machine(name).description)
    with pytest.raises(UserError, match='rigid model'):
        verification.open_loop_differences(load_machine('flexible'))
