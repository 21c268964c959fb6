# SPDX-License-Identifier: Apache-2.0
"""The nominal machine and its gains: what is sought in two stages, and how a candidate is judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant.plant import Machine
from waferbot_twin.calibration.evaluation import (
    Evaluation,
    late_motion,
    machine_of,
    pristine_twin,
    residuals,
    respond,
    servo_record,
)
from waferbot_twin.calibration.gains import i_variables
from waferbot_twin.calibration.machines import as_rigid, as_simplified, describe
from waferbot_twin.calibration.values import Unknown, Values
from waferbot_twin.closed_loop import fastest_growth, loop_modes
from waferbot_twin.oscillation import late_oscillation
from waferbot_twin.response import AxisResponse, rms_difference
from waferbot_twin.thesis import thesis

PAYLOAD = (
    Unknown('carriage_mass_kg', 2.5, 8.0),
    Unknown('stator_mass_kg', 8.0, 30.0),
    Unknown('stator_x_m', 0.08, 0.30),
    Unknown('stator_gyration_m', 0.06, 0.20),
    Unknown('x_rotor_inertia_kg_m2', 0.015, 0.030),
    Unknown('x_bearing_x_m', 0.12, 0.35),
    Unknown('x_load_mass_kg', 4.0, 16.0),
    Unknown('x_load_overhang_m', 0.0, 0.20),
    Unknown('x_load_z_m', -0.10, 0.25),
    Unknown('x_load_gyration_x_m', 0.08, 0.25),
    Unknown('x_load_gyration_z_m', 0.08, 0.30),
    Unknown('y_load_mass_kg', 4.0, 12.0),
    Unknown('y_load_overhang_m', 0.0, 0.25),
    Unknown('y_load_z_m', 0.0, 0.15),
    Unknown('counterweight_ratio', 0.80, 1.25),
    Unknown('payload_guide_friction_n', 8.0, 25.0),
    Unknown('counterweight_guide_friction_n', 9.5, 25.0),
    Unknown('y_linear_natural_frequency_rad_s', 100.0, 150.0),
    Unknown('y_linear_damping_ratio', 0.2, 0.5),
    Unknown('y_linear_feedforward_ratio', 0.2, 1.2),
    Unknown('y_linear_integral_rate_1_s', 0.0, 30.0),
    Unknown('x_rotate_natural_frequency_rad_s', 140.0, 165.0),
    Unknown('x_rotate_damping_ratio', 0.2, 0.36),
    Unknown('x_rotate_feedforward_ratio', 0.0, 0.1),
    Unknown('x_rotate_integral_rate_1_s', 0.0, 12.0),
)
"""Unknowns of the first stage: payload, counterweight, and the gains of Y-Linear and X-Rotate."""

Y_ROTATE = (
    Unknown('y_motor_inertia_kg_m2', 1.2e-5, 2e-4),
    Unknown('y_output_friction_nm', 0.02, 0.14),
    Unknown('y_gearbox_friction_nm', 0.01, 0.07),
    Unknown('y_gearbox_viscous_nm_s', 0.0, 3.6e-4),
    Unknown('belt_loss_factor', 0.001, 0.05),
    Unknown('y_rotate_natural_frequency_rad_s', 45.0, 62.0),
    Unknown('y_rotate_damping_ratio', 0.2, 0.45),
    Unknown('y_rotate_feedforward_ratio', 0.0, 1.4),
    Unknown('y_rotate_integral_rate_1_s', 0.0, 8.0),
)
"""Unknowns of the second stage: drive, friction and gains of Y-Rotate."""

CLEAR = 0.06

HOLD_S = 0.6
"""Time from the step up to the step down of the step experiments."""


@dataclass(frozen=True)
class Candidate:
    """The machines of one set of values, and the I-variables that go with them."""

    rigid: Machine
    flexible: Machine
    calculated: Machine
    simplified: Machine
    variables: dict[str, Values]


def candidate(values: Mapping[str, float]) -> Candidate:
    """Build the machines of a set of values; raises `UserError` for one that cannot be."""
    improved = describe(values)
    rigid = machine_of(as_rigid(improved))
    return Candidate(
        rigid,
        machine_of(improved),
        machine_of(describe(values, 'calculated')),
        machine_of(as_simplified(improved)),
        i_variables(values, rigid, pristine_twin(AXES[0]).servo_parameters[0]),
    )


def lack_of_oscillation(response: AxisResponse) -> float:
    """
    Return how far the end of a response is from a clear oscillation that lasts; zero if it is one.

    Decades below an amplitude of `CLEAR` steps, and ten for every unit by which it is less than
    what it was a while before.
    """
    found = late_oscillation(response)
    faint = max(0.0, math.log10(CLEAR / max(found.amplitude, 1e-4)))
    return faint + 40.0 * max(0.0, 1.0 - found.amplitude / max(found.before, 1e-4))


def evaluate_payload(values: Mapping[str, float]) -> Evaluation:
    """Return rows and conditions of Y-Linear and X-Rotate."""
    built = candidate(values)
    result = Evaluation()
    largest_current = 0.0
    flexible = {}
    for axis in ('y_linear', 'x_rotate'):
        for column, machine in (('rigid', built.rigid), ('flexible', built.flexible)):
            response = respond(machine, axis, built.variables, 0.3)
            flexible[axis] = response  # the last one stays
            result.residuals += residuals(response, column)
            largest_current = max(largest_current, float(np.max(np.abs(response.current_command))))
        # The loop with calculated damping must go on oscillating when the step has long settled.
        result.penalties[f'{axis}: unstable with calculated damping'] = lack_of_oscillation(
            respond(built.calculated, axis, built.variables, HOLD_S)
        )
        # Above some amplitude the voltage limit may keep up a vibration that decays below it.
        result.penalties[f'{axis}: at rest with improved damping'] = 200.0 * max(
            0.0, late_motion(flexible[axis], 0.005) - 0.006
        )
    servo = servo_record(built.variables)[0]
    for name, machine in (('flexible', built.flexible), ('simplified', built.simplified)):
        growth = fastest_growth(loop_modes(machine, servo, machine.timing), 40.0)
        result.penalties[f'{name} model stable with improved damping'] = 0.5 * min(
            max(0.0, growth + 1.5), 40.0
        )
    # A mode that grows fast enough for guide friction not to hold it, so that the search has a slope
    # towards machines that the calculated damping leaves unstable.
    calculated_growth = fastest_growth(
        loop_modes(built.calculated, servo, built.calculated.timing), 40.0
    )
    result.penalties['a mode grows with calculated damping'] = 0.05 * max(
        0.0, 12.0 - calculated_growth
    )
    simplified = respond(built.simplified, 'y_linear', built.variables, 0.3)
    difference = 100.0 * rms_difference(simplified, flexible['y_linear'])
    result.penalties['simplified model near the flexible one'] = min(
        max(0.0, difference / thesis()['steps']['y_linear']['step'] - 1.5), 10.0
    )
    result.penalties['within the range of the amplifier'] = 0.3 * max(0.0, largest_current - 38.5)
    connections = built.flexible.description.connections
    transverse = (
        connections['payload_bearing_x'].stiffness / connections['payload_bearing_z'].stiffness
    )
    result.penalties['transverse stiffness of a real guide'] = 20.0 * (
        max(0.0, transverse - 0.78) + max(0.0, 0.5 - transverse)
    )
    return result


def evaluate_y_rotate(values: Mapping[str, float]) -> Evaluation:
    """Return rows and conditions of Y-Rotate."""
    built = candidate(values)
    result = Evaluation()
    flexible = respond(built.flexible, 'y_rotate', built.variables, 0.6)
    result.residuals += residuals(respond(built.rigid, 'y_rotate', built.variables, 0.28), 'rigid')
    result.residuals += residuals(flexible, 'flexible')
    calculated = respond(built.calculated, 'y_rotate', built.variables, 0.6)
    farthest = late_oscillation(calculated).farthest
    result.penalties = {
        'limit cycle with calculated damping': lack_of_oscillation(calculated),
        'of bounded amplitude': 5.0 * max(0.0, farthest - 3.0),
        'stable with improved damping': 20.0 * max(0.0, late_motion(flexible, 0.1) / 2.0 - 0.01),
    }
    return result
