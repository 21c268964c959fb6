# SPDX-License-Identifier: Apache-2.0
"""
The tables of chapters 4 and 6 of the thesis, from runs made on the spot, beside what was printed.

Every number of ours comes from a step run in process: each axis alone, as in the thesis, on the
models `rigid`, `flexible`, `simplified` and `as_built`, which stands for the measured machine, and
on `flexible` with the calculated damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from waferbot_lockstep.contract import AXES, USUAL_TITLES
from waferbot_plant.modes import first_frequencies
from waferbot_plant.plant import load_machine
from waferbot_twin.metrics import FIGURES, percent_difference, performance_improvement
from waferbot_twin.oscillation import (
    BLOWN_UP,
    HIGHER_BAND_HZ,
    VIBRATION_BAND_HZ,
    late_oscillation,
    vibration_amplitude,
)
from waferbot_twin.step_runs import THESIS_COLUMN, Runs, run_step
from waferbot_twin.thesis import (
    RMS_TOLERANCE,
    improvement_admits,
    known_deviations,
    printed,
    run_time_admits,
    thesis,
    tolerance,
)

KNIFE_EDGE = 0.01
"""Shift of the level, in steps, by which the sensitivity of a figure is shown."""


@dataclass(frozen=True)
class Row:
    """
    A row of a table: `cells` by column; `met` None where nothing is demanded.

    `note` says why a value is not met, or how it moves when its level is shifted.
    """

    name: str
    cells: dict[str, float | str | None]
    met: bool | None = None
    note: str = ''


@dataclass(frozen=True)
class Table:
    """A table of the thesis, or one that its text implies."""

    number: str
    title: str
    rows: list[Row] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            'table': self.number,
            'title': self.title,
            'rows': [
                {'name': row.name, **row.cells, 'met': row.met, 'note': row.note}
                for row in self.rows
            ],
        }


def all_tables(runs: Runs) -> list[Table]:
    """Return every table of chapters 4 and 6 in their order, and those that the text implies."""
    tables = [difference_table(runs, 'rigid', axis) for axis in AXES]
    for axis in AXES:
        tables += [difference_table(runs, 'flexible', axis), improvement_table(runs, axis)]
    return [
        *tables,
        frequency_table(),
        run_time_table(runs),
        simplified_table(runs),
        stability_table(runs),
        vibration_table(runs),
    ]


def difference_table(runs: Runs, model: str, axis: str) -> Table:
    """Return Table 4.1, 4.2, 4.3, 6.1, 6.3 or 6.5: simulated against measured."""
    steps = thesis()['steps'][axis]
    table = Table(
        steps['table'][model],
        f'{USUAL_TITLES[axis]} step: {model} connections, simulated and measured',
    )
    for figure, name in FIGURES.items():
        simulated, simulated_met, simulated_note = compared(runs, model, axis, figure)
        measured, measured_met, measured_note = compared(runs, 'as_built', axis, figure)
        entry = steps[model][figure]
        ours = percent_difference(
            getattr(runs.metrics(model, axis), figure),
            getattr(runs.metrics('as_built', axis), figure),
        )
        table.rows.append(
            Row(
                f'{name} ({_unit(figure, steps["unit"])})',
                {
                    **{f'simulated {key}': value for key, value in simulated.items()},
                    **{f'measured {key}': value for key, value in measured.items()},
                    'percent thesis': entry.get('corrected_percent', entry['percent']),
                    'percent ours': ours,
                },
                simulated_met and measured_met,
                '; '.join(
                    f'{which}: {note}'
                    for which, note in (('simulated', simulated_note), ('measured', measured_note))
                    if note
                ),
            )
        )
    table.rows.append(_rms_row(runs, model, axis))
    return table


def _rms_row(runs: Runs, model: str, axis: str) -> Row:
    """Return the RMS error (4.2) of a model, which the thesis prints in its text."""
    steps = thesis()['steps'][axis]
    error = runs.rms_error(model, axis)
    expected = steps[model]['rms_error']['printed']
    met = RMS_TOLERANCE.admits(expected, error)
    return Row(
        f'RMS error ({steps["unit"]})',
        {
            'simulated thesis': expected,
            'simulated ours': error,
            'simulated difference %': _signed_percent(error, expected),
        },
        met,
        _reason(met, f'{axis}.{model}.rms_error'),
    )


def compared(
    runs: Runs, model: str, axis: str, figure: str
) -> tuple[dict[str, float | str | None], bool, str]:
    """
    Return one figure of one model beside the thesis, whether it is met, and a note.

    The note names the reason if it is not met, and the range that the figure takes when its level
    is shifted by `KNIFE_EDGE` of the step if that range is wider than the tolerance.
    """
    column = THESIS_COLUMN[model]
    expected = printed(axis, column, figure)
    ours = getattr(runs.metrics(model, axis), figure)
    allowed = tolerance(column, figure)
    met = allowed.admits(expected, ours)
    notes = []
    if not met:
        notes.append(_reason(met, f'{axis}.{column}.{figure}'))
    low, high = sensitivity(runs, model, axis, figure)
    if not (allowed.admits(ours, low) and allowed.admits(ours, high)):
        notes.append(
            f'knife edge: {low:.4g} to {_end(high)} for levels {100 * KNIFE_EDGE:g} % of the step '
            'lower or higher'
        )
    cells: dict[str, float | str | None] = {
        'thesis': expected,
        'ours': ours,
        'difference %': _signed_percent(ours, expected),
    }
    return cells, met, '; '.join(notes)


def sensitivity(runs: Runs, model: str, axis: str, figure: str) -> tuple[float, float]:
    """
    Return the range of a figure when its level (50 %, 100 %, 5 % band) moves up and down.

    It ends at infinity where the figure is not reached within the hold for one of the levels.
    """
    values = [
        getattr(runs.metrics(model, axis, shift), figure)
        for shift in (-KNIFE_EDGE, 0.0, KNIFE_EDGE)
    ]
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return float('nan'), float('nan')
    return min(finite), max(finite) if len(finite) == len(values) else math.inf


def improvement_table(runs: Runs, axis: str) -> Table:
    """Return Table 6.2, 6.4 or 6.6: what the flexible connections gain, (6.1)."""
    steps = thesis()['steps'][axis]
    table = Table(
        steps['table']['improvement'],
        f'{USUAL_TITLES[axis]} step: performance improvement from flexible connections',
    )
    figures = {model: runs.metrics(model, axis) for model in ('rigid', 'flexible', 'as_built')}
    for figure, name in FIGURES.items():
        measured = getattr(figures['as_built'], figure)
        rigid, flexible = (
            percent_difference(getattr(figures[model], figure), measured)
            for model in ('rigid', 'flexible')
        )
        expected = steps['improvement'][figure]
        ours = performance_improvement(rigid, flexible)
        met = improvement_admits(expected, ours)
        table.rows.append(
            Row(
                name,
                {
                    'rigid % thesis': _percent_printed(steps['rigid'][figure]),
                    'rigid % ours': rigid,
                    'flexible % thesis': _percent_printed(steps['flexible'][figure]),
                    'flexible % ours': flexible,
                    'improvement thesis': expected,
                    'improvement ours': ours,
                },
                met,
                _reason(met, f'{axis}.improvement.{figure}'),
            )
        )
    rigid, flexible = (runs.rms_error(model, axis) for model in ('rigid', 'flexible'))
    gain = performance_improvement(rigid, flexible)
    expected = steps['improvement']['rms_error']
    met = gain * expected > 0.0 and abs(gain - expected) <= 10.0
    table.rows.append(
        Row(
            'RMS error, % of step',
            {
                'rigid % thesis': 100.0 * steps['rigid']['rms_error']['printed'] / steps['step'],
                'rigid % ours': 100.0 * rigid / steps['step'],
                'flexible % thesis': (
                    100.0 * steps['flexible']['rms_error']['printed'] / steps['step']
                ),
                'flexible % ours': 100.0 * flexible / steps['step'],
                'improvement thesis': expected,
                'improvement ours': gain,
            },
            met,
            _reason(met, f'{axis}.improvement.rms_error'),
        )
    )
    return table


def frequency_table() -> Table:
    """Return Table 6.7: the first frequency of every flexible element."""
    table = Table('6.7', 'First non-rigid frequency of each flexible element')
    ours = first_frequencies(load_machine('flexible').description)
    for name, expected in thesis()['first_frequencies_hz'].items():
        difference = _signed_percent(ours[name], expected)
        table.rows.append(
            Row(
                f'{name} (Hz)',
                {'thesis': expected, 'ours': ours[name], 'difference %': difference},
                abs(difference) <= 1.0,
            )
        )
    return table


def run_time_table(runs: Runs) -> Table:
    """
    Return Table 6.8: run time of the models relative to the rigid one.

    The thesis' solver takes smaller steps where the model is stiff; ours takes the same steps for
    all models, so its ratios only count the work per step. What is demanded is what chapter 6 says of
    them: see `thesis.run_time_admits`.
    """
    table = Table('6.8', 'Normalised simulation time')
    for axis in AXES:
        loop_s = {
            model: min(run_step(model, axis).loop_s for _ in range(3))
            for model in ('rigid', 'flexible', 'simplified')
        }
        ratio = {model: seconds / loop_s['rigid'] for model, seconds in loop_s.items()}
        for model, expected in thesis()['steps'][axis]['run_time'].items():
            table.rows.append(
                Row(
                    f'{USUAL_TITLES[axis]}, {model}',
                    {'thesis': expected, 'ours': ratio[model]},
                    run_time_admits(model, ratio[model], ratio['flexible']),
                )
            )
    return table


def simplified_table(runs: Runs) -> Table:
    """Return what chapter 6 says of the simplified model: its RMS error against the flexible's."""
    table = Table('6, text', 'Difference in RMS error between flexible and simplified model')
    for axis in AXES:
        expected = thesis()['steps'][axis]['simplified_rms_difference_percent']
        ours = percent_difference(
            runs.rms_error('simplified', axis), runs.rms_error('flexible', axis)
        )
        met = ours <= expected
        table.rows.append(
            Row(
                f'{USUAL_TITLES[axis]} (%)',
                {
                    'thesis': expected,
                    'ours': ours,
                    'response to response, % of step': 100.0
                    * runs.rms_error('simplified', axis, 'flexible')
                    / thesis()['steps'][axis]['step'],
                },
                met,
                _reason(met, f'{axis}.simplified.rms_error'),
            )
        )
    return table


