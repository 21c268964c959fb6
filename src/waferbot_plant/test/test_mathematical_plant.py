# SPDX-License-Identifier: Apache-2.0
"""The two derivations of the rigid plant against each other."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import lagrange, plant, verification
from waferbot_plant.plant import load_machine


def test_both_plants_agree_over_random_machines_states_and_forces() -> None:
    """1000 draws; masses, centres of gravity, tensors, rotor and lever arms all random."""
    seed = 20240607
    print('seed', seed)
    random = np.random.default_rng(seed)
    worst = 0.0
    expected, found = np.zeros(3), np.zeros(3)
    for _ in range(40):
        bodies = {}
        for name in load_machine('rigid').description.bodies:
            spread = random.normal(0.0, 0.15, (6, 3))
            weights = random.uniform(0.2, 3.0, 6)
            spread -= weights @ spread / weights.sum()
            tensor = sum(
                w * (s @ s * np.eye(3) - np.outer(s, s))
                for w, s in zip(weights, spread, strict=True)
            )
            bodies[name] = {
                'mass_kg': float(weights.sum()),
                'centre_of_gravity_m': random.uniform(-0.5, 0.5, 3).tolist(),
                'inertia_kg_m2': {
                    axes: float(tensor['xyz'.index(axes[0]), 'xyz'.index(axes[1])])
                    for axes in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')
                },
            }
        overlay = {
            'bodies': bodies,
            'rotors': {'y_rotate_motor': {'inertia_kg_m2': float(random.uniform(1e-5, 1e-3))}},
            'connections': None,
            'frictions': None,
            'parts': None,
            'joints': {
                'payload_guide': {'freedoms': {f'payload_bearing_{axis}': None for axis in 'xyz'}},
                'counterweight_guide': {
                    'freedoms': {f'counterweight_bearing_{axis}': None for axis in 'xyz'}
                },
                'x_rotate': {
                    'freedoms': {f'x_rotate_bearing_{axis}': None for axis in ('radial', 'y', 'z')}
                },
                'x_rotate_shaft': {'freedoms': {'x_rotate_shaft_torsion': None}},
                'y_rotate': {'at_m': [float(random.uniform(0.1, 0.5)), 0, float(random.normal())]},
            },
            'transmissions': {
                'cable': {'stages': [{'kind': 'cable'}]},
                'y_rotate_drive': {
                    'stages': [{'kind': 'gear', 'ratio': float(random.uniform(2, 60))}]
                },
            },
        }
        machine = load_machine('machine', overlays=[overlay])
        record = verification.mathematical_parameters(machine.description)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(25):
            position = random.uniform(-3.0, 3.0, 3)
            velocity = random.normal(0.0, [1.0, 4.0, 4.0])
            force = random.normal(0.0, [500.0, 50.0, 50.0])
            state[0]['position'], state[0]['velocity'] = position, velocity
            plant.acceleration(state, parameters, force, found)
            lagrange.forward_dynamics(position, velocity, force, record, expected)
            worst = max(worst, np.abs(found - expected).max() / np.abs(expected).max())
    print('worst relative difference', worst)
    assert worst < 1e-9


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
