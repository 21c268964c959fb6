# SPDX-License-Identifier: Apache-2.0
"""
The thesis' own story: from logs of the machine as built and the rigid model to what lacks.

The logs are those of `waferbot demo`. The library is cut down to what every machine has some of and the
settings of the controller, to save time; `make demo` has all of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.demo import FINDING, JUDGING, make_logs
from waferbot_twin.diagnosis.diagnose import diagnose
from waferbot_twin.effects import library
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals.drive_block import driven_currents
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.load import load_records

pytestmark = pytest.mark.slow

LACKING = {
    'cable_compliance:y_linear',
    'bearing_moment_compliance:x_rotate',
    'belt_compliance:y_rotate',
    'gearbox_friction:y_rotate',
}
"""What chapter 6 adds to the rigid model; of belt and gearbox, in series, the softer one."""

KEPT = ('wrong_bias',)


@pytest.mark.xfail(
    reason='with compliances of several axes at once other causes are named: force constant, payload',
    run=False,  # it takes ten minutes
)
def test_from_the_rigid_model_to_the_machine_as_built(tmp_path):
    make_logs(tmp_path)
    nominal = Variant.of(load_model('rigid'))
    finding, judging = (
        load_records([tmp_path / name for name in names], nominal) for names in (FINDING, JUDGING)
    )
    without = [
        effect.name
        for effect in library().values()
        if not effect.usual and effect.name not in KEPT
    ]
    result = diagnose(nominal, finding, judging, lambda *told: None, 1, without)
    names = {found.cause.name for found in result.causes}
    assert names >= LACKING, names
    # 40 % at least of what the thesis gained with its flexible model, and it is said that more lacks.
    gains = {item.axis: item.improvement_percent for item in result.gains}
    assert gains['y_linear'] > 30.0, gains
    assert gains['y_rotate'] > 50.0, gains
    assert result.verdict == 'partly'


def test_currents_of_a_log_without_any_are_those_that_the_drive_makes():
    timing = Timing()
    variant = Variant.of(load_model('rigid'))
    twin = Twin.of(variant.model(), timing, load_experiment('step'))
    record = record_of_signals('step', twin.advance(timing.ticks(0.1)))
    nothing = replace(record, line_current=np.zeros_like(record.line_current), terminals=None)
    made = driven_currents(nothing, variant)
    settled = slice(timing.ticks(0.03), None)
    error = np.sqrt(np.mean((made - record.line_current)[settled] ** 2, axis=0))
    assert np.all(error < 0.05 * np.sqrt(np.mean(record.line_current[settled] ** 2, axis=0))), (
        error
    )
