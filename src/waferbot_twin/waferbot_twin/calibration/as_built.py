# SPDX-License-Identifier: Apache-2.0
"""The as-built machine: how it departs from the nominal one, and how a candidate is judged."""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.marked_yaml import Document, merge
from waferbot_plant import statics
from waferbot_plant.description import Body, Description
from waferbot_plant.description_file import check
from waferbot_plant.plant import Machine
from waferbot_twin.calibration.candidate_runs import CandidateRuns, Stepped
from waferbot_twin.calibration.demands import row_demands, statement_demands
from waferbot_twin.calibration.evaluation import (
    Evaluation,
    late_motion,
    machine_of,
    pristine_twin,
    residuals,
)
from waferbot_twin.calibration.machines import as_rigid, as_simplified, machine_file, rounded
from waferbot_twin.calibration.values import Unknown, Values
from waferbot_twin.metrics import performance_improvement
from waferbot_twin.step_runs import MODELS, Runs
from waferbot_twin.thesis import thesis

AS_BUILT_PAYLOAD = (
    Unknown('y_motor_ratio', 0.85, 1.15),
    Unknown('y_viscous_n_s_m', 0.0, 200.0),
    Unknown('payload_guide_friction_n', 4.0, 40.0),
    Unknown('counterweight_guide_friction_n', 4.0, 40.0),
    Unknown('counterweight_ratio', 0.90, 1.15),
    Unknown('cable_modulus_ratio', 0.4, 1.1),
    Unknown('cable_loss_factor', 0.001, 0.15),
    Unknown('payload_bearing_loss_factor', 0.02, 0.15),
    Unknown('x_bearing_loss_factor', 0.02, 0.15),
    Unknown('stator_x_shift_m', -0.05, 0.05),
    Unknown('x_load_z_shift_m', -0.06, 0.06),
    Unknown('x_motor_ratio', 0.75, 1.05),
    Unknown('ring_mass_kg', 0.0, 6.0),
    Unknown('x_friction_nm', 0.4, 8.0),
    Unknown('x_friction_rise_nm', 0.0, 8.0),
    Unknown('x_bearing_radial_loss_factor', 0.02, 0.2),
    Unknown('x_shaft_loss_factor', 0.003, 0.1),
)
"""How the as-built payload departs from the nominal one: ratios, shifts, a ring, own frictions."""

AS_BUILT_Y_ROTATE = (
    Unknown('y_rotate_motor_ratio', 0.75, 1.10),
    Unknown('y_rotor_inertia_ratio', 0.8, 3.5),
    Unknown('y_load_inertia_ratio', 0.8, 1.3),
    Unknown('belt_stiffness_ratio', 0.74, 1.1),
    Unknown('belt_loss_factor', 0.001, 0.10),
    Unknown('y_output_friction_nm', 0.05, 1.5),
    Unknown('y_gearbox_friction_nm', 0.005, 0.08),
    Unknown('y_gearbox_viscous_nm_s', 0.0, 1e-3),
    Unknown('y_gearbox_friction_asymmetry', 0.0, 0.8),
    Unknown('y_gearbox_rigidity_ratio', 0.84, 4.0),
    Unknown('y_rotate_output_limit', 0.1, 1.0),
)
"""The same for the drive of Y-Rotate."""

AS_BUILT_DELAY_CYCLES = 2
"""Age of the counts in the as-built machine's feedback: one phase cycle more than nominal."""

RING_RADIUS_M = 0.30
"""Radius of the ring that turns with the as-built X-Rotate load."""

X_FRICTION_SPEED_RAD_S = 0.3
"""Speed at which the friction of the as-built X-Rotate axis has risen to its highest value."""

GAIN_POINTS = 10.0
"""Tolerance of the RMS gain of flexible over rigid, percentage points."""


@functools.cache
def _nominal() -> Description:
    document = copy.deepcopy(machine_file())
    return check(document, 'improved')


