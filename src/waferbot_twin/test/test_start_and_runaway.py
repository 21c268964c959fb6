# SPDX-License-Identifier: Apache-2.0
"""The beginning of a run, at rest, and the end of one that blew up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import plant, statics
from waferbot_twin.engines import inprocess
from waferbot_twin.engines.inprocess import Runaway, Twin
from waferbot_twin.plan import Plan, make_plan
from waferbot_twin.recording.reader import read_recording


def twin_of(plan: Plan) -> Twin:
    return Twin.of(plan.model, plan.timing, plan.experiment)


@pytest.mark.parametrize('model', ['rigid', 'simplified', 'flexible'])
def test_idle_machine_stays_still_to_a_count(model: str) -> None:
    """From tick 0 on, with the weight of X-Rotate held; a count is 0.1 um or 6 urad."""
    plan = make_plan(model, 'constant', 0.1)
    twin = twin_of(plan)
    held = statics.holding_currents(twin.machine, twin.plant_parameters, {})
    assert abs(held['x_rotate']) > 5.0
    signals = twin.advance(plan.ticks)
    moved = signals.counts - signals.counts[0]
    assert np.abs(moved).max() <= 1
    # the first voltage is that which keeps up the current
    resistance = twin.plant_parameters[0]['resistance'][1]
    assert signals.voltage[0, 3:5] == pytest.approx(
        resistance * signals.line_current[0, 2:4], rel=0.02, abs=0.1
    )


def test_without_holding_currents_it_would_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check above can fail: begun without current, the axis drops by counts."""
    monkeypatch.setattr(
        plant.Machine, 'resting_state', lambda self, parameters: self.initial_state(parameters)
    )
    plan = make_plan('rigid', 'constant', 0.1)
    twin = twin_of(plan)
    twin.amplifier_state['starting'] = 0
    moved = np.abs(twin.advance(plan.ticks).counts)
    assert moved.max() > 1


def test_machine_that_cannot_be_held_begins_without_currents(tmp_path: Path) -> None:
    path = tmp_path / 'cart.yaml'
    path.write_text(
        """
name: cart with a pendulum
bodies:
  cart: {mass_kg: 5, centre_of_gravity_m: [0, 0, 0], inertia_kg_m2: {xx: 0.1, yy: 0.1, zz: 0.1}}
  bob: {mass_kg: 1, centre_of_gravity_m: [0, -0.3, 0], inertia_kg_m2: {xx: 0.01, yy: 0.01, zz: 0.01}}
joints:
  rail:
    parent: base
    child: cart
    at_m: [0, 0, 0]
    freedoms: {travel: {type: prismatic, axis: [1, 0, 0]}}
  pin: {parent: cart, child: bob, at_m: [0, 0, 0], freedoms: {swing: {type: revolute, axis: [0, 0, 1]}}}
axes: {y_linear: travel}
"""
    )
    machine = plant.load_machine(path)
    parameters = machine.parameters()
    with pytest.raises(statics.NoEquilibrium):
        machine.initial_state(parameters, holding=True)
    state = machine.resting_state(parameters)
    assert not state[0]['winding_current'].any()
    assert not state[0]['position'].any()


@pytest.mark.parametrize('value', [np.nan, np.inf, -1e9])
def test_blow_up_is_an_error_that_names_axis_and_tick(value: float) -> None:
    plan = make_plan('rigid', 'constant', 0.1)
    twin = twin_of(plan)
    twin.advance(200)
    twin.plant_state[0]['velocity'][1] = value
    twin.plant_state[0]['position'][1] = value
    with pytest.raises(Runaway, match=r'blew up by tick 360 \(0\.0200 s\): axis') as caught:
        twin.advance(1000)
    assert twin.tick == 360
    signals = caught.value.signals
    assert (signals.first, signals.ticks) == (200, 160)
    assert len(signals.voltage) == 160
    assert len(signals.counts) == len(signals.encoder_ticks) == 80


def test_absurd_speed_names_its_axis() -> None:
    machine = plant.load_machine('rigid')
    state = machine.initial_state(machine.parameters())
    assert plant.runaway(state) == -1
    state[0]['velocity'][:3] = 2e5, 0.0, -3e5
    assert plant.runaway(state) == 2
    assert 'axis y_rotate' in machine.runaway_message(2, 180)
    state[0]['position'][0] = np.nan
    assert plant.runaway(state) == 0


def test_recording_of_a_blow_up_ends_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was recorded is finite, and everything up to the check is there."""
    plan = make_plan('rigid', 'constant', 1.0)
    original = Twin.advance

    def advance(self: Twin, ticks: int):
        signals = original(self, ticks)
        if ticks > 1:  # not the twin that only compiles
            self.plant_state[0]['velocity'][0] = np.nan
        return signals

    monkeypatch.setattr(Twin, 'advance', advance)
    out = tmp_path / 'run'
    with pytest.raises(UserError, match='the plant blew up by tick 9000'):
        inprocess.run(plan, out, False, lambda done, total: None)
    recording = read_recording(out)
    for topic in ('phase_currents', 'phase_voltages'):
        array = next(
            recording[known] for known in inprocess.CONTRACT_TOPICS if known.name == topic
        )
        assert len(array) == 9000
        values = array['current' if topic == 'phase_currents' else 'voltage']
        assert np.isfinite(values).all()
