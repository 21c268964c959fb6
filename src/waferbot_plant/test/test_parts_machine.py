# SPDX-License-Identifier: Apache-2.0
"""The shipped part data: Table 6.7 by hand from the parts, plausibility, provenance, the page."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from waferbot_plant import modes, parameters_page
from waferbot_plant.parts import (
    belt,
    cable,
    cross_roller_bearing,
    gearbox,
    linear_bearing,
    shaft,
)
from waferbot_plant.plant import config_folder, load_machine

MACHINE = load_machine('machine').description
PARTS, BODIES = MACHINE.parts, MACHINE.bodies
LOAD = ('x_rotate_rotor', 'x_rotate_load', 'y_rotate_load')
PAYLOAD = ('carriage', 'x_rotate_stator_part', *LOAD)


def mass(*names: str) -> float:
    return sum(BODIES[name].mass for name in names)


def moment(axis: int, at: np.ndarray, *names: str) -> float:
    """Return the first moment of bodies along an axis, kg m."""
    return sum(BODIES[name].mass * (BODIES[name].centre_of_gravity - at)[axis] for name in names)


def inertia(axis: int, at: np.ndarray, *names: str) -> float:
    """Return the moment of inertia about an axis through `at` (Huygens-Steiner), kg m2."""
    total = 0.0
    for name in names:
        arm = BODIES[name].centre_of_gravity - at
        total += BODIES[name].inertia[axis, axis]
        total += BODIES[name].mass * (arm @ arm - arm[axis] ** 2)
    return total


def free_pair(stiffness: float, first: float, second: float) -> float:
    return math.sqrt(stiffness * (1.0 / first + 1.0 / second))


def rows_by_hand() -> dict[str, float]:
    """Return the rows of Table 6.7, Hz, straight from parts and bodies: chapter 5's formulas."""
    joints = MACHINE.joints
    payload_at, counterweight_at = joints['payload_guide'].at, joints['counterweight_guide'].at
    bearing_at = joints['x_rotate'].at
    guides = {}
    for name, at, carried in (
        ('payload', payload_at, PAYLOAD),
        ('counterweight', counterweight_at, ('counterweight',)),
    ):
        part = PARTS[f'{name}_bearing']
        block = linear_bearing.static_block_load(
            mass(*carried),
            moment(0, at, *carried) / mass(*carried),
            moment(2, at, *carried) / mass(*carried),
            part.vertical_spacing_m,
        )
        guides[name] = linear_bearing.moment_stiffness(part, block)
    ring = cross_roller_bearing.stiffness(
        PARTS['x_rotate_bearing'],
        cross_roller_bearing.static_load(mass(*LOAD), moment(0, bearing_at, *LOAD) / mass(*LOAD)),
    )
    rotor = BODIES['x_rotate_rotor'].inertia[0, 0]
    beyond_shaft = inertia(0, bearing_at, 'x_rotate_load', 'y_rotate_load')
    drive = PARTS['gearbox'].ratio * PARTS['belt'].ratio
    motor = sum(item.inertia for item in MACHINE.rotors.values()) * drive**2
    y_load = inertia(1, joints['y_rotate'].at, 'y_rotate_load')
    soft = belt.drive_stiffness_nm_per_rad(
        PARTS['belt'], gearbox.torsional_stiffness_nm_per_rad(PARTS['gearbox'])
    )
    still = ('carriage', 'x_rotate_stator_part')
    squares = {
        'counterweight_bearing_x': guides['counterweight'].about_x_nm_per_rad
        / inertia(0, counterweight_at, 'counterweight'),
        'counterweight_bearing_y': guides['counterweight'].about_y_nm_per_rad
        / inertia(1, counterweight_at, 'counterweight'),
        'counterweight_bearing_z': guides['counterweight'].about_z_nm_per_rad
        / inertia(2, counterweight_at, 'counterweight'),
        'payload_bearing_x': guides['payload'].about_x_nm_per_rad / inertia(0, payload_at, *still),
        'payload_bearing_y': guides['payload'].about_y_nm_per_rad
        / inertia(1, payload_at, *PAYLOAD),
        'payload_bearing_z': guides['payload'].about_z_nm_per_rad
        / inertia(2, payload_at, *PAYLOAD),
        'x_rotate_bearing_radial': ring.radial_y_n_per_m / mass(*LOAD),
        'x_rotate_bearing_y': ring.about_y_nm_per_rad / inertia(1, bearing_at, *LOAD),
        'x_rotate_bearing_z': ring.about_z_nm_per_rad / inertia(2, bearing_at, *LOAD),
        'x_rotate_shaft_bending': shaft.bending_stiffness_n_per_m(PARTS['x_rotate_shaft'])
        / mass(*LOAD),
    }
    rows = {name: math.sqrt(square) for name, square in squares.items()}
    rows['cable'] = free_pair(
        cable.effective_stiffness_n_per_m(PARTS['cable']), mass(*PAYLOAD), mass('counterweight')
    )
    rows['x_rotate_shaft_torsion'] = free_pair(
        shaft.torsional_stiffness_nm_per_rad(PARTS['x_rotate_shaft']), beyond_shaft, rotor
    )
    rows['gearbox'] = rows['belt'] = free_pair(soft, motor, y_load)
    return {name: row / (2.0 * math.pi) for name, row in rows.items()}