def as_built_overlay(values: Mapping[str, float]) -> dict[str, Any]:
    """
    Return the as-built machine as an overlay of the shipped description.

    What turns with X-Rotate and is in no drawing of the mechanism (cable carrier, hoses, cover) is a
    ring of mass m and radius r about the axis of X-Rotate at the load's centre of gravity, in the
    plane across the axis: it adds m r^2 about the axis, m r^2 / 2 about both others, and pulls the
    common centre of gravity towards the axis. Frictions are numbers of their own here and not
    those of the parts.
    """
    v, nominal = values, _nominal()
    bodies, parts = nominal.bodies, nominal.parts
    stator, counterweight = bodies['x_rotate_stator_part'], bodies['counterweight']
    end = bodies['y_rotate_load']
    rotor = nominal.rotors['y_rotate_motor'].inertia
    gone = dict.fromkeys(nominal.frictions)
    end_inertia = np.diag(end.inertia) * [1.0, v['y_load_inertia_ratio'], 1.0]
    shifted = stator.centre_of_gravity + [v['stator_x_shift_m'], 0.0, 0.0]
    overlay = {
        'bodies': {
            'x_rotate_stator_part': {
                'centre_of_gravity_m': _quantity(shifted.tolist(), 'within 50 mm of the drawing')
            },
            'x_rotate_load': with_ring(
                bodies['x_rotate_load'], v['x_load_z_shift_m'], v['ring_mass_kg']
            ),
            'y_rotate_load': {
                'inertia_kg_m2': _quantity(
                    _moments(end_inertia), 'about y 0.8 to 1.3 of the drawing, with a wafer'
                )
            },
            'counterweight': {
                'mass_kg': _quantity(
                    counterweight.mass * v['counterweight_ratio'],
                    'trimmed with plates, 0.9 to 1.15 of the drawing',
                )
            },
        },
        'rotors': {
            'y_rotate_motor': {
                'inertia_kg_m2': _quantity(
                    rotor * v['y_rotor_inertia_ratio'],
                    'with coupling and brake, 1e-5 to 2e-4 in this size',
                )
            }
        },
        'feedback': {
            'delay_cycles': _quantity(
                AS_BUILT_DELAY_CYCLES,
                "chosen: one phase cycle more, for the encoders' electronics",
            )
        },
        'motors': {
            axis: {
                f'back_emf_lead_to_lead_{unit}': _quantity(
                    nominal.motors[axis].back_emf * v[f'{short}_motor_ratio'], bounds
                )
            }
            for axis, unit, short, bounds in (
                ('y_linear', 'v_s_m', 'y', '0.85 to 1.15 of nominal: air gap'),
                ('x_rotate', 'v_s_rad', 'x', '0.75 to 1.05 of nominal: air gap, warm magnets'),
                ('y_rotate', 'v_s_rad', 'y_rotate', '0.75 to 1.10 of nominal: with gear loss'),
            )
        },
        'parts': {
            'cable': {
                'elastic_modulus_pa': _quantity(
                    parts['cable'].elastic_modulus_pa * v['cable_modulus_ratio'],
                    '0.4 to 1.1 of wire: lay of the rope',
                ),
                'loss_factor': _quantity(v['cable_loss_factor'], 'wire rope 0.001 to 0.15'),
            },
            'belt': {
                'specific_stiffness_n_per_m': _quantity(
                    parts['belt'].specific_stiffness_n_per_m * v['belt_stiffness_ratio'],
                    'T5 8e6 to 12e6',
                ),
                'loss_factor': _quantity(v['belt_loss_factor'], 'steel-cord belt 0.001 to 0.1'),
            },
            'gearbox': {
                'torsional_rigidity_nm_per_arcmin': _quantity(
                    parts['gearbox'].torsional_rigidity_nm_per_arcmin
                    * v['y_gearbox_rigidity_ratio'],
                    'two-stage planetary of this frame, 0.5 to 4',
                )
            },
            'x_rotate_shaft': {
                'loss_factor': _quantity(
                    v['x_shaft_loss_factor'], 'with its clamped joints, 0.003 to 0.1'
                )
            },
        },
        'connections': {
            name: {
                'loss_factor': _quantity(
                    v[f'{short}_loss_factor'],
                    'lubricated rolling contacts as mounted, 0.02 to 0.15'
                    if short != 'x_bearing_radial'
                    else 'with the joint of ring and housing, 0.02 to 0.2',
                )
            }
            for names, short in (
                ([f'payload_bearing_{axis}' for axis in 'xyz'], 'payload_bearing'),
                ([f'x_rotate_bearing_{way}' for way in 'yz'], 'x_bearing'),
                (['x_rotate_bearing_radial'], 'x_bearing_radial'),
            )
            for name in names
        },
        'frictions': {
            **gone,
            'payload_guide_as_built': {
                'coordinate': 'y_linear',
                'speed_m_s': [0.0],
                'force_n': _quantity(
                    [v['payload_guide_friction_n']],
                    'four blocks with seals and a cable carrier, 4 to 40 N',
                ),
            },
            'counterweight_guide_as_built': {
                'coordinate': 'counterweight',
                'speed_m_s': [0.0],
                'force_n': _quantity(
                    [v['counterweight_guide_friction_n']], 'four blocks with seals, 4 to 40 N'
                ),
            },
            'x_rotate_as_built': {
                'coordinate': 'x_rotate',
                'speed_rad_s': [0.0, X_FRICTION_SPEED_RAD_S],
                'torque_nm': _quantity(
                    [v['x_friction_nm'], v['x_friction_nm'] + v['x_friction_rise_nm']],
                    'seal, preloaded ring, cable carrier and hoses: 0.4 to 8 Nm, 8 Nm more when moving',
                ),
            },
            'gearbox_as_built': {
                'coordinate': 'y_rotate_motor',
                'speed_rad_s': [0.0],
                'torque_nm': _quantity(
                    [v['y_gearbox_friction_nm']], 'no-load torque of 0.005 to 0.08 Nm'
                ),
                'asymmetry': v['y_gearbox_friction_asymmetry'],
            },
            'y_rotate_output_as_built': {
                'coordinate': 'y_rotate',
                'speed_rad_s': [0.0],
                'torque_nm': _quantity(
                    [v['y_output_friction_nm']], 'lip seal as mounted and bearings, 0.05 to 1.5 Nm'
                ),
            },
        },
        'dampers': {
            'y_linear_as_built': {
                'coordinate': 'y_linear',
                'damping_n_s_m': _quantity(
                    v['y_viscous_n_s_m'], 'grease and eddy currents, 0 to 200 N s/m'
                ),
            },
            'gearbox_as_built_viscous': {
                'coordinate': 'y_rotate_motor',
                'damping_nm_s_rad': _quantity(
                    v['y_gearbox_viscous_nm_s'], 'grease, 0 to 1e-3 Nm s'
                ),
            },
        },
    }
    return rounded(overlay)


