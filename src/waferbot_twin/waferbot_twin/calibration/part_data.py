# SPDX-License-Identifier: Apache-2.0
"""The data of parts that make a candidate's stiffnesses and frictions."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from waferbot_lockstep.marked_yaml import Document, merge
from waferbot_plant.description import Description
from waferbot_plant.description_file import check
from waferbot_plant.modes import first_frequencies
from waferbot_twin.calibration.machines import machine_file, payload_overlay, rounded
from waferbot_twin.thesis import thesis

PART_ROUNDS = 12

_MOVED = 'calibrated: the steps of Tables 4.1 to 4.3, 6.1, 6.3, 6.5'
CALIBRATED_PARTS = {
    ('cable', 'cable_length_m'): 'calibrated: cable; stroke and height of the machine, 1.5 to 3 m',
    ('payload_bearing', 'vertical_spacing_m'): 'calibrated: payload bearing about z',
    ('payload_bearing', 'horizontal_spacing_m'): 'calibrated: payload bearing about y',
    ('payload_bearing', 'transverse'): 'calibrated: payload bearing about x',
    ('payload_bearing', 'seal_force_per_block_n'): f'{_MOVED}; 1 to 5 N',
    ('counterweight_bearing', 'vertical_spacing_m'): 'calibrated: counterweight bearing about z',
    ('counterweight_bearing', 'horizontal_spacing_m'): 'calibrated: counterweight bearing about y',
    ('counterweight_bearing', 'transverse'): 'calibrated: counterweight bearing about x',
    ('counterweight_bearing', 'seal_force_per_block_n'): f'{_MOVED}; 1 to 5 N',
    ('x_rotate_bearing', 'radial'): 'calibrated: X-Rotate bearing radial',
    ('x_rotate_bearing', 'moment'): 'calibrated: X-Rotate bearing about z',
    ('x_rotate_shaft', 'length_m'): 'calibrated: X-Rotate shaft bending; 0.15 to 0.4 m',
    ('x_rotate_shaft', 'outer_diameter_m'): 'calibrated: X-Rotate shaft torsion',
    ('gearbox', 'no_load_torque_nm'): f'{_MOVED}; 0.02 to 0.15 Nm',
    ('belt', 'specific_stiffness_n_per_m'): 'calibrated: gearbox and belt; T5 8e6 to 12e6',
    ('belt', 'loss_factor'): f'{_MOVED}; thesis: 0.001 to 0.05, of little effect',
    ('lip_seal', 'normal_force_n'): f'{_MOVED}; drag 0.02 to 0.1 Nm on a 20 mm shaft',
}
"""The part data that calibration sets, and what each then says of where it comes from."""


def part_data(values: Mapping[str, float]) -> dict[str, Any]:
    """
    Return the overlay of `parts` that makes a candidate's stiffnesses and frictions.

    Solved by going back and forth between part data and rows of Table 6.7, each row by the datum
    that makes it: cable length, spacings of the guides (y and z) and their transverse chart (x),
    radial and moment chart of the ring, length and outer diameter of the shaft, the belt's
    specific stiffness; friction by seals and the gearbox's torque without load.
    """
    parts = copy.deepcopy(_plain(machine_file().data['parts']))
    omega = 2.0 * math.pi / 60.0 * np.array(parts['gearbox']['no_load_speed_rpm'])
    torque = values['y_gearbox_friction_nm'] + values['y_gearbox_viscous_nm_s'] * omega
    parts['gearbox']['no_load_torque_nm'] = [float(value) for value in torque]
    parts['belt']['loss_factor'] = values['belt_loss_factor']
    wanted = thesis()['first_frequencies_hz']
    for _ in range(PART_ROUNDS):
        description = _described_by_parts(values, parts)
        found = first_frequencies(description)
        ratio = {name: wanted[name] / found[name] for name in wanted}
        _correct_stiffnesses(parts, ratio)
        _correct_frictions(parts, description, values)
    return {
        name: {
            key: _with_provenance(value, CALIBRATED_PARTS[name, key])
            for key, value in part.items()
            if (name, key) in CALIBRATED_PARTS
        }
        for name, part in rounded(parts).items()
        if any(name == part_name for part_name, _ in CALIBRATED_PARTS)
    }


def _with_provenance(value: Any, source: str) -> Any:
    """Return a quantity with its source; of a chart, its deflections only."""
    if isinstance(value, dict):
        return {
            key: {'value': points, 'from': source}
            for key, points in value.items()
            if not key.startswith(('load', 'moment'))
        }
    return {'value': value, 'from': source}


def _plain(value: Any) -> Any:
    """Return a value of the description's file without its provenance; both dampings kept."""
    if isinstance(value, dict):
        if 'value' in value:
            return _plain(value['value'])
        return {key: _plain(item) for key, item in value.items()}
    return value


