# SPDX-License-Identifier: Apache-2.0
"""Two seconds with an hour between them cost what two seconds cost, and say the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_twin.comparison.blocks import replay_blocks
from waferbot_twin.comparison.pairs import in_closed_loop, traces_of
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.channels import Channel, run_of
from waferbot_twin.identification.least_squares import identify_by_least_squares
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.pauses import LONGEST_S, with_short_pauses
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import aligned_record, record_of_measured_log
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.thinning import thinned_with_gaps

AXIS = 'x_rotate'
RATE_HZ, COUNT = 1000.0, 2000
HOUR_S = 3600.0

SEED = 33


@pytest.fixture
def motor():
    return Variant.of(load_model_or_machine('direct_drive_motor'))


def log_of(random, pause_s):
    """Return two seconds of a driven inertia, with a pause in the middle."""
    time_s = np.arange(COUNT) / RATE_HZ
    wave = 2.0 * np.pi * random.uniform(2.0, 12.0, 6)
    phase = np.outer(time_s, wave) + random.uniform(0.0, 2.0 * np.pi, 6)
    angle, current = -np.sum(np.sin(phase) / wave**2, axis=1), np.sum(np.sin(phase), axis=1)
    time_s = time_s + np.where(time_s < 1.0, 0.0, pause_s)
    kinds = {
        'position': ('rad', angle),
        'current': ('A', current),
        'commanded_position': ('rad', angle),
    }
    return MeasuredLog(
        'paused',
        tuple(Signal(kind, AXIS, unit, time_s, value) for kind, (unit, value) in kinds.items()),
    )


def test_pauses_are_shortened_by_whole_steps_and_the_clock_leads_back(random) -> None:
    for _ in range(20):
        step_s = random.uniform(1e-4, 0.2)
        rows = np.sort(random.choice(10_000, 300, replace=False))
        begins = np.sort(random.choice(np.arange(20, 280), 4, replace=False))
        later = np.searchsorted(begins, np.arange(300), side='right')
        time_s = (rows + 1000 * later + 50_000 * later) * step_s
        signals = [
            Signal('position', AXIS, 'rad', time_s, random.standard_normal(300)),
            Signal('current', AXIS, 'A', time_s[5:-5] + 0.3 * step_s, np.ones(290)),
        ]
        short, clock = with_short_pauses(signals, step_s)
        assert len(clock.from_s) == 4
        assert str(clock).startswith('4 pauses')
        for one, was in zip(short, signals, strict=True):
            np.testing.assert_array_equal(one.value, was.value)
            np.testing.assert_allclose(clock.logged_s(one.time_s), was.time_s, atol=1e-9)
            moved = (was.time_s - one.time_s) / step_s
            np.testing.assert_allclose(moved, np.round(moved), atol=1e-6)
            # It is still a gap to each of them: nothing is known there.
            assert len(one.gaps()) == len(was.gaps())
        span_s = short[0].time_s[-1] - short[0].time_s[0]
        assert span_s < 10_000 * step_s + 5 * max(LONGEST_S, 3.0 * short[0].gap_s) + step_s
        again, _ = with_short_pauses(short, step_s)
        assert again == short


def test_a_record_costs_by_samples_and_its_residual_does_not_depend_on_the_pause(
    random, motor
) -> None:
    state = random.bit_generator.state
    left = {}
    for pause_s in (3.0, HOUR_S):
        random.bit_generator.state = state
        log = log_of(random, pause_s)
        record = aligned_record(log, motor)
        assert record.duration_s < 2.0 + 1.1 * LONGEST_S
        assert any('shortened' in note for note in record.notes)
        (left[pause_s],) = PlantBlock(record, motor).innovations(motor)
    np.testing.assert_allclose(left[3.0], left[HOUR_S], atol=1e-6 * np.abs(left[3.0]).max())
    # Nor on whether it was shortened at all.
    random.bit_generator.state = state
    whole = record_of_measured_log(log_of(random, 3.0), motor)
    assert whole.duration_s > 4.9
    (of_whole,) = PlantBlock(whole, motor).innovations(motor)
    np.testing.assert_allclose(left[3.0], of_whole, atol=1e-3 * np.abs(of_whole).max())


def test_replay_and_closed_loop_are_told_by_the_log_s_own_clock(random, tmp_path) -> None:
    variant = Variant.of(load_model_or_machine('rigid'))
    log = log_of(random, HOUR_S)
    write_archive(log, tmp_path / 'log')
    (position,) = replay_blocks(tmp_path / 'log', variant, 'plant').traces
    there, known = log[AXIS, 'position'].at(position.time_s)
    assert position.time_s[-1] > HOUR_S
    assert known.all()
    assert np.ptp(position.measured - there) < 0.01 * np.ptp(there)
    measured, simulated = in_closed_loop(tmp_path / 'log', variant, 'rigid')
    assert len(simulated[AXIS, 'position'].time_s) < 5 * 9000
    (told,) = [one for one in traces_of(simulated, measured) if one.kind == 'commanded_position']
    assert len(told.time_s) > 0.99 * COUNT
    # Commands of 1 kHz, held, at cycles of 2.25 kHz: one sample beside one another at most.
    one_sample = np.abs(np.diff(told.measured[: COUNT // 2])).max()
    assert np.abs(told.residual).max() < 1.2 * one_sample < 0.03 * np.ptp(told.measured)


def test_least_squares_and_frequency_response_do_not_depend_on_the_pause(random, motor) -> None:
    state = random.bit_generator.state
    found = {}
    for pause_s in (3.0, HOUR_S):
        random.bit_generator.state = state
        log = log_of(random, pause_s)
        run = run_of(log, (Channel(AXIS, 'current'), Channel(AXIS, 'position')), motor)
        assert len(run.input) in (998, 999)
        found[pause_s] = [run.input, run.output]
        (fit,) = identify_by_least_squares([log], [], motor).fits
        found[pause_s].append(np.array(fit.estimate.value))
    for short, long in zip(found[3.0], found[HOUR_S], strict=True):
        np.testing.assert_allclose(short, long, rtol=1e-6, atol=1e-9 * np.abs(short).max())


def test_lines_are_not_drawn_across_a_pause(random) -> None:
    position = log_of(random, HOUR_S)[AXIS, 'position']
    time_s, value = thinned_with_gaps(position.time_s, position.value, 500)
    (breaks,) = np.nonzero(np.isnan(value[:-1]))
    assert len(breaks) == 1
    assert time_s[breaks[0]] < 1.0
    assert time_s[breaks[0] + 1] > HOUR_S
    assert np.nanmax(value) == position.value.max()
    same = replace(position, time_s=np.arange(COUNT) / RATE_HZ)
    assert np.isnan(thinned_with_gaps(same.time_s, same.value, 500)[1]).sum() == 1
