# SPDX-License-Identifier: Apache-2.0
"""
A real ball-screw axis (EMPS, docs/real_data.md): four parameters through the simulation.

The truth is inverse-dynamics least squares on the same record. Data of the
folder that WAFERBOT_DATA names; skipped without.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.identification.least_squares import Options, identify_by_least_squares
from waferbot_twin.logs.load import load_log
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import aligned_records, sized_by
from waferbot_twin.residuals.problem import Cause, Problem

FOLDER = Path(os.environ.get('WAFERBOT_DATA', ''), 'emps')
MASS_KG = 95.1089  # of the description
FOUR = ('coulomb_friction', 'viscous_friction', 'wrong_inertia', 'constant_force')


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.exists(), reason='no data of the EMPS axis')
@pytest.mark.parametrize('place', [0, 1])
def test_mass_friction_and_offset_are_those_of_least_squares(place):
    nominal = Variant.of(load_model_or_machine('emps'))
    names = 'DATA_EMPS.mat', 'DATA_EMPS_PULSES.mat'
    logs = [load_log(FOLDER / name, 'emps', name=name) for name in names]
    record = aligned_records(logs, nominal)[place]
    variant = sized_by([record], nominal)
    begun = tuple(
        Cause(
            find(name),
            'y_linear',
            {
                item.name: item.neutral + 0.1 * (item.typical - item.neutral)
                for item in find(name).parameters(variant, 'y_linear')
            },
        )
        for name in FOUR
    )
    found = fit_causes(Problem(variant, [record]), begun)
    friction, damping, more_mass, force = (
        next(iter(cause.values.values())) for cause in found.causes
    )
    (fit,) = identify_by_least_squares([logs[place]], (), nominal, Options()).fits
    reference = dict(zip(fit.estimate.names, fit.estimate.value, strict=True))
    assert {
        'inertia': MASS_KG + more_mass,
        'viscous': damping,
        'coulomb': friction,
        'offset': -force,
    } == pytest.approx(reference, rel=0.03)
