# SPDX-License-Identifier: Apache-2.0
"""The force that a model leaves over: of a slide by its equation of motion, read late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_twin.diagnosis.force_error import force_error
from waferbot_twin.diagnosis.reference import reference_of, reference_remarks
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.problem import Cause, apply_all

AXIS, FRICTION_N, DAMPING, LATE_S = 'y_linear', 20.0, 200.0, 4e-3


@pytest.fixture(scope='module')
def slide():
    return Variant.of(load_model_or_machine('emps'))


def log(mass, name='one', phase=0.0):
    """Return a log of two sines: force by the equation of motion, positions of some time before."""
    time_s = np.arange(0.0, 20.0, 1e-3)
    wave, size = np.array([2.0, 5.3]), np.array([0.05, 0.02])

    def angles(at_s):
        return np.outer(at_s, wave) + phase

    speed = np.cos(angles(time_s)) @ (size * wave)
    acceleration = -np.sin(angles(time_s)) @ (size * wave**2)
    force = mass * acceleration + DAMPING * speed + FRICTION_N * np.sign(speed)
    return MeasuredLog(
        name,
        (
            Signal('position', AXIS, 'm', time_s, np.sin(angles(time_s - LATE_S)) @ size, 1e-7),
            Signal('force', AXIS, 'N', time_s, force),
        ),
    )


def with_causes(nominal, **values):
    causes = [Cause(find(name), AXIS, own) for name, own in values.items()]
    return apply_all(nominal, causes)


RIGHT = {
    'coulomb_friction': {'friction': FRICTION_N},
    'viscous_friction': {'damping': DAMPING},
    'encoder_delay': {'delay': 1e3 * LATE_S},
}


def left_out_of_it(measured, fit, slide, left_out=None):
    own = {name: values for name, values in RIGHT.items() if name != left_out}
    return force_error(measured, fit, slide, with_causes(slide, **own))


def test_the_right_model_leaves_nothing_of_the_force_and_each_cause_counts(slide):
    measured = log(places.moving_inertia(slide, AXIS))
    # As if nobody had seen yet that the positions are late: the model has to know it.
    fit = replace(reference_of([measured], [], slide).fits[0], late_s=0.0)
    assert left_out_of_it(measured, fit, slide) < 0.01
    assert left_out_of_it(measured, fit, slide, 'coulomb_friction') > 0.2
    assert left_out_of_it(measured, fit, slide, 'viscous_friction') > 0.2
    assert left_out_of_it(measured, fit, slide, 'encoder_delay') > 0.02


def test_what_is_known_to_be_late_is_not_late_twice(slide):
    measured = log(places.moving_inertia(slide, AXIS))
    fit = reference_of([measured], [], slide).fits[0]
    assert fit.late_s == pytest.approx(-LATE_S, rel=0.1)
    assert left_out_of_it(measured, fit, slide, 'encoder_delay') < 0.01
    assert left_out_of_it(measured, fit, slide) > 0.02


def test_errors_of_both_models_stand_beside_those_of_least_squares(slide):
    mass = places.moving_inertia(slide, AXIS)
    logs = [log(mass)], [log(mass, 'two', 1.0)]
    extended = with_causes(slide, **{k: v for k, v in RIGHT.items() if k != 'encoder_delay'})
    reference = reference_of(*logs, slide, extended)
    for error in (*reference.fits[0].fitted, *reference.fits[0].validation):
        nominal, known = error.of_models
        assert nominal > 0.5
        assert known < 0.01
    own, other, *_ = reference_remarks(reference)
    assert 'the nominal model leaves' in own
    assert other.startswith('Carriage in two (not used for the fit): ')


def test_of_several_motors_nothing_is_said(slide):
    rigid = Variant.of(load_model('rigid'))
    measured = log(places.moving_inertia(slide, AXIS))
    fit = reference_of([measured], [], slide).fits[0]
    assert force_error(measured, fit, rigid, rigid) is None
