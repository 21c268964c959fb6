# SPDX-License-Identifier: Apache-2.0
"""Small machines on bearings, and their charts read by SciPy alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import plant_machines as machines
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from waferbot_plant.plant import Machine, load_machine

MASS = 20.0
OVERHANG = 0.08
GRAVITY = 9.80665
"""That of the static load; g of the machines too, so that both agree."""

BOTH = np.array([-1.0, 1.0])

RADIAL = {
    'load_n': [0, 60, 120, 200, 300, 450, 600],
    'deflection_um': [0, 0.55, 0.95, 1.4, 1.9, 2.6, 3.25],
}
MOMENT = {
    'moment_nm': [0, 5, 12, 20, 30, 45],
    'tilt_urad': [0, 30, 60, 90, 125, 172],
}
RING = {
    'kind': 'cross_roller_bearing', 'radial': RADIAL, 'moment': MOMENT, 'load_variability': 0.25,
    'pitch_diameter_m': 0.13, 'friction_coefficient': 0.01, 'loss_factor': 0.0,
}  # fmt: skip

PRESSED = {'load_n': [0, 100, 250, 500, 900], 'deflection_um': [0, 0.7, 1.5, 2.6, 4.1]}
PULLED = {'load_n': [0, 100, 250, 500, 900], 'deflection_um': [0, 0.8, 1.8, 3.2, 5.2]}
ACROSS = {'load_n': [0, 100, 250, 500, 900], 'deflection_um': [0, 0.9, 2.1, 3.9, 6.6]}
GUIDE = {
    'kind': 'linear_bearing', 'vertical_spacing_m': 0.2, 'horizontal_spacing_m': 0.3,
    'radial': PRESSED, 'reverse': PULLED, 'transverse': ACROSS, 'load_variability': 0.25,
    'friction_coefficient': 0.003, 'seal_force_per_block_n': 1.5, 'loss_factor': 0.0,
}  # fmt: skip

SPRINGS = {
    'ring': {'radial_y': ('prismatic', [0, 1, 0]), 'about_y': ('revolute', [0, 1, 0]),
             'about_z': ('revolute', [0, 0, 1])},
    'guide': {'about_x': ('revolute', [1, 0, 0]), 'about_y': ('revolute', [0, 1, 0]),
              'about_z': ('revolute', [0, 0, 1])},
}  # fmt: skip


def on_bearing(
    kind: str, flexible: tuple[str, ...], stiffness_by: str = 'chart', **more: Any
) -> dict[str, Any]:
    """
    Return 20 kg whose weight hangs 80 mm beyond a ring or guide, which gives in some directions.

    Off the axis of the bearing along z too, on a guide that travels along y (`travel`) or a ring that
    turns about x (`turn`).
    """
    part = {'ring': RING, 'guide': GUIDE}[kind]
    freedoms = {
        name: {'type': type_, 'axis': axis, 'held_by': [name]}
        for name, (type_, axis) in SPRINGS[kind].items()
    }
    if kind == 'guide':
        freedoms['travel'] = {'type': 'prismatic', 'axis': [0, 1, 0]}
    else:
        freedoms['turn'] = {'type': 'revolute', 'axis': [1, 0, 0]}
    return {
        'name': kind,
        'gravity_m_s2': [0, -GRAVITY, 0],
        'bodies': {
            'load': {
                'mass_kg': MASS, 'centre_of_gravity_m': [OVERHANG, 0, 0.04 * (kind == 'guide')],
                'inertia_kg_m2': {'xx': 0.4, 'yy': 0.5, 'zz': 0.5},
            }
        },
        'joints': {
            'mount': {'parent': 'base', 'child': 'load', 'at_m': [0, 0, 0], 'freedoms': freedoms}
        },
        'parts': {'bearing': part},
        'connections': {
            name: {
                'state': 'flexible' if name in flexible else 'rigid',
                'part': 'bearing', 'direction': name, 'stiffness_by': stiffness_by,
            }
            for name in SPRINGS[kind]
        },
        **more,
    }  # fmt: skip


def load(description: dict[str, Any]) -> tuple[Machine, np.ndarray, np.ndarray]:
    """Return machine, parameters and state of a description."""
    machine = load_machine(machines.write(description))
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


class Chart:
    """A chart in SI units as an odd curve by SciPy: force, slope, energy, deflection."""

    def __init__(self, loads: list[float], micro: list[float]) -> None:
        e, f = 1e-6 * np.array(micro), np.array(loads, float)
        self.end = e[-1], f[-1]
        self._curve = PchipInterpolator(np.append(-e[:0:-1], e), np.append(-f[:0:-1], f))
        self._slope, self._energy = self._curve.derivative(), self._curve.antiderivative()

    def force(self, at: float) -> float:
        beyond = max(abs(at) - self.end[0], 0.0)
        inside = float(np.clip(at, -self.end[0], self.end[0]))
        return float(self._curve(inside) + np.sign(at) * beyond * self._slope(self.end[0]))

    def slope(self, at: float) -> float:
        return float(self._slope(min(abs(at), self.end[0])))

    def energy(self, at: float) -> float:
        return float(self._energy(abs(at)) - self._energy(0.0))

    def deflection(self, load: float) -> float:
        return float(
            brentq(lambda at: self.force(at) - load, *(20.0 * self.end[0] * BOTH), xtol=1e-18)
        )


RADIAL_CHART = Chart(*RADIAL.values())
MOMENT_CHART = Chart(*MOMENT.values())
PRESSED_CHART, PULLED_CHART, ACROSS_CHART = (
    Chart(*chart.values()) for chart in (PRESSED, PULLED, ACROSS)
)
