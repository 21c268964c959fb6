# SPDX-License-Identifier: Apache-2.0
"""
What the thesis says of its curves: every statement can be measured, and measures what it says.

Quantities are held against responses with a closed form; what our runs do is told, not demanded: a
statement that is not met stays so until the machine is another.
"""

from __future__ import annotations

import inspect
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from waferbot_twin import statement_quantities as quantities
from waferbot_twin.response import AxisResponse
from waferbot_twin.statements import Finding, Statement, findings, statements
from waferbot_twin.step_runs import CASES, Run, Runs

PAGE = Path(__file__).parents[3] / 'docs' / 'thesis.md'


def test_statements_are_whole() -> None:
    said = statements()
    assert len(said) >= 40
    assert len({one.name for one in said}) == len(said)
    for one in said:
        assert one.chapter in (3, 4, 6)
        assert one.figure.startswith(f'{one.chapter}.') or 'Conclusions' in one.section
        assert one.limits
        assert set(one.limits) <= {'least', 'most'}
        assert one.least <= one.most
        assert one.section
        assert one.because
        assert len(one.says) < 140  # in our words, shortly
        inspect.signature(quantities.QUANTITIES[one.quantity]).bind(None, **one.about)
        named = [one.about.get(key) for key in ('model', 'reference')]
        for model in named:
            assert model is None or any(model == case for case, _ in CASES)


def test_every_quantity_is_used_and_explained() -> None:
    assert set(quantities.QUANTITIES) == {one.quantity for one in statements()}
    assert all(len(quantities.meaning(name)) > 10 for name in quantities.QUANTITIES)


def test_limits() -> None:
    said = Statement('', 4, '4.4', '', '', '', {}, {'least': -1.0, 'most': 2.0}, '')
    assert [said.admits(value) for value in (-1.1, -1.0, 2.0, 2.1, math.nan)] == [
        False, True, True, False, False,
    ]  # fmt: skip
    assert said.demanded == '-1 to 2'


def response(up: np.ndarray, down: np.ndarray, current: np.ndarray | None = None) -> AxisResponse:
    """
    Return the response of an axis to a step of 2 at 0.02 s and back at 0.62 s, by what it does.

    `up` and `down` (5400,) at 9 kHz behind each step, in steps; `current` (10800,) in A, behind both.
    """
    encoder = np.arange(180 + 10800) / 9000.0
    servo = np.arange(45 + 2700) / 2250.0
    position = np.concatenate([np.zeros(180), 2.0 * up, 2.0 - 2.0 * down])
    commanded = np.zeros(len(servo))
    commanded[45 : 45 + 1350] = 2.0
    flow = np.zeros(len(encoder))
    if current is not None:
        flow[180:] = current
    return AxisResponse(
        'y_linear', 'm', encoder, position, servo, commanded, commanded * 0.0, servo,
        commanded * 0.0, encoder, flow,
    )  # fmt: skip


class Given:
    """Stands for runs: responses of the axis `y_linear` by model."""

    def __init__(self, **responses: AxisResponse) -> None:
        """Take the responses."""
        self._responses = responses

    def __getitem__(self, key: tuple[str, str]) -> Run:
        """Return the run of (model, axis)."""
        own = self._responses[key[0]]
        return Run('y_linear', (own, own, own), 1.0, False)


TIME = np.arange(5400) / 9000.0


def second_order(overshoot: float, frequency_hz: float = 24.0) -> np.ndarray:
    """Return the unit step response of an oscillator with this overshoot: exp(-pi r / w)."""
    omega = 2.0 * np.pi * frequency_hz
    rate = -np.log(overshoot) * omega / np.pi
    return 1.0 - np.exp(-rate * TIME) * (
        np.cos(omega * TIME) + rate / omega * np.sin(omega * TIME)
    )


def value(name: str, runs: Given, **about: object) -> float:
    return quantities.measure(name, runs, {'axis': 'y_linear', **about}).value  # type: ignore[arg-type]


