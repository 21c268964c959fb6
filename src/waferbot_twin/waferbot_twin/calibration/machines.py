# SPDX-License-Identifier: Apache-2.0
"""From the values of a candidate to the description of its machine."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Document, merge, read
from waferbot_plant.description import Description
from waferbot_plant.description_file import check
from waferbot_plant.modes import first_frequencies, pick_simplified
from waferbot_plant.plant import config_folder
from waferbot_twin.thesis import thesis

FROM = 'calibrated: the steps of Tables 4.1 to 4.3, 6.1, 6.3 and 6.5'
ROTOR_MASS_KG = 2.2
CARRIAGE_GYRATION_M = (0.083, 0.055, 0.063)
END_GYRATION_M = (0.1026, 0.1124, 0.1026)
COUNTERWEIGHT_GYRATION_M = (0.0669, 0.0702, 0.0702)
BEARING_Z_OVER_Y = 1.1095
"""Stiffness of the X-Rotate bearing about z over that about y, from a chart of load^0.9."""

OUTPUT_FRICTION_FACTOR = 11.6
"""By how much chapter 6 raises the friction of the Y-Rotate output."""

BANDWIDTH_HZ = 30.0
"""Bandwidth of the position loops: ten times of it is the 300 Hz of chapter 6."""


@functools.cache
def machine_file() -> Document:
    """Return the shipped description as it is written; callers copy it before they change it."""
    return read(config_folder() / 'machine.yaml')


def payload_overlay(values: Mapping[str, float]) -> dict[str, Any]:
    """
    Return the bodies, joints and rotors of a candidate as an overlay of the machine's description.

    Inertias follow from radii of gyration; that of the X-Rotate load about y from the one about z,
    as the law of the bearing's chart makes it `BEARING_Z_OVER_Y` times as stiff about z.
    """
    v = values
    bearing_x = v['x_bearing_x_m']
    load_x = bearing_x + v['x_load_overhang_m']
    y_axis_x = bearing_x + v['y_load_overhang_m']
    carriage, stator = v['carriage_mass_kg'], v['stator_mass_kg']
    rotor_xx = v['x_rotor_inertia_kg_m2']
    load, load_z = v['x_load_mass_kg'], v['x_load_z_m']
    end, end_z = v['y_load_mass_kg'], v['y_load_z_m']
    payload = carriage + stator + ROTOR_MASS_KG + load + end
    counterweight = payload * v['counterweight_ratio']
    rotor_across = 0.57 * rotor_xx
    end_xx, end_yy = end * END_GYRATION_M[0] ** 2, end * END_GYRATION_M[1] ** 2
    load_xx = load * v['x_load_gyration_x_m'] ** 2
    load_zz = load * v['x_load_gyration_z_m'] ** 2
    overhang, end_overhang = v['x_load_overhang_m'], v['y_load_overhang_m']
    about_z = load_zz + load * overhang**2 + end_xx + end * end_overhang**2 + rotor_across
    about_y = (
        load * (overhang**2 + load_z**2)
        + end_yy
        + end * (end_overhang**2 + end_z**2)
        + rotor_across
    )
    ratio = (
        thesis()['first_frequencies_hz']['x_rotate_bearing_z']
        / thesis()['first_frequencies_hz']['x_rotate_bearing_y']
    ) ** 2
    load_yy = ratio * about_z / BEARING_Z_OVER_Y - about_y
    if not abs(load_xx - load_zz) < load_yy < load_xx + load_zz:
        raise UserError('the X-Rotate load cannot have such moments of inertia')
    overlay = {
        'bodies': {
            'carriage': _body(carriage, (0.02, 0.0, 0.0), CARRIAGE_GYRATION_M),
            'x_rotate_stator_part': _body(
                stator, (v['stator_x_m'], 0.0, 0.0), (0.075, *2 * (v['stator_gyration_m'],))
            ),
            'x_rotate_rotor': {
                'centre_of_gravity_m': [bearing_x, 0.0, 0.0],
                'inertia_kg_m2': {'xx': rotor_xx, 'yy': rotor_across, 'zz': rotor_across},
            },
            'x_rotate_load': {
                'mass_kg': load,
                'centre_of_gravity_m': [load_x, 0.0, load_z],
                'inertia_kg_m2': {'xx': load_xx, 'yy': load_yy, 'zz': load_zz, 'xz': 0.0},
            },
            'y_rotate_load': _body(end, (y_axis_x, 0.0, end_z), END_GYRATION_M),
            'counterweight': {
                'mass_kg': counterweight,
                'inertia_kg_m2': {
                    'xx': counterweight * COUNTERWEIGHT_GYRATION_M[0] ** 2,
                    'yy': counterweight * COUNTERWEIGHT_GYRATION_M[1] ** 2,
                    'zz': counterweight * COUNTERWEIGHT_GYRATION_M[2] ** 2,
                },
            },
        },
        'joints': {
            'stator_mount': {'at_m': [v['stator_x_m'], 0.0, 0.0]},
            'x_rotate': {'at_m': [bearing_x, 0.0, 0.0]},
            'x_rotate_shaft': {'at_m': [bearing_x, 0.0, 0.0]},
            'y_rotate': {'at_m': [y_axis_x, 0.0, 0.0]},
        },
        'rotors': {'y_rotate_motor': {'inertia_kg_m2': v['y_motor_inertia_kg_m2']}},
    }
    return {
        section: {
            name: {key: {'value': value, 'from': FROM} for key, value in item.items()}
            for name, item in items.items()
        }
        for section, items in overlay.items()
    }


def _body(
    mass: float, centre: tuple[float, float, float], gyration: tuple[float, ...]
) -> dict[str, Any]:
    """Return a body of an overlay, its moments of inertia by radii of gyration."""
    moments = (mass * radius**2 for radius in gyration)
    return {
        'mass_kg': mass,
        'centre_of_gravity_m': list(centre),
        'inertia_kg_m2': dict(zip(('xx', 'yy', 'zz'), moments, strict=True)),
    }


def describe(values: Mapping[str, float], damping: str = 'improved') -> Description:
    """
    Return the flexible machine of a candidate, with stiffnesses that make Table 6.7.

    Frictions are set directly; `part_data` finds what parts make them. Raises `UserError` for a
    machine that cannot be.
    """
    document = copy.deepcopy(machine_file())
    merge(document, Document(payload_overlay(values), {(): ('candidate', 1)}))
    return hold_first_frequencies(_with_frictions(check(document, damping), values, damping))


def hold_first_frequencies(description: Description) -> Description:
    """Return the machine with every connection's stiffness scaled to its row of Table 6.7."""
    wanted = thesis()['first_frequencies_hz']
    found = first_frequencies(description)
    connections = {
        name: dataclasses.replace(
            part, stiffness=part.stiffness * (wanted[name] / found[name]) ** 2
        )
        for name, part in description.connections.items()
    }
    return dataclasses.replace(description, connections=connections)