def test_first_frequencies_by_hand() -> None:
    """The assembled mechanism gives what the formulas give, part by part."""
    found = modes.first_frequencies(MACHINE)
    expected = rows_by_hand()
    assert set(found) == set(expected)
    for name, frequency in expected.items():
        assert found[name] == pytest.approx(frequency, rel=1e-4), name


def test_frequencies_follow_from_part_data() -> None:
    """Change the parts; the frequencies move by the powers that the equations say."""
    before = modes.first_frequencies(MACHINE)

    def after(**parts) -> dict[str, float]:
        return modes.first_frequencies(
            load_machine('machine', overlays=[{'parts': parts}]).description
        )

    thick = after(cable={'nominal_diameter_m': 2.0 * PARTS['cable'].nominal_diameter_m})
    assert thick['cable'] == pytest.approx(2.0 * before['cable'], rel=1e-12)
    long = after(x_rotate_shaft={'length_m': 4.0 * PARTS['x_rotate_shaft'].length_m})
    for name, factor in (('x_rotate_shaft_torsion', 2.0), ('x_rotate_shaft_bending', 8.0)):
        assert long[name] * factor == pytest.approx(before[name], rel=1e-12)
    spacing = 2.0 * PARTS['payload_bearing'].horizontal_spacing_m
    wide = after(payload_bearing={'horizontal_spacing_m': spacing})
    assert wide['payload_bearing_y'] == pytest.approx(2.0 * before['payload_bearing_y'], rel=1e-12)


@pytest.mark.parametrize('name', ['payload', 'counterweight'])
def test_guides_lie_in_the_range_of_real_ones(name: str) -> None:
    bearing = PARTS[f'{name}_bearing']
    carried = PAYLOAD if name == 'payload' else (name,)
    at = MACHINE.joints[f'{name}_guide'].at
    load = linear_bearing.static_block_load(
        mass(*carried),
        moment(0, at, *carried) / mass(*carried),
        moment(2, at, *carried) / mass(*carried),
        bearing.vertical_spacing_m,
    )
    radial = bearing.radial.curve('radial').secant_over_range(load.radial_n, 0.25)
    reverse = bearing.reverse.curve('reverse').secant_over_range(load.radial_n, 0.25)
    transverse = bearing.transverse.curve('transverse').secant_over_range(load.transverse_n, 0.25)
    assert 130e6 <= radial <= 300e6
    assert 0.8 <= reverse / radial <= 1.0
    assert 0.5 <= transverse / radial <= 0.71


def test_improved_damping_is_what_the_thesis_raised() -> None:
    calculated = load_machine('machine', damping='calculated').description
    improved = load_machine('machine', damping='improved').description
    ratios = {
        name: improved.connections[name].loss_factor / part.loss_factor
        for name, part in calculated.connections.items()
        if part.loss_factor
    }
    for name, ratio in ratios.items():
        bearing = 20.0 if name.startswith('x_rotate_bearing') else 2.5
        assert ratio == pytest.approx(bearing if 'bearing' in name else 1.0), name
    for name, friction in calculated.frictions.items():
        raised = 11.6 if name in ('y_rotate_lip_seal', 'y_rotate_bearings') else 1.0
        found = improved.frictions[name].resistances / friction.resistances
        assert found == pytest.approx(raised), name
    assert modes.first_frequencies(improved) == modes.first_frequencies(calculated)