def test_peaks_and_offsets_of_oscillators() -> None:
    runs = Given(
        rigid=response(second_order(0.4), second_order(0.2)),
        as_built=response(0.97 * second_order(0.3), second_order(0.4)),
    )
    ratio = value('peak_ratio', runs, model='as_built', reference='rigid', step='up')
    assert ratio == pytest.approx(0.97 * 1.3 / 1.4, rel=1e-4)
    assert value('overshoot_down_to_up', runs, model='rigid') == pytest.approx(0.5, rel=1e-3)
    assert value('end_offset', runs, model='as_built', step='up') == pytest.approx(0.03, abs=1e-6)
    assert value('end_offset', runs, model='as_built', step='down') == pytest.approx(0.0, abs=1e-6)
    # turns behind the peak: 0.4^n + 0.4^(n+1) of the step each, above 2 % for n = 2, 3, 4
    swings = quantities.swings_after_peak(runs, 'y_linear', 'rigid', 'up')  # type: ignore[arg-type]
    assert swings.value == 3.0


def test_initial_peak_is_seen_below_and_above_the_command() -> None:
    """A bump at 10 ms before the highest peak at 35 ms; vibration of 500 Hz makes no peak."""
    slow = second_order(0.45, 1.0 / 0.07)

    def with_bump(height: float) -> np.ndarray:
        bump = np.exp(-(((TIME - 0.010) / 0.003) ** 2))
        return slow + (height - slow[90]) * bump + 0.02 * np.sin(2 * np.pi * 500.0 * TIME)

    below, above = with_bump(0.95), with_bump(1.08)
    runs = Given(
        as_built=response(below, below),
        flexible=response(above, above),
        rigid=response(slow, slow),
    )
    found = {
        model: value('initial_peak', runs, model=model, step='up')
        for model in ('rigid', 'as_built', 'flexible')
    }
    assert found['rigid'] == 0.0
    assert found['as_built'] == pytest.approx(0.95, abs=0.03)
    assert found['flexible'] == pytest.approx(1.08, abs=0.03)
    assert value('crossings_to_peak', runs, model='as_built', step='up') == 1.0
    assert value('crossings_to_peak', runs, model='flexible', step='up') == 3.0


def test_lines_and_leads() -> None:
    clean = second_order(0.4)
    vibrating = clean + 0.02 * np.exp(-TIME / 0.2) * np.sin(2.0 * np.pi * 75.0 * TIME)
    late = np.concatenate([np.zeros(30), clean[:-30]])
    runs = Given(
        rigid=response(clean, clean),
        as_built=response(vibrating, vibrating),
        flexible=response(late, late),
    )
    about = {'step': 'down', 'signal': 'position'}
    assert value('strongest_line', runs, model='as_built', **about) == pytest.approx(75.0, abs=1.0)
    band = {'band_hz': [72.5, 77.5], 'reference': 'as_built', 'model': 'rigid', **about}
    assert value('line_ratio', runs, **band) < 0.1
    lead = value('lead', runs, model='rigid', reference='flexible', **about)
    assert lead == pytest.approx(30 / 9000.0, abs=1e-9)


def test_growth_and_currents() -> None:
    """Oscillation that doubles every 0.2 s; a current that is high for 5 ms."""
    growing = 1.0 + 0.05 * 2.0 ** (TIME / 0.2) * np.sin(2.0 * np.pi * 50.0 * TIME)
    spike = np.where(TIME < 0.005, 10.0, 0.5)
    small = np.where(TIME < 0.005, 4.0, 0.5)
    runs = Given(
        calculated=response(growing, growing, np.concatenate([spike, -spike])),
        as_built=response(growing, growing, np.concatenate([small, -small])),
    )
    about = {'model': 'calculated', 'step': 'up'}
    assert value('growth', runs, signal='position', **about) == pytest.approx(2.0, rel=0.02)
    assert value('time_of_high_current', runs, share=0.1, **about) == pytest.approx(
        0.005, abs=2e-4
    )
    ratio = value('peak_current_ratio', runs, reference='as_built', **about)
    assert ratio == pytest.approx(2.5)


@pytest.fixture(scope='module')
def found() -> list[Finding]:
    return findings(Runs())


@pytest.mark.slow
def test_every_statement_is_measured_on_our_runs(found: list[Finding]) -> None:
    assert len(found) == len(statements())
    for finding in found:
        assert isinstance(finding.measured.value, float)
    json.dumps([finding.as_dict() for finding in found])


@pytest.mark.slow
def test_docs_say_how_many_are_met(found: list[Finding]) -> None:
    met = sum(finding.met for finding in found)
    print([finding.statement.name for finding in found if not finding.met])
    counts = re.search(r'(\d+) of (\d+) statements are met', PAGE.read_text('utf-8'))
    assert counts is not None
    assert (int(counts[1]), int(counts[2])) == (met, len(found))
