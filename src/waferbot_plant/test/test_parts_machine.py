# SPDX-License-Identifier: Apache-2.0
"""The shipped part data: Table 6.7, plausibility of the parts, loads at a pose, reading errors."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts import belt, cable, gearbox, linear_bearing
from waferbot_plant.parts.bodies import inertia_about_kg_m2
from waferbot_plant.parts.machine_parts import (
    element_frequencies,
    frictions,
    read_machine_parts,
    static_loads,
)

PARTS_FILE = Path(__file__).parents[1] / 'config' / 'parts.yaml'
PARTS = read_machine_parts(PARTS_FILE)

TABLE_6_7 = {
    'cable': 37.44,
    'counterweight bearing, about x': 265.29,
    'counterweight bearing, about y': 197.25,
    'counterweight bearing, about z': 140.58,
    'payload bearing, about x': 1179.05,
    'payload bearing, about y': 254.36,
    'payload bearing, about z': 235.70,
    'x_rotate bearing, radial y': 433.18,
    'x_rotate bearing, about y': 77.35,
    'x_rotate bearing, about z': 76.28,
    'x_rotate shaft, torsion': 1629.27,
    'x_rotate shaft, bending': 349.86,
    'y_rotate gearbox and belt': 19.74,
}
ROWS = {row.element: row for row in element_frequencies(PARTS)}


def test_rows_are_those_of_the_table_in_its_order():
    assert list(ROWS) == list(TABLE_6_7)


@pytest.mark.parametrize('element', TABLE_6_7)
def test_frequency_of_table_6_7(element):
    assert ROWS[element].frequency_hz == pytest.approx(TABLE_6_7[element], rel=1e-3)


def test_the_ten_times_bandwidth_rule_removes_what_the_thesis_removes():
    stiff = {name for name, row in ROWS.items() if row.frequency_hz > 300.0}
    assert stiff == {
        'payload bearing, about x',
        'x_rotate bearing, radial y',
        'x_rotate shaft, torsion',
        'x_rotate shaft, bending',
    }


def test_masses_are_those_of_the_thesis_assumption():
    bodies = PARTS.bodies
    assert sum(body.mass_kg for body in bodies.payload) == pytest.approx(40.0)
    assert bodies.counterweight.mass_kg == pytest.approx(40.0)


def test_inertias_are_those_of_the_machine():
    about_x = inertia_about_kg_m2(PARTS.bodies.on_x_rotate, (0.0, 0.0, 0.0))[0]
    assert 0.6 <= about_x + PARTS.rotors.x_rotate_kg_m2 <= 0.851
    assert 0.15 <= PARTS.y_rotate_inertia_kg_m2 <= 0.3
    static_moment = sum(
        body.mass_kg * body.centre_of_gravity_m[2] for body in PARTS.bodies.on_x_rotate
    )
    assert static_moment == pytest.approx(2.46, rel=1e-3)
    assert PARTS.gearbox.ratio * PARTS.belt.ratio == pytest.approx(48.0)


@pytest.mark.parametrize('name', ['payload_bearing', 'counterweight_bearing'])
def test_guides_lie_in_the_range_of_real_ones(name):
    bearing = getattr(PARTS, name)
    load = getattr(static_loads(PARTS), name.replace('bearing', 'block'))
    radial = bearing.radial.curve('radial').secant_over_range(load.radial_n, 0.25)
    reverse = bearing.reverse.curve('reverse').secant_over_range(load.radial_n, 0.25)
    transverse = bearing.transverse.curve('transverse').secant_over_range(load.transverse_n, 0.25)
    assert 130e6 <= radial <= 300e6
    assert 0.8 <= reverse / radial <= 1.0
    assert 0.5 <= transverse / radial <= 0.71


def test_frequencies_follow_from_part_data():
    """Change the parts; the frequencies move by the powers that the equations say."""

    def frequency(parts, element):
        return {row.element: row.frequency_hz for row in element_frequencies(parts)}[element]

    thick = dataclasses.replace(PARTS.cable, nominal_diameter_m=0.0064)
    assert frequency(dataclasses.replace(PARTS, cable=thick), 'cable') == pytest.approx(
        2.0 * ROWS['cable'].frequency_hz, rel=1e-12
    )
    long = dataclasses.replace(PARTS.x_rotate_shaft, length_m=4 * PARTS.x_rotate_shaft.length_m)
    slender = dataclasses.replace(PARTS, x_rotate_shaft=long)
    for element, factor in (('x_rotate shaft, torsion', 2.0), ('x_rotate shaft, bending', 8.0)):
        assert frequency(slender, element) * factor == pytest.approx(
            ROWS[element].frequency_hz, rel=1e-12
        )
    wide = dataclasses.replace(PARTS.payload_bearing, horizontal_spacing_m=2 * 0.2013)
    assert frequency(
        dataclasses.replace(PARTS, payload_bearing=wide), 'payload bearing, about y'
    ) == pytest.approx(2.0 * ROWS['payload bearing, about y'].frequency_hz, rel=1e-12)


def test_rows_by_hand():
    """Some rows straight from the data, without the row-building code."""
    stiffness = cable.effective_stiffness_n_per_m(PARTS.cable)
    assert ROWS['cable'].frequency_hz == pytest.approx(
        math.sqrt(2.0 * stiffness / 40.0) / (2.0 * math.pi), rel=1e-12
    )
    drive = belt.drive_frequency(
        PARTS.belt,
        gearbox.torsional_stiffness_nm_per_rad(PARTS.gearbox),
        256.0 * (PARTS.rotors.y_rotate_kg_m2 + 1.3e-5),
        0.12 + 9.5 * 0.1034**2,
    )
    assert ROWS['y_rotate gearbox and belt'].frequency_hz * 2 * math.pi == pytest.approx(
        drive, rel=1e-12
    )
    load = static_loads(PARTS).payload_block
    kappa = linear_bearing.moment_stiffness(PARTS.payload_bearing, load).about_x_nm_per_rad
    carriage_and_stator = 0.0215 + 0.0737
    assert ROWS['payload bearing, about x'].frequency_hz == pytest.approx(
        math.sqrt(kappa / carriage_and_stator) / (2 * math.pi), rel=1e-12
    )


def test_static_loads_at_a_pose_by_hand():
    gravity = 9.80665
    home = static_loads(PARTS)
    moment = 3.1 * 0.02 + 13.1 * 0.18 + 14.3 * 0.2269 + 9.5 * 0.36
    assert home.payload_block.radial_n == pytest.approx(gravity * moment / (2 * 0.19), rel=1e-12)
    assert home.payload_block.transverse_n == pytest.approx(
        gravity * (14.3 * 0.1033 + 9.5 * 0.1034) / (2 * 0.19), rel=1e-12
    )
    assert home.counterweight_block.radial_n == pytest.approx(40 * gravity * 0.135 / 0.148)
    overhang = 14.3 * (0.2269 - 0.2) + 9.5 * (0.36 - 0.2)
    assert home.x_rotate_bearing.moment_nm == pytest.approx(gravity * overhang, rel=1e-12)

    hanging = static_loads(PARTS, x_rotate_rad=math.pi / 2)
    assert hanging.payload_block.transverse_n == pytest.approx(0.0, abs=1e-9)
    assert hanging.payload_block.radial_n == pytest.approx(home.payload_block.radial_n)

    reached = static_loads(PARTS, y_rotate_rad=math.pi / 2)
    assert reached.x_rotate_bearing.moment_nm == pytest.approx(
        gravity * (overhang + 9.5 * 0.1034), rel=1e-12
    )
    assert reached.payload_block.transverse_n == pytest.approx(
        gravity * 14.3 * 0.1033 / (2 * 0.19), rel=1e-12
    )


def test_improved_damping_is_what_the_thesis_raised():
    improved = read_machine_parts(PARTS_FILE, 'improved')
    for name, factor in (
        ('payload_bearing', 2.5),
        ('counterweight_bearing', 2.5),
        ('x_rotate_bearing', 20.0),
    ):
        ratio = getattr(improved, name).loss_factor / getattr(PARTS, name).loss_factor
        assert ratio == pytest.approx(factor)
    ratio = frictions(improved).y_rotate_output_nm / frictions(PARTS).y_rotate_output_nm
    assert ratio == pytest.approx(11.6)
    assert element_frequencies(improved) == element_frequencies(PARTS)


def test_frictions_by_hand():
    found = frictions(PARTS)
    load = static_loads(PARTS)
    normal = 4 * (load.payload_block.radial_n + load.payload_block.transverse_n)
    assert found.payload_guide_n == pytest.approx(0.003 * normal + 4 * 1.5, rel=1e-12)
    bearing = load.x_rotate_bearing
    assert found.x_rotate.coulomb_nm == pytest.approx(
        0.01 * (bearing.radial_n * 0.101 / 2 + bearing.moment_nm), rel=1e-12
    )
    assert found.x_rotate.torque_nm(6.283) == pytest.approx(0.5, rel=1e-12)
    assert 0.048 < found.y_rotate_output_nm < 0.1


def leaves(data, key=()):
    """Yield every quantity of the file with its key."""
    if isinstance(data, dict) and 'from' not in data:
        for name, value in data.items():
            yield from leaves(value, (*key, name))
    else:
        yield '.'.join(key), data


def test_every_value_has_its_provenance():
    known = re.compile(r'(thesis|catalogue-typical: |chosen: |calibrated: )')
    for name, leaf in leaves(yaml.safe_load(PARTS_FILE.read_text('utf-8'))):
        assert isinstance(leaf, dict), name
        assert known.match(leaf['from']), name


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        (
            'nominal_diameter_m: {value: 0.0032',
            'nominal_diameter_m: {value: -0.0032',
            'cable: nominal_diameter_m is -0.0032',
        ),
        ('  width_m:', '  widht_m:', 'belt.widht_m: unknown key; choose from .*width_m'),
        (
            '  number_of_cables: {value: 2, from: thesis}\n',
            '',
            'cable: the key number_of_cables is missing',
        ),
        ('value: 1.9093', 'value: long', "cable.cable_length_m: 'long' is not a number"),
        ('value: 1.9093', 'value: [1, 2]', 'cable.cable_length_m: is a list'),
        ('value: 1.9093', 'valeu: 1.9093', 'cable.cable_length_m: write a number'),
        ('[0.2, 0.0, 0.0]', '[0.2, 0.0]', 'x_rotate_bearing_m: give a list of numbers'),
        ('[0.2, 0.0, 0.0]', '[0.2, 0.1, 0.0]', 'lies on the X-Rotate axis'),
        ('0.484, 0.968', '0.968, 0.484', 'deflection .* follows'),
    ],
)
def test_reading_errors_name_file_line_and_key(tmp_path, old, new, message):
    text = PARTS_FILE.read_text('utf-8')
    assert old in text
    broken = tmp_path / 'broken.yaml'
    broken.write_text(text.replace(old, new, 1), 'utf-8')
    with pytest.raises(UserError, match=message) as caught:
        read_machine_parts(broken)
    assert re.match(rf'{re.escape(str(broken))}:\d+: ', str(caught.value))


def test_unknown_damping_is_refused():
    with pytest.raises(UserError, match="damping is 'measured'"):
        read_machine_parts(PARTS_FILE, 'measured')


def test_the_page_of_parameters_tells_the_computed_frequencies():
    """The table in the docs is read back and compared to what the part data give."""
    page = (Path(__file__).parents[3] / 'docs' / 'parameters.md').read_text('utf-8')
    for element, row in ROWS.items():
        line = next(line for line in page.splitlines() if line.startswith(f'| {element} |'))
        cells = [cell.strip() for cell in line.strip('|').split('|')]
        assert float(cells[1]) == TABLE_6_7[element]
        assert cells[2] == f'{row.frequency_hz:.2f}'
        assert cells[3] == f'{100.0 * (row.frequency_hz / TABLE_6_7[element] - 1.0):+.3f}'
        assert cells[4].split()[0] == f'{row.stiffness:.4g}'
        assert cells[5].split()[0] == f'{row.inertia:.4g}'
