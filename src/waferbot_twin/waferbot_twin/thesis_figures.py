# SPDX-License-Identifier: Apache-2.0
"""
The figures of chapters 4 and 6 of the thesis, drawn from our runs.

Each has the number of the thesis' figure. Points that statements about it were measured at are marked,
green where the statement is met, red where not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_twin.plot import scaled_unit
from waferbot_twin.response import AxisResponse
from waferbot_twin.statement_quantities import STEPS, Mark
from waferbot_twin.statements import Finding
from waferbot_twin.step_runs import Runs

COLOURS = {
    'as_built': '#222222',
    'rigid': '#c46a1b',
    'flexible': '#1f5fa8',
    'simplified': '#3a9150',
    'calculated': '#a02c5a',
    'mathematical': '#a02c5a',
}
NAMES = {
    'as_built': 'measured (as-built machine)',
    'rigid': 'rigid',
    'flexible': 'flexible',
    'simplified': 'simplified',
    'calculated': 'flexible, calculated damping',
    'mathematical': 'mathematical plant, rigid',
}
MET_COLOUR, MISSED_COLOUR = '#2c8a3e', '#d0281c'

RESPONSE = ('position', 'following error')
CURRENT = ('current',)
POSITION = ('position',)
ERRORS = ('errors',)


@dataclass(frozen=True)
class Figure:
    """
    A figure of the thesis: of which axis and models, and what its rows show.

    `start_s` is how much of the step its enlarged half shows.
    """

    number: str
    what: str
    axis: str
    models: tuple[str, ...]
    rows: tuple[str, ...]
    start_s: float

    @property
    def file(self) -> str:
        """Name of its picture."""
        axis = f'_{self.axis}' if self.number == '4.3' else ''  # one panel for each in the thesis
        return f'figure_{self.number.replace(".", "_")}{axis}.png'

    @property
    def caption(self) -> str:
        """Number, axis and content."""
        return f'Figure {self.number}. {USUAL_TITLES[self.axis]}: {self.what}'


START_S = {'y_linear': 0.12, 'x_rotate': 0.12, 'y_rotate': 0.3}
"""How much of the step the enlarged half of a figure shows."""

INITIAL_PEAK_S = 0.045
"""That much in Figs. 4.5 and 6.4."""


def figures() -> list[Figure]:
    """Return the figures in their order."""
    rigid, flexible = ('as_built', 'rigid'), ('as_built', 'rigid', 'flexible')
    calculated = ('as_built', 'calculated')
    both = ('rigid', 'flexible')
    all_three = ('rigid', 'flexible', 'simplified')
    y, x, r = 'y_linear', 'x_rotate', 'y_rotate'

    def figure(number: str, what: str, axis: str, models: tuple[str, ...], rows: tuple) -> Figure:
        return Figure(number, what, axis, models, rows, START_S[axis])

    of_initial_peak = 'initial peak'
    both_plants = ('rigid', 'mathematical')
    return [
        *(
            figure('4.3', 'mathematical and multibody plant', axis, both_plants, POSITION)
            for axis in (y, x, r)
        ),
        figure('4.4', 'rigid, simulated and measured', y, rigid, RESPONSE),
        Figure(
            '4.5',
            f'{of_initial_peak} of the measured response',
            y,
            rigid,
            POSITION,
            INITIAL_PEAK_S,
        ),
        figure('4.6', 'current, rigid', y, rigid, CURRENT),
        figure('4.7', 'rigid, simulated and measured', x, rigid, RESPONSE),
        figure('4.8', 'current, rigid', x, rigid, CURRENT),
        figure('4.9', 'rigid, simulated and measured', r, rigid, RESPONSE),
        figure('4.10', 'current, rigid', r, rigid, CURRENT),
        figure('6.1', 'calculated damping', y, calculated, RESPONSE),
        figure('6.2', 'current, calculated damping', y, calculated, CURRENT),
        figure('6.3', 'improved damping', y, flexible, RESPONSE),
        Figure(
            '6.4', f'{of_initial_peak}, improved damping', y, flexible, POSITION, INITIAL_PEAK_S
        ),
        figure('6.5', 'errors of rigid and flexible model', y, both, ERRORS),
        figure('6.6', 'current, improved damping', y, flexible, CURRENT),
        figure('6.7', 'calculated damping', x, calculated, RESPONSE),
        figure('6.8', 'current, calculated damping', x, calculated, CURRENT),
        figure('6.9', 'improved damping', x, flexible, RESPONSE),
        figure('6.10', 'current, improved damping', x, flexible, CURRENT),
        figure('6.11', 'errors of rigid and flexible model', x, both, ERRORS),
        figure('6.12', 'calculated damping', r, calculated, RESPONSE),
        figure('6.13', 'current, calculated damping', r, calculated, CURRENT),
        figure('6.14', 'improved damping', r, flexible, RESPONSE),
        figure('6.15', 'current, improved damping', r, flexible, CURRENT),
        figure('6.16', 'errors of rigid and flexible model', r, both, ERRORS),
        figure('6.17', 'errors of rigid, flexible and simplified model', y, all_three, ERRORS),
        figure('6.18', 'errors of rigid, flexible and simplified model', x, all_three, ERRORS),
        figure('6.19', 'errors of rigid, flexible and simplified model', r, all_three, ERRORS),
    ]


def draw(figure: Figure, runs: Runs, findings: Sequence[Finding], file: Path) -> None:
    """Draw one figure into an image file: the whole record, and beside it the start enlarged."""
    responses = {model: runs[model, figure.axis].response for model in figure.models}
    measured = runs['as_built', figure.axis].response
    rows = [
        _errors(responses, measured) if name == 'errors' else _signal(responses, name)
        for name in figure.rows
    ]
    canvas, panels = plt.subplots(
        len(rows), 2, figsize=(11.0, 1.4 + 2.4 * len(rows)), squeeze=False, sharex='col',
        layout='constrained',
    )  # fmt: skip
    for line, row in zip(panels, rows, strict=True):
        for panel in line:
            _draw_row(panel, row)
        line[0].set_ylabel(row.label)
    if figure.rows[0] == 'position':
        for panel in panels[0]:
            _mark(panel, responses, [finding for finding in findings if finding.measured.marks])
    panels[0][1].set_xlim(-0.05 * figure.start_s, figure.start_s)
    for panel in panels[-1]:
        panel.set_xlabel('time from the step [s]')
    handles, labels = panels[0][0].get_legend_handles_labels()
    canvas.legend(
        handles, labels, loc='outside upper center', ncols=len(labels), fontsize=9, frameon=False
    )
    canvas.savefig(file, dpi=100, metadata={'Software': 'waferbot'})
    plt.close(canvas)


def _mark(panel: Axes, responses: dict[str, AxisResponse], findings: Sequence[Finding]) -> None:
    """Mark the points that findings were measured at, those of statements that are not met on top."""
    factor, _ = scaled_unit(*_position_and_unit(responses))
    for finding in sorted(findings, key=lambda found: not found.met):
        colour = MET_COLOUR if finding.met else MISSED_COLOUR
        for mark in finding.measured.marks:
            if mark.model in responses and mark.time > 0.0:
                at, value = _place(mark, responses[mark.model])
                panel.plot(
                    at, value * factor, 'o', color=colour, ms=5, mfc='none', mew=1.5, zorder=3
                )


def _position_and_unit(responses: dict[str, AxisResponse]) -> tuple[np.ndarray, str]:
    first = next(iter(responses.values()))
    return first.position, first.unit


def _place(mark: Mark, response: AxisResponse) -> tuple[float, float]:
    """Return where a mark is in the record: time from the step up (s), position."""
    jumps = np.flatnonzero(np.diff(response.commanded))
    jump = int(jumps[STEPS.index(mark.step)])
    below, above = response.commanded[jump : jump + 2]
    after = response.servo_time[jump + 1] - _start(response)
    return float(after + mark.time), float(below + mark.value * (above - below))


@dataclass(frozen=True)
class _Row:
    """One row of a figure: curves (time, values, model or `commanded`) in the unit of the label."""

    label: str
    curves: list[tuple[np.ndarray, np.ndarray, str]]
    limits: tuple[float, float] | None


_SIGNALS: dict[str, Callable[[AxisResponse], tuple[np.ndarray, np.ndarray]]] = {
    'position': lambda response: (response.encoder_time, response.position),
    'following error': lambda response: (response.servo_time, response.following_error),
    'current': lambda response: (response.tick_time, response.current),
}


def _signal(responses: dict[str, AxisResponse], name: str) -> _Row:
    pick = _SIGNALS[name]
    first = next(iter(responses.values()))
    factor, unit = scaled_unit(pick(first)[1], 'A' if name == 'current' else first.unit)
    curves = []
    if name == 'position':
        curves.append((first.servo_time - _start(first), first.commanded * factor, 'commanded'))
    for model, response in responses.items():
        time, values = pick(response)
        curves.append((time - _start(response), values * factor, model))
    measured = [values for _, values, model in curves if model != 'commanded']
    limits = _current_limits(measured) if name == 'current' else _limits(measured)
    return _Row(f'{name} [{unit}]', curves, limits)


def _errors(responses: dict[str, AxisResponse], measured: AxisResponse) -> _Row:
    measured_time, measured_position = measured.since_start()
    factor, unit = scaled_unit(measured_position, measured.unit)
    curves = []
    for model, response in responses.items():
        time, position = response.since_start()
        error = position - np.interp(time, measured_time, measured_position)
        curves.append((time, error * factor, model))
    return _Row(f'simulated minus measured [{unit}]', curves, None)


def _start(response: AxisResponse) -> float:
    """Return the time of the step, s."""
    step = response.step()
    return step[0] if step is not None else 0.0


def _draw_row(panel: Axes, row: _Row) -> None:
    for time, values, model in row.curves:
        if model == 'commanded':
            panel.step(time, values, where='post', color='#999999', lw=0.8, label='commanded')
        else:
            panel.plot(
                time, values, color=COLOURS[model], lw=1.0, label=NAMES[model],
                ls='--' if model in ('simplified', 'mathematical') else '-',
                zorder=2.5 if model == 'as_built' else 2.0,  # a vibration must not hide it
            )  # fmt: skip
    if row.limits is not None:
        panel.set_ylim(*row.limits)
        drawn = np.concatenate([values for _, values, _ in row.curves])
        panel.text(
            0.98, 0.05, f'cut off: {drawn.min():.3g} to {drawn.max():.3g}',
            transform=panel.transAxes, ha='right', fontsize=8, color='#555555',
        )  # fmt: skip
    panel.grid(alpha=0.3)


def _limits(values: list[np.ndarray]) -> tuple[float, float] | None:
    """
    Return limits of four times the first curve if another one goes beyond them.

    So a response that blows up does not press the others flat.
    """
    low, high = float(values[0].min()), float(values[0].max())
    reach = 2.0 * max(high - low, 1e-12)
    middle = 0.5 * (high + low)
    beyond = any(np.max(np.abs(other - middle)) > reach for other in values[1:])
    return (middle - reach, middle + reach) if beyond else None


def _current_limits(values: list[np.ndarray]) -> tuple[float, float] | None:
    """
    Return limits that hold all but 0.5 % of the samples if what they leave out is far away.

    That is the current which velocity feedforward asks for in the servo cycle of the step.
    """
    everything = np.concatenate(values)
    low, high = np.percentile(everything, [0.25, 99.75])
    spread = max(float(high - low), 1e-12)
    if np.ptp(everything) < 2.0 * spread:
        return None
    return float(low) - 0.3 * spread, float(high) + 0.3 * spread