def stability_table(runs: Runs) -> Table:
    """Return the stability story of chapter 6: what the loops do with either damping."""
    table = Table('6, text', 'Closed loop with calculated and with improved damping')
    for axis in AXES:
        for model, damping, expected in (
            ('calculated', 'calculated damping', 'unstable'),
            ('flexible', 'improved damping', 'stable'),
        ):
            run = runs[model, axis]
            found = BLOWN_UP if run.blew_up else late_oscillation(run.response)
            ours = 'unstable' if found.unstable else 'stable'
            met = ours == expected
            table.rows.append(
                Row(
                    f'{USUAL_TITLES[axis]}, {damping}',
                    {
                        'thesis': expected,
                        'ours': ours,
                        'late amplitude, steps': found.amplitude,
                        '0.2 s before': found.before,
                        'at Hz': found.frequency_hz if found.unstable else None,
                        'farthest, steps': found.farthest,
                    },
                    met,
                    _reason(met, f'{axis}.{model}.stability'),
                )
            )
    return table


def vibration_table(runs: Runs) -> Table:
    """Return the Y-Linear vibration near 75 Hz: in the measured and flexible response only."""
    table = Table('4, 6, text', 'Y-Linear vibration at 65 to 90 Hz after the step')
    amplitudes, higher = (
        {
            model: vibration_amplitude(runs[model, 'y_linear'].response, band_hz)
            for model in ('rigid', 'flexible', 'as_built')
        }
        for band_hz in (VIBRATION_BAND_HZ, HIGHER_BAND_HZ)
    )
    for model, expected in (('rigid', 'absent'), ('flexible', 'present'), ('as_built', 'present')):
        ratio = amplitudes[model] / amplitudes['rigid']
        ours = 'present' if ratio > 3.0 else 'absent'
        met = ours == expected
        table.rows.append(
            Row(
                f'{model} (m)',
                {
                    'thesis': expected,
                    'ours': ours,
                    'amplitude': amplitudes[model],
                    'times rigid': ratio,
                    'amplitude at 300 to 600 Hz': higher[model],
                },
                met,
                _reason(met, f'y_linear.{model}.vibration'),
            )
        )
    return table


def _reason(met: bool, key: str) -> str:
    """Return why a row of `known_deviations` is not met; nothing if it is."""
    if met:
        return ''
    known = known_deviations().get(key)
    return f'not met: {known["reason"]}' if known else 'not met'


def _end(value: float) -> str:
    return f'{value:.4g}' if math.isfinite(value) else 'never within the hold'


def _percent_printed(entry: dict[str, float]) -> float:
    return entry.get('corrected_percent', entry['percent'])


def _signed_percent(ours: float, expected: float) -> float:
    """Return how far ours is above the thesis, in percent."""
    return 100.0 * (ours - expected) / abs(expected)


@cache
def _unit(figure: str, unit: str) -> str:
    return 's' if figure.endswith('time') else '%' if figure.endswith('percent') else unit
