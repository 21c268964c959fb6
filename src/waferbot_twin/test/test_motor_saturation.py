# SPDX-License-Identifier: Apache-2.0
"""
Saturation of a motor that is known by its force per ampere alone, in a log with its current.

The machine is a rotor with viscous friction in explicit steps: no code of the twin makes the log.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import record_of_measured_log, sized_by
from waferbot_twin.residuals.problem import Cause, Problem

AXIS = 'x_rotate'
SEED = 11
INERTIA, VISCOUS, PER_AMPERE = 9e-6, 6e-5, 0.0318
CURVATURE = 0.02


@pytest.fixture(scope='module')
def motor():
    return Variant.of(load_model_or_machine('solo_motor'))


def moves(drive):
    """Return a log of 4 s at 1 kHz with currents to 5 A, of which a fifth is lost at the largest."""
    random = np.random.default_rng(SEED)
    print(f'seed {SEED}')
    count, every, step_s = 4000, 20, 5e-5
    levels = np.repeat(random.uniform(-5.0, 5.0, count // 40), 40)
    speed = angle = 0.0
    angles = np.zeros(count)
    for place in range(count):
        angles[place] = angle
        for _ in range(every):
            level = levels[place]
            force = PER_AMPERE * level / np.sqrt(1.0 + CURVATURE * level**2)
            speed += (force - VISCOUS * speed) / INERTIA * step_s
            angle += speed * step_s
    time_s = np.arange(count) * step_s * every
    counts = np.round(angles * 20000 / (2.0 * np.pi)) * 2.0 * np.pi / 20000
    kind, unit, value = drive
    return MeasuredLog(
        'log',
        (
            Signal('position', AXIS, 'rad', time_s, counts),
            Signal(kind, AXIS, unit, time_s, value * levels, hold='zero_order'),
        ),
    )


def test_the_curvature_is_found_beside_friction(motor) -> None:
    record = record_of_measured_log(moves(('current', 'A', 1.0)), motor)
    nominal = sized_by([record], motor)
    causes = [
        Cause(effect, AXIS, effect.complete(nominal, AXIS, {}))
        for effect in map(find, ('motor_saturation', 'viscous_friction'))
    ]
    saturation, friction = fit_causes(Problem(nominal, [record]), tuple(causes)).causes
    assert saturation.values['curvature'] == pytest.approx(CURVATURE, rel=0.03)
    assert friction.values['damping'] == pytest.approx(VISCOUS, rel=0.03)


def test_where_a_force_was_logged_nothing_saturates(motor) -> None:
    record = record_of_measured_log(moves(('force', 'Nm', PER_AMPERE)), motor)
    nominal = sized_by([record], motor)
    assert AXIS not in find('motor_saturation').axes(nominal)
    assert AXIS in find('motor_saturation').axes(replace(nominal, force_driven=frozenset()))