def test_frictions_by_hand() -> None:
    """Guides (with their seals) at their loads; the seal's drag at the speed it is stated at."""
    gravity = 9.80665
    at = MACHINE.joints['payload_guide'].at
    guide = PARTS['payload_bearing']
    normal = gravity * (abs(moment(0, at, *PAYLOAD)) + abs(moment(2, at, *PAYLOAD)))
    normal *= 4.0 / (2.0 * guide.vertical_spacing_m)
    expected = guide.friction_coefficient * normal + 4.0 * guide.seal_force_per_block_n
    assert MACHINE.frictions['payload_guide'].resistances[0] == pytest.approx(expected, rel=1e-12)
    ring, bearing_at = PARTS['x_rotate_bearing'], MACHINE.joints['x_rotate'].at
    at_rest = gravity * (mass(*LOAD) * ring.pitch_diameter_m / 2 + moment(0, bearing_at, *LOAD))
    at_rest *= ring.friction_coefficient
    dry = MACHINE.frictions['x_rotate_seal_and_bearing'].resistances[0]
    assert dry == pytest.approx(at_rest, rel=1e-12)
    seal = PARTS['ferrofluid_seal']
    viscous = MACHINE.dampers['x_rotate_seal_and_bearing'].damping
    assert dry + viscous * seal.drag_speed_rad_per_s == pytest.approx(seal.drag_torque_nm)


def quantities(data, key=()):
    """Yield every number of the file that is one of the machine, with its key."""
    if isinstance(data, dict) and 'from' not in data:
        for name, value in data.items():
            if name not in ('axis', 'freedoms'):
                yield from quantities(value, (*key, name))
    elif isinstance(data, dict) or not isinstance(data, (str, bool, list)):
        yield '.'.join(map(str, key)), data


def test_every_value_has_its_provenance() -> None:
    known = re.compile(r'(thesis|catalogue-typical: |chosen: |calibrated: )')
    data = yaml.safe_load((config_folder() / 'machine.yaml').read_text('utf-8'))
    found = list(quantities(data))
    assert len(found) > 80
    for name, value in found:
        assert isinstance(value, dict), name
        assert known.match(value['from']), name


def test_the_page_of_parameters_is_that_of_the_description() -> None:
    """If this fails: python -m waferbot_plant.parameters_page docs/parameters.md."""
    page = (Path(__file__).parents[3] / 'docs' / 'parameters.md').read_text('utf-8')
    assert parameters_page.renewed(page) == page
    for name, frequency in rows_by_hand().items():
        row = next(line for line in page.splitlines() if re.match(rf'\|[^|]*\b{name}\b', line))
        assert float(row.split('|')[3]) == pytest.approx(frequency, rel=1e-3), name


def test_teeth_of_the_belt_can_give(tmp_path: Path) -> None:
    """A description that states the stiffness of a tooth has a softer drive, (5.33) in series."""
    tooth = 3.0e5
    own = tmp_path / 'soft_teeth.yaml'
    part = {
        'belt': {'tooth_stiffness_n_per_m': {'value': tooth, 'from': 'a finite-element model'}}
    }
    own.write_text(
        yaml.safe_dump({'extends': str(config_folder() / 'machine.yaml'), 'parts': part}), 'utf-8'
    )
    soft = load_machine(str(own)).description
    cords = MACHINE.connections['belt'].stiffness
    teeth = [belt.teeth_in_mesh(PARTS['belt'], driven) for driven in (False, True)]
    expected = 1.0 / (1.0 / cords + sum(1.0 / (number * tooth) for number in teeth))
    assert soft.connections['belt'].stiffness == pytest.approx(expected, rel=1e-9)
    assert modes.first_frequencies(soft)['belt'] < modes.first_frequencies(MACHINE)['belt']