def with_ring(load: Body, shift_z: float, ring: float) -> dict[str, Any]:
    """Return the X-Rotate load, moved by `shift_z` (m), with a ring of mass `ring` (kg)."""
    centre = load.centre_of_gravity + [0.0, 0.0, shift_z]
    mass = load.mass + ring
    common = centre * [1.0, 1.0, load.mass / mass]
    apart = load.mass * ring / mass * centre[2] ** 2
    moments = (
        np.diag(load.inertia)
        + ring * RING_RADIUS_M**2 * np.array([1.0, 0.5, 0.5])
        + apart * np.array([1.0, 1.0, 0.0])
    )
    return {
        'mass_kg': _quantity(mass, 'with a ring of up to 6 kg'),
        'centre_of_gravity_m': _quantity(
            common.tolist(), 'load within 60 mm of the drawing, with the ring'
        ),
        'inertia_kg_m2': _quantity(_moments(moments), 'with the ring'),
    }


def _moments(moments: np.ndarray) -> dict[str, float]:
    return dict(zip(('xx', 'yy', 'zz'), moments.tolist(), strict=True))


def _quantity(value: Any, bounds: str) -> dict[str, Any]:
    chosen = bounds.startswith('chosen')
    return {
        'value': value,
        'from': bounds if chosen else f'calibrated: measured columns; {bounds}',
    }


