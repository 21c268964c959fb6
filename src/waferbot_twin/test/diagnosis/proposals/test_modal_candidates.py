# SPDX-License-Identifier: Apache-2.0
"""The compliance that makes a line in the spectrum of what is left over."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_plant.modes import Mode, coupled_modes
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.proposals.compliance_scan import TUNING, tuned
from waferbot_twin.diagnosis.proposals.modal_candidates import (
    _agrees,
    _folded,
    _in_continuous_time,
)
from waferbot_twin.diagnosis.proposals.rings import Rings
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.diagnosis.proposals.spectral_lines import Line, lines
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate, width_of
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import PLANT, Cause, Problem, apply_all

RATE_HZ = 2250.0
RIVALS = ('belt_compliance', 'gearbox_compliance', 'bearing_moment_compliance')


def test_a_mode_in_steps_is_as_slow_as_the_implicit_midpoint_rule_makes_it():
    step_s, frequency_hz = 1.0 / 18000.0, 3823.0
    omega = 2.0 * np.pi * _in_continuous_time(frequency_hz, step_s)
    system = np.array([[0.0, 1.0], [-(omega**2), 0.0]])
    half = 0.5 * step_s * system
    advance = np.linalg.solve(np.eye(2) - half, np.eye(2) + half)
    turned = np.abs(np.angle(np.linalg.eigvals(advance)))  # rad a step, exactly
    assert turned == pytest.approx(2.0 * np.pi * frequency_hz * step_s, rel=1e-9)
    assert omega / (2.0 * np.pi) > 1.15 * frequency_hz


def test_a_line_is_looked_for_where_samples_fold_it():
    line = Line('x_rotate', 676.0, 10.0, RATE_HZ)
    samples = np.arange(1000) / RATE_HZ
    shown = np.cos(2.0 * np.pi * line.frequency_hz * samples)
    found = _folded(line, 9000.0)
    assert len(found) == 5
    for frequency_hz, sign in found:
        assert np.cos(2.0 * np.pi * frequency_hz * samples) == pytest.approx(shown, abs=1e-8)
        higher = (frequency_hz + 1.0) % RATE_HZ
        assert min(higher, RATE_HZ - higher) == pytest.approx(line.frequency_hz + sign)
    assert max(frequency for frequency, _ in _folded(line, 3000.0)) < 3000.0


@pytest.mark.parametrize(
    ('other', 'may'), [(0.0, True), (0.3, True), (-0.3, True), (300.0, False)]
)
def test_a_mode_that_would_show_more_in_another_encoder_made_no_line(other, may):
    seed = 20261126
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    time_s = np.arange(4500) / RATE_HZ
    ringing = random.normal(0.0, 1.0, 4500) + 0.5 * np.sin(2.0 * np.pi * 612.0 * time_s)
    channels = {'y_linear': ringing, 'x_rotate': random.normal(0.0, 1.0, 4500)}
    problem = SimpleNamespace(
        channel_names=lambda block: list(channels), plant_rates_hz=[RATE_HZ] * 2
    )
    base = SimpleNamespace(residuals={PLANT: list(channels.values())})
    encoders = {
        'y_linear': SimpleNamespace(coordinate='slide', counts_per_unit=100.0),
        'x_rotate': SimpleNamespace(coordinate='arm', counts_per_unit=-50.0),
    }
    problem.nominal = SimpleNamespace(description=SimpleNamespace(encoders=encoders))
    (line,) = lines(problem, base)
    mode = Mode(612.0, 0.0, {'slide': 1.0, 'arm': 2.0 * other}, {})
    assert _agrees(problem, base, mode, line) == may
    assert not _agrees(problem, base, replace(mode, shape={'slide': 0.0, 'arm': 1.0}), line)


def log_of(variant, duration_s):
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, variant.name)
    twin.commanded = commanded_positions(
        load_experiment('step'), twin.servo_parameters, timing.servo_hz
    )
    return record_of_signals('log', twin.advance(timing.ticks(duration_s)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('share', 'seed', 'folds'), [(1e-3, 20261124, False), (2e-4, 20261126, True)]
)
def test_a_stiff_part_that_rings_is_found_by_its_line(share, seed, folds):
    # The second one rings at the limit: with this noise its line stands out in half of all seeds.
    print(f'seed {seed}')
    nominal = Variant.of(load_model('rigid'))
    effect, axis = find('belt_compliance'), 'y_rotate'
    (parameter,) = effect.parameters(nominal, axis)
    true = share * parameter.typical
    record = log_of(effect.apply(nominal, axis, {'compliance': true}), 1.2)
    noise = np.random.default_rng(seed).normal(0.0, 0.5, record.reading.shape)
    problem = Problem(nominal, [replace(record, reading=np.round(record.reading + noise))])
    base = evaluate(problem)
    rivals = candidates(problem, [find(name) for name in RIVALS])
    screened = Rings(problem, 8)(base, rivals)
    fitted = [
        fit_causes(problem, (item.cause,))
        for item in sorted(screened, key=lambda item: -item.likelihood)[:3]
    ]
    best = max(fitted, key=lambda item: item.log_likelihood)
    assert [cause.name for cause in best.causes] == ['belt_compliance:y_rotate']
    assert best.causes[0].values['compliance'] == pytest.approx(true, rel=1e-3)
    assert 2.0 * (best.log_likelihood - base.log_likelihood) > 50.0
    (mode,) = coupled_modes(apply_all(nominal, best.causes).build(Timing()))
    assert folds == (mode.frequency_hz > RATE_HZ / 2.0)


def test_a_ring_that_a_fit_has_brought_to_nothing_can_still_be_moved():
    nominal, effect = Variant.of(load_model('rigid')), find('gearbox_compliance')
    (item,) = effect.parameters(nominal, 'y_rotate')
    none = Cause(effect, 'y_rotate', {'compliance': 0.0}, narrow=('compliance',))
    some = none.with_values({'compliance': item.typical})
    assert width_of(none, item) == item.typical
    assert 0.0 < width_of(some, item) < 0.01 * item.typical


def test_a_maximum_that_falls_between_two_values_is_found_beside_a_lower_one(monkeypatch):
    """Gains of 600 and 550 (widths 4 % and 5 %): where it is tried the lower one seems higher."""
    nominal, effect = Variant.of(load_model('rigid')), find('bearing_radial_compliance')
    (item,) = effect.parameters(nominal, 'x_rotate')
    right, wrong = (
        item.typical * math.sqrt(TUNING[place] * TUNING[place + further])
        for place, further in ((20, 1), (25, 0))
    )

    def gain(problem, base, cause):
        value = math.log(cause.values[item.name])
        return sum(
            high * math.exp(-0.5 * ((value - math.log(about)) / width) ** 2)
            for high, about, width in ((600.0, right, 0.04), (550.0, wrong, 0.05))
        )

    def as_it_is(problem, causes):
        return SimpleNamespace(
            log_likelihood=sum(0.5 * gain(problem, None, one) for one in causes[-1:])
        )

    monkeypatch.setattr('waferbot_twin.diagnosis.proposals.compliance_scan.in_any_phase', gain)
    monkeypatch.setattr('waferbot_twin.diagnosis.proposals.compliance_scan.evaluate', as_it_is)
    tried = [
        gain(None, None, Cause(effect, 'x_rotate', {item.name: item.typical * factor}))
        for factor in TUNING
    ]
    assert np.argmax(tried) == 25
    problem = SimpleNamespace(nominal=nominal, of_log=lambda record: problem)
    monkeypatch.setattr(
        'waferbot_twin.diagnosis.proposals.compliance_scan._shown_most_in', lambda *_: None
    )
    start = Cause(effect, 'x_rotate', {item.name: 0.05 * item.typical})
    nothing = SimpleNamespace(causes=())
    found = tuned(problem, nothing, start)
    assert found.values[item.name] == pytest.approx(right, rel=0.005)
    # what suits in some phase only, but not as it is, is no better than the value at hand
    monkeypatch.setattr(
        'waferbot_twin.diagnosis.proposals.compliance_scan.evaluate',
        lambda problem, causes: SimpleNamespace(
            log_likelihood=-sum(one.values[item.name] for one in causes[-1:])
        ),
    )
    assert tuned(problem, nothing, start) is start
