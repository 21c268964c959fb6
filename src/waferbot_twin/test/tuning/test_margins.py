# SPDX-License-Identifier: Apache-2.0
"""Margins against closed forms, against python-control, and against eigenvalues at the limit."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.timing import Timing
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.closed_loop import closed, modes_of, sampled_plant, servo_law
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.models import load_model
from waferbot_twin.tuning.loop import Linearised
from waferbot_twin.tuning.margins import margins

TIMING = Timing()
GRID_HZ = np.geomspace(1e-3, 1e3, 4000)

RETUNED = {'Ixx30': 2323, 'Ixx31': 13704, 'Ixx32': 5028, 'Ixx33': 36835}
"""Gains of Y-Rotate with which the loop of every model is stable."""

NOTCH = {'Ixx36': -1.0847807, 'Ixx37': 0.99107218, 'Ixx38': -0.96733308, 'Ixx39': 0.77550173}


def test_margins_of_three_lags_are_those_of_the_textbook():
    """L = K / (1 + s)^3: real and negative at w = sqrt(3), where |L| = K / 8."""

    def loop(frequency_hz):
        return 4.0 / (1.0 + 2j * np.pi * frequency_hz) ** 3

    found = margins(GRID_HZ, loop(GRID_HZ), loop)
    assert found.gain_db == pytest.approx(20.0 * math.log10(2.0), abs=1e-9)
    assert found.gain_hz == pytest.approx(math.sqrt(3.0) / (2.0 * math.pi), rel=1e-9)
    crossover = math.sqrt(4.0 ** (2.0 / 3.0) - 1.0)
    phase = math.pi - 3.0 * math.atan(crossover)
    assert found.phase_deg == pytest.approx(math.degrees(phase), abs=1e-9)
    assert found.delay_s == pytest.approx(phase / crossover, rel=1e-9)
    quick = margins(GRID_HZ, loop(GRID_HZ))
    assert quick.gain_db == pytest.approx(found.gain_db, abs=1e-3)
    assert quick.phase_deg == pytest.approx(found.phase_deg, abs=1e-3)


def test_a_loop_without_crossings_has_no_limit():
    found = margins(GRID_HZ, 0.5 / (1.0 + 2j * np.pi * GRID_HZ))
    assert found.gain_db == found.phase_deg == found.delay_s == math.inf
    assert math.isnan(found.crossover_hz)


def variant_of(model, axis_gains=None):
    variant = Variant.of(load_model(model))
    return variant.with_overlay(Overlay(pmac=axis_gains or {}))


def linearised(variant, pose):
    return Linearised.of(variant.name, variant.build(TIMING), pose, TIMING)


def by_control(variant, pose, axis):
    """Return (gain dB, phase degrees) of python-control, from the blocks' matrices alone."""
    servo = servo_parameters(variant.pmac)[0]
    plant = sampled_plant(variant.build(TIMING), TIMING, pose)
    law = servo_law(servo)
    cycle_s = 1.0 / TIMING.servo_hz
    zeros = np.zeros((4, 3))
    machine = control.ss(plant.state, plant.input, plant.output, zeros, cycle_s)
    pmac = control.ss(law.state, law.input, law.output, law.feedthrough, cycle_s)
    product = pmac * machine  # commands over commands, 3 x 3
    place = AXES.index(axis)
    others = np.eye(3)
    others[place, place] = 0.0
    opened = control.feedback(product, control.ss([], [], [], others, cycle_s), sign=1)
    omega = 2.0 * np.pi * np.geomspace(0.2, 0.4999 * TIMING.servo_hz, 30000)
    response = opened.frequency_response(omega)
    frd = control.FRD(-response.frdata[place, place], omega, smooth=True)
    gain, phase, *_ = control.stability_margins(frd)
    gains_db = [20.0 * math.log10(gain)]
    at_nyquist = -opened(-1.0)[place, place].real  # python-control looks for crossings only
    if at_nyquist < 0.0:
        gains_db.append(-20.0 * math.log10(-at_nyquist))
    return min(gains_db, key=abs), phase


@pytest.mark.slow
@pytest.mark.parametrize(
    ('model', 'pose', 'axis', 'gains'),
    [
        ('rigid', {}, 'y_linear', {}),
        ('rigid', {'x_rotate': 0.8}, 'x_rotate', {}),
        ('flexible', {}, 'x_rotate', {}),
        ('flexible', {'x_rotate': 1.2, 'y_linear': 0.2}, 'y_rotate', RETUNED),
        ('as_built', {'x_rotate': 0.4}, 'y_rotate', RETUNED),
        ('as_built', {}, 'x_rotate', {}),
        ('as_built', {'x_rotate': -0.5}, 'y_linear', {**NOTCH, 'Ixx31': 2421}),
        ('flexible', {}, 'y_linear', {'feedback_filter': 1.5, 'command_delay': 2}),
    ],
)
def test_margins_agree_with_python_control(model, pose, axis, gains):
    variant = variant_of(model, {axis: gains})
    servo = servo_parameters(variant.pmac)[0]
    found = linearised(variant, pose).loop(servo, axis).margins
    gain_db, phase_deg = by_control(variant, pose, axis)
    assert found.gain_db == pytest.approx(gain_db, abs=0.1)
    assert found.phase_deg == pytest.approx(phase_deg, abs=0.1)


@pytest.mark.parametrize(('axis', 'gains'), [('x_rotate', {}), ('y_rotate', RETUNED)])
def test_the_gain_margin_is_where_a_mode_begins_to_grow(axis, gains):
    """Ixx30 multiplies the whole law: a little below its margin the loop decays, above it grows."""
    model = 'flexible' if axis == 'x_rotate' else 'as_built'
    variant = variant_of(model, {'y_rotate': RETUNED, axis: gains})
    servo = servo_parameters(variant.pmac)
    machine = linearised(variant, {})
    found = machine.loop(servo[0], axis).margins
    plant = machine.plant
    base = modes_of(closed(plant, servo_law(servo[0])), TIMING)
    grows_anyway = sum(mode.growth_rate > 1e-3 for mode in base)
    place = AXES.index(axis)
    counts = []
    for share in (0.99, 1.01):
        changed = servo.copy()
        changed['Ixx30'][0, place] *= share * 10.0 ** (found.gain_db / 20.0)
        modes = modes_of(closed(plant, servo_law(changed[0])), TIMING)
        counts.append(sum(mode.growth_rate > 1e-3 for mode in modes) - grows_anyway)
    assert counts[0] == 0
    assert counts[1] >= 1


def test_present_gains_of_the_as_built_y_rotate_need_their_friction():
    """Without dry friction its belt grows at 10 Hz, and no other axis is to blame."""
    variant = variant_of('as_built')
    machine = linearised(variant, {})
    servo = servo_parameters(variant.pmac)[0]
    assert not machine.loop(servo, 'y_rotate').stable
    assert machine.loop(servo, 'x_rotate').stable
    retuned = servo_parameters(variant_of('as_built', {'y_rotate': RETUNED}).pmac)[0]
    assert machine.loop(retuned, 'y_rotate').stable