@functools.cache
def _nominal_runs() -> Runs:
    """Return the runs of the nominal machine's models; they are the same for every candidate."""
    improved = _nominal()
    machines = {
        'rigid': as_rigid(improved),
        'flexible': improved,
        'simplified': as_simplified(improved),
        'calculated': check(copy.deepcopy(machine_file()), 'calculated'),
    }
    return CandidateRuns(
        {name: Stepped(machine_of(machine), {}) for name, machine in machines.items()}
    )


def as_built_runs(values: Mapping[str, float]) -> Runs:
    """Return the runs of a candidate beside those of the nominal machine, with all that it has own."""
    machine = as_built_machine(values)
    own = Stepped(machine, as_built_variables(values, machine))
    return CandidateRuns({'as_built': own}, _nominal_runs())


def as_built_machine(values: Mapping[str, float]) -> Machine:
    """Return the as-built machine of a set of values; raises `UserError` for one that cannot be."""
    document = copy.deepcopy(machine_file())
    merge(document, Document(as_built_overlay(values), {(): ('as built', 1)}))
    return machine_of(check(document, 'improved'))


def as_built_bias(machine: Machine) -> dict[str, Values]:
    """
    Return Ixx29 of each axis that holds a machine at home, in DAC bits.

    The gains are those of the nominal machine, but a controller that has stood for a while holds
    the weight that is there, not the one that was planned.
    """
    base = pristine_twin(AXES[0]).servo_parameters[0]
    holding = statics.holding_currents(machine, machine.parameters(), {})
    return {
        axis: {'Ixx29': round(holding[axis] / (base['amplifier_peak_current'][place] / 32768.0))}
        for place, axis in enumerate(AXES)
    }


def as_built_variables(values: Mapping[str, float], machine: Machine) -> dict[str, Values]:
    """
    Return the I-variables in which the as-built machine's controller differs, by axis.

    The bias that holds its weight, and Ixx69 of Y-Rotate: chapter 6 says of the simulated currents that
    the physical machine cannot have them, and that such a limit should be added.
    """
    variables = as_built_bias(machine)
    full = pristine_twin(AXES[0]).servo_parameters[0]['Ixx69'][AXES.index('y_rotate')]
    variables['y_rotate']['Ixx69'] = round(float(full) * values['y_rotate_output_limit'])
    return variables


def _evaluate_as_built(values: Mapping[str, float], axes: tuple[str, ...]) -> Evaluation:
    """
    Return the rows of the measured columns of `axes`, their RMS gains, and what else is demanded.

    RMS errors are over the whole record, as in the tables: step up and step down.
    """
    runs = as_built_runs(values)
    result = Evaluation()
    for axis in axes:
        measured = runs['as_built', axis].response
        result.residuals += residuals(measured, 'measured')
        gain = performance_improvement(
            *(runs.rms_error(model, axis) for model in ('rigid', 'flexible'))
        )
        wanted = thesis()['steps'][axis]['improvement']['rms_error']
        off = max(0.0, abs(gain - wanted) / GAIN_POINTS - 0.5)
        sign = max(0.0, 0.4 - gain / wanted)
        result.penalties[f'{axis}: RMS gain'] = min(off, 5.0) + min(sign, 1.0)
        result.penalties[f'{axis}: at rest in the end'] = 20.0 * max(
            0.0, late_motion(measured, 0.02) - 0.02
        )
        result.demands |= row_demands(runs, axis) | statement_demands(runs, axis, MODELS)
    return result


def evaluate_as_built_payload(values: Mapping[str, float]) -> Evaluation:
    """Return measured columns and RMS gains of Y-Linear and X-Rotate."""
    return _evaluate_as_built(values, ('y_linear', 'x_rotate'))


def evaluate_as_built_y_rotate(values: Mapping[str, float]) -> Evaluation:
    """Return measured column and RMS gain of Y-Rotate."""
    return _evaluate_as_built(values, ('y_rotate',))
