# SPDX-License-Identifier: Apache-2.0
"""What a user has of a case: two logs as CSV, the description of the machine, the map of the columns."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from independent_machine.cases import Case
from independent_machine.machine import Machine
from independent_machine.simulation import Log

ESTIMATION, VALIDATION = 'estimation.csv', 'validation.csv'
MACHINE, MAP = 'machine.yaml', 'map.yaml'


def description(machine: Machine) -> dict:
    """Return the description of a machine: what its owner knows, in waferbot's words."""
    linear = machine.linear
    turn = 's_m' if linear else 's_rad'
    coordinate = 'travel' if linear else 'angle'
    direction = [0, 0, 1]
    if linear:
        direction = [0, 1, 0] if machine.upright else [1, 0, 0]
    other = machine.inertia if not linear else 0.01 * machine.mass
    of_motor = 'motor_angle' if machine.kind == 'geared' else coordinate
    # Peak of the sine: force = 3/2 k I of a wye, and the line-to-line constant is the root of 3 times k.
    motor = {
        'coordinate': of_motor,
        'winding': 'wye',
        'resistance_lead_to_lead_ohm': 2.0,
        'inductance_lead_to_lead_h': 0.004,
        f'back_emf_lead_to_lead_v_{turn}': machine.constant * 2.0 / math.sqrt(3.0),
    }
    if linear:
        motor['electrical_cycle_m'] = 1.0 / machine.cycle
    else:
        motor['pole_pairs'] = int(machine.cycle)
    found = {
        'name': f'{machine.kind} axis',
        'gravity_m_s2': [0, 0, -9.81] if not linear and machine.upright else [0, -9.81, 0],
        'bodies': {
            'load': {
                'mass_kg': machine.mass,
                'centre_of_gravity_m': [*machine.centre, 0.0],
                'inertia_kg_m2': {'xx': other, 'yy': other, 'zz': other},
            }
        },
        'joints': {
            'guide': {
                'parent': 'base',
                'child': 'load',
                'at_m': [0, 0, 0],
                'freedoms': {
                    coordinate: {
                        'type': 'prismatic' if linear else 'revolute',
                        'axis': direction,
                    }
                },
            }
        },
        'axes': {machine.axis: coordinate},
        'motors': {machine.axis: motor},
        'encoders': {_encoder(machine): _counts(linear, coordinate, machine.resolution)},
    }
    if machine.kind == 'geared':
        found['rotors'] = {'motor_angle': {'inertia_kg_m2': machine.motor_inertia}}
        stage = {'kind': 'gear', 'ratio': machine.ratio, 'connection': 'gear'}
        found['transmissions'] = {
            'drive': {'driving': 'motor_angle', 'driven': 'angle', 'stages': [stage]}
        }
        found['connections'] = {
            'gear': {
                'state': 'rigid',
                'stiffness_nm_rad': machine.gear_stiffness,
                'loss_factor': 0.06,
            }
        }
        if machine.motor_resolution:
            found['encoders']['y_rotate_motor'] = _counts(
                False, 'motor_angle', machine.motor_resolution
            )
    if machine.coulomb:
        speed, force = ('speed_m_s', 'force_n') if linear else ('speed_rad_s', 'torque_nm')
        found['frictions'] = {
            'bearing': {'coordinate': coordinate, speed: [0.0], force: [machine.coulomb]}
        }
    if machine.viscous:
        key = 'damping_n_s_m' if linear else 'damping_nm_s_rad'
        found['dampers'] = {'grease': {'coordinate': coordinate, key: machine.viscous}}
    return found


def _encoder(machine: Machine) -> str:
    return 'y_rotate_load' if machine.kind == 'geared' else machine.axis


def _counts(linear: bool, coordinate: str, resolution: float) -> dict:
    if linear:
        return {'coordinate': coordinate, 'counts_per_m': float(f'{1.0 / resolution:.9g}')}
    turn = float(f'{2.0 * math.pi / resolution:.9g}')
    return {'coordinate': coordinate, 'counts_per_revolution': turn}


def table(case: Case, log: Log) -> tuple[dict[str, np.ndarray], dict]:
    """Return the columns of a log in the units of a user, and the map that says what they are."""
    machine, dialect = case.setup.machine, case.dialect
    axis, linear = machine.axis, machine.linear
    turns = math.degrees(1.0)
    unit, factor = ('m', 1.0) if linear else ('rad', 1.0)
    if dialect in ('metric', 'german'):
        unit, factor = ('mm', 1e3) if linear else ('deg', turns)
    time_unit, per_s = ('ms', 1e3) if dialect in ('metric', 'german') else ('s', 1.0)
    columns = {'Time': per_s * log.time_s}
    signals = []

    def add(name: str, kind: str, values: np.ndarray, its_unit: str, **more: float) -> None:
        columns[name] = values
        signals.append({'column': name, 'kind': kind, 'axis': axis, 'unit': its_unit, **more})

    def position(name: str, kind: str, values: np.ndarray, resolution: float) -> None:
        if dialect == 'counts':
            add(name, kind, np.round(values / resolution), 'counts')
        else:
            add(name, kind, factor * values, unit, resolution=factor * resolution)

    position('Actual position', 'position', log.position, machine.resolution)
    if machine.motor_resolution:
        position('Motor position', 'motor_position', log.motor_position, machine.motor_resolution)
    add('Commanded position', 'commanded_position', factor * log.commanded, unit)
    kind = case.setup.drive
    if kind == 'force':
        add('Drive force', 'force' if linear else 'torque', log.drive, 'N' if linear else 'Nm')
    elif dialect == 'german':
        add('Current', kind, log.drive / math.sqrt(2.0), 'A_rms')
    else:
        add('Current', kind, log.drive, 'A')
    mapping: dict = {'name': 'log', 'time': {'column': 'Time', 'unit': time_unit}}
    if dialect == 'counts':
        mapping['machine'] = MACHINE
    mapping['signals'] = signals
    if dialect == 'german':
        mapping['options'] = {'delimiter': ';', 'decimal': ','}
    return columns, mapping


def write_case(case: Case, folder: Path) -> None:
    """Write the files of a case into a folder; what is hidden stands in none of them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MACHINE).write_text(
        yaml.safe_dump(description(case.setup.machine), sort_keys=False), 'utf-8'
    )
    for name, log in zip((ESTIMATION, VALIDATION), case.logs(), strict=True):
        columns, mapping = table(case, log)
        if 'machine' in mapping:
            mapping['machine'] = str(folder / MACHINE)
        _write_csv(folder / name, columns, case.dialect == 'german')
    (folder / MAP).write_text(yaml.safe_dump(mapping, sort_keys=False), 'utf-8')


def _write_csv(path: Path, columns: dict[str, np.ndarray], german: bool) -> None:
    rows = np.column_stack(list(columns.values()))
    separator = ';' if german else ','
    lines = [separator.join(columns)]
    for row in rows:
        line = separator.join(f'{value:.10g}' for value in row)
        lines.append(line.replace('.', ',') if german else line)
    path.write_text('\n'.join(lines) + '\n', 'utf-8')