def _with_frictions(
    description: Description, values: Mapping[str, float], damping: str
) -> Description:
    factor = OUTPUT_FRICTION_FACTOR if damping == 'improved' else 1.0
    torque_or_force = {
        'payload_guide': values['payload_guide_friction_n'],
        'counterweight_guide': values['counterweight_guide_friction_n'],
        'gearbox': values['y_gearbox_friction_nm'],
        'y_rotate_lip_seal': factor * values['y_output_friction_nm'],
        'y_rotate_bearings': 0.0,  # in the above
    }
    frictions = {
        name: dataclasses.replace(part, resistances=np.array([torque_or_force[name]]))
        if name in torque_or_force
        else part
        for name, part in description.frictions.items()
    }
    dampers = dict(description.dampers)
    dampers['gearbox'] = dataclasses.replace(
        dampers['gearbox'], damping=values['y_gearbox_viscous_nm_s']
    )
    connections = dict(description.connections)
    connections['belt'] = dataclasses.replace(
        connections['belt'], loss_factor=values['belt_loss_factor']
    )
    return dataclasses.replace(
        description, frictions=frictions, dampers=dampers, connections=connections
    )


def as_rigid(description: Description) -> Description:
    """Return the machine of chapter 4: every connection rigid, no friction, no damping."""
    connections = {
        name: dataclasses.replace(part, flexible=False)
        for name, part in description.connections.items()
    }
    return dataclasses.replace(description, connections=connections, frictions={}, dampers={})


def as_simplified(description: Description) -> Description:
    """Return the machine with the connections rigid whose first frequency is above the rule's."""
    switches = pick_simplified(description, BANDWIDTH_HZ)
    connections = {
        name: dataclasses.replace(part, flexible=switches[name] == 'flexible')
        for name, part in description.connections.items()
    }
    return dataclasses.replace(description, connections=connections)


def rounded(value: Any) -> Any:
    """Return a value with its numbers at six significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f'{value:.6g}') if isinstance(value, float) else value
