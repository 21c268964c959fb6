# SPDX-License-Identifier: Apache-2.0
"""
Least squares on the measured data sets of docs/real_data.md, against the figures of their owners.

Read from the folder that WAFERBOT_DATA names; skipped
where it names none.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.least_squares import Options, identify_by_least_squares
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.models import load_model_or_machine

DATA = Path(os.environ.get('WAFERBOT_DATA') or 'no measured data')

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason='no measured data: WAFERBOT_DATA (docs/real_data.md)'
)

OWNERS = {'inertia': 95.1089, 'viscous': 203.5034, 'coulomb': 20.3935, 'offset': -3.1648}
"""Of EMPS: kg, N s/m, N, N."""


def log_of(*parts, mapping, part=None):
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f'{path.name} is not there')
    return load_log(path, mapping, part=part, name=path.stem)


@pytest.fixture(scope='module')
def emps():
    names = ('DATA_EMPS.mat', 'DATA_EMPS_PULSES.mat')
    return [log_of('emps', name, mapping='emps') for name in names]


def fit_of(logs, validation=(), options=None, machine=None):
    variant = Variant.of(load_model_or_machine(machine)) if machine else None
    (fit,) = identify_by_least_squares(logs, validation, variant, options).fits
    return fit, dict(zip(fit.estimate.names, fit.estimate.value, strict=True))


def test_emps_has_the_figures_of_its_owners(emps) -> None:
    fit, found = fit_of(emps[:1], emps[1:])
    assert found == pytest.approx(OWNERS, rel=0.03)
    assert fit.fitted[0].relative < 0.045
    assert fit.validation[0].relative < 0.06


def test_both_records_together_have_them_too(emps) -> None:
    """Position and force as they stand in the records, as their owners took them."""
    _, found = fit_of(emps, options=Options(late_s=0.0))
    assert found == pytest.approx(OWNERS, rel=0.03)


def test_both_records_tell_that_a_held_force_acts_half_a_sample_later(emps) -> None:
    """The owners' drive holds its force for 1 ms; 0.5 ms is no more than the two errors away."""
    fit, found = fit_of(emps)
    assert 0.35e-3 < -fit.late_s < 0.6e-3
    for name in ('inertia', 'coulomb', 'offset'):
        assert found[name] == pytest.approx(OWNERS[name], rel=0.03)


def test_the_record_with_pulses_has_them_nearly(emps) -> None:
    """
    Mass, Coulomb friction and offset within 3 %; viscous friction 5 % more, which its interval allows.

    Friction of this axis depends on the direction and is no straight line in speed, and the pulses give
    this record another distribution of speeds.
    """
    fit, found = fit_of(emps[1:])
    for name in ('inertia', 'coulomb', 'offset'):
        assert found[name] == pytest.approx(OWNERS[name], rel=0.03)
    place = fit.estimate.names.index('viscous')
    assert fit.estimate.low95[place] < OWNERS['viscous'] < fit.estimate.high95[place]
    assert found['viscous'] == pytest.approx(OWNERS['viscous'], rel=0.06)


def test_emps_rubs_by_direction_less_at_rest_and_ripples_every_2_5_mm(emps) -> None:
    """The owners, too, have a variant with other friction in each direction: 165 and 239 N s/m."""
    fit, found = fit_of(emps[:1], emps[1:], Options(by_direction=True, rise=True))
    assert found['viscous_backward'] - found['viscous_forward'] > 50.0
    assert found['rise'] < -3.0
    plain, _ = fit_of(emps[:1], emps[1:])
    assert fit.validation[0].relative < 0.8 * plain.validation[0].relative
    assert plain.spectrum is not None
    period_mm = 1e3 / plain.spectrum.waves[plain.spectrum.lines[0]]
    assert period_mm == pytest.approx(2.5, rel=0.01)


@pytest.mark.parametrize('folder', ['ddp', 'direct_collocation'])
def test_the_pendulum_has_the_inertia_and_gravity_of_its_notes(folder) -> None:
    log = log_of('dfki_simple_pendulum', folder, 'data_measured.csv', mapping='dfki_pendulum')
    _, found = fit_of([log], options=Options(orders=(1.0,)))
    assert found['inertia'] == pytest.approx(0.182, rel=0.05)
    assert found['sine_1'] == pytest.approx(0.362 * 9.81, rel=0.05)
    assert 0.15 < found['coulomb'] < 0.23


def test_cogging_orders_of_two_motors_stand_out_by_themselves() -> None:
    slow = log_of(
        'odrive_cogging', 'slow_velocity', 'nocomp_0.npy', mapping='odrive_slow_velocity'
    )
    fast = log_of('laas_mn4004_cogging', 'speed_test.txt', mapping='laas_speed')
    for log, orders in ((slow, {7, 28}), (fast, {72, 18, 12})):
        fit, _ = fit_of([log])
        assert fit.spectrum is not None
        found = {round(2.0 * np.pi * fit.spectrum.waves[place]) for place in fit.spectrum.lines}
        assert orders <= found


def test_both_halves_of_a_spin_up_have_one_inertia_and_one_friction() -> None:
    """The motor of the LAAS on its own, +-150 rad/s; of it no owner's figure is known."""
    log = log_of('laas_mn4004_cogging', 'acc_current.txt', mapping='laas_motion')
    fits = []
    for early in (True, False):
        signals = []
        for signal in log.signals:
            mine = (signal.time_s < 16.5) == early
            signals.append(replace(signal, time_s=signal.time_s[mine], value=signal.value[mine]))
        fits.append(fit_of([MeasuredLog('half', tuple(signals))], machine='solo_motor'))
    for fit, _ in fits:
        assert fit.force_unit == 'Nm'
        assert fit.fitted[0].relative < 0.05
    for name in ('inertia', 'coulomb'):
        one, other = (found[name] for _, found in fits)
        assert one == pytest.approx(other, rel=0.03)