def _described_by_parts(values: Mapping[str, float], parts: dict[str, Any]) -> Description:
    document = copy.deepcopy(machine_file())
    document.data['parts'] = copy.deepcopy(parts)
    merge(document, Document(payload_overlay(values), {(): ('candidate', 1)}))
    return check(document, 'calculated')


def _correct_stiffnesses(parts: dict[str, Any], ratio: Mapping[str, float]) -> None:
    """Move every datum by what its row is off; `ratio` is frequency wanted over found."""
    parts['cable']['cable_length_m'] /= ratio['cable'] ** 2
    for bearing in ('payload_bearing', 'counterweight_bearing'):
        about = {axis: ratio[f'{bearing}_{axis}'] for axis in 'xyz'}
        parts[bearing]['vertical_spacing_m'] *= about['z']
        parts[bearing]['horizontal_spacing_m'] *= about['y']
        _scale(parts[bearing]['transverse'], 'deflection_um', (about['z'] / about['x']) ** 2)
    ring = parts['x_rotate_bearing']
    _scale(ring['radial'], 'deflection_um', ratio['x_rotate_bearing_radial'] ** -2)
    _scale(ring['moment'], 'tilt_urad', ratio['x_rotate_bearing_z'] ** -2)
    shaft = parts['x_rotate_shaft']
    torsion, bending = ratio['x_rotate_shaft_torsion'], ratio['x_rotate_shaft_bending']
    longer = torsion / bending  # torsion over bending stiffness goes with the square of length
    shaft['length_m'] *= longer
    inner = shaft['inner_diameter_m'] ** 4
    area_moment = (shaft['outer_diameter_m'] ** 4 - inner) * torsion**2 * longer
    shaft['outer_diameter_m'] = (area_moment + inner) ** 0.25
    parts['belt']['specific_stiffness_n_per_m'] *= ratio['belt'] ** 2


def _correct_frictions(
    parts: dict[str, Any], description: Description, values: Mapping[str, float]
) -> None:
    """Move seal forces by what the frictions are off."""

    def found(name: str) -> float:
        return float(description.frictions[name].resistances[0])

    for guide in ('payload', 'counterweight'):
        missing = values[f'{guide}_guide_friction_n'] - found(f'{guide}_guide')
        parts[f'{guide}_bearing']['seal_force_per_block_n'] += missing / 4.0
    seal = parts['lip_seal']
    missing = (
        values['y_output_friction_nm'] - found('y_rotate_lip_seal') - found('y_rotate_bearings')
    )
    seal['normal_force_n'] += missing / (seal['shaft_radius_m'] * seal['friction_coefficient'])


def _scale(chart: dict[str, Any], key: str, factor: float) -> None:
    chart[key] = [value * factor for value in chart[key]]


def machine_overlay(values: Mapping[str, float]) -> dict[str, Any]:
    """Return everything that calibration sets in the machine's description."""
    return rounded({**payload_overlay(values), 'parts': part_data(values)})
