# SPDX-License-Identifier: Apache-2.0
"""The play between two encoders, from readings that are made of a formula."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from waferbot_lockstep.contract import ENCODERS
from waferbot_twin.diagnosis.proposals.offered import offered_effects
from waferbot_twin.diagnosis.proposals.play import gaps_of
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model

AXIS = 'y_rotate'
LOAD, MOTOR = ENCODERS.index('y_rotate_load'), ENCODERS.index('y_rotate_motor')


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


def record_of(variant, gap, zero, pushed_first, missing=()):
    """Return readings of a load that is half a gap ahead of its motor, then behind, as it is pushed."""
    time_s = np.linspace(0.0, 2.0, 4000)
    angle = 0.6 * np.sin(2.0 * np.pi * time_s) + zero
    pushed = np.sign(np.sin(4.0 * np.pi * time_s + 0.1)) * (1.0 if pushed_first else -1.0)
    encoders = variant.description.encoders
    placing = variant.rigid.placing
    reading = np.full((len(time_s), len(ENCODERS)), np.nan)
    for place, apart in ((LOAD, 0.5 * gap * pushed), (MOTOR, 0.0 * time_s)):
        encoder = encoders[ENCODERS[place]]
        ratio = placing[encoder.coordinate][1] / placing[variant.description.axes[AXIS]][1]
        reading[:, place] = np.floor((angle + apart) * encoder.counts_per_unit * ratio)
    reading[list(missing)] = np.nan
    return SimpleNamespace(reading=reading)


def steps(variant):
    """Return the step of both encoders together, rad of the axis."""
    encoders, placing = variant.description.encoders, variant.rigid.placing
    own = placing[variant.description.axes[AXIS]][1]
    return sum(
        abs(own / encoders[name].counts_per_unit / placing[encoders[name].coordinate][1])
        for name in ('y_rotate_load', 'y_rotate_motor')
    )


@given(st.floats(1e-3, 3e-2), st.floats(-3.0, 3.0), st.booleans())
def test_the_gap_is_known_to_the_steps_of_the_encoders(gap, zero, pushed_first):
    variant = Variant.of(load_model('rigid'))
    found = gaps_of(variant, [record_of(variant, gap, zero, pushed_first, range(10, 500))])
    assert found.keys() == {AXIS}
    assert abs(found[AXIS] - gap) <= 2.0 * steps(variant)


def test_one_encoder_says_nothing(rigid):
    record = record_of(rigid, 0.01, 0.0, True)
    record.reading[:, MOTOR] = np.nan
    assert gaps_of(rigid, [record]) == {}


def test_backlash_is_offered_with_the_gap_that_the_logs_show(rigid, monkeypatch):
    from waferbot_twin.diagnosis.proposals import offered

    monkeypatch.setattr(offered, 'gaps_of', lambda variant, records: {AXIS: 0.004})
    problem = SimpleNamespace(nominal=rigid, records=[], plants=[])
    monkeypatch.setattr(offered, 'folded_back', lambda problem: [])
    monkeypatch.setattr(offered, 'limited_commands', lambda problem: [])
    monkeypatch.setattr(offered, 'coarser_steps', lambda nominal, records: {})
    effects = [one for one in offered_effects(problem, ()) if one.name == 'backlash']
    assert len(effects) == 2
    assert effects[1].axes(rigid) == (AXIS,)
    assert effects[1].trials(rigid, AXIS) == ({'gap': 0.004},)
