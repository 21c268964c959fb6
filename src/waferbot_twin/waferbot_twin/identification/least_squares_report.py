# SPDX-License-Identifier: Apache-2.0
"""Least squares of a log as a table, as JSON, and as a page with what the coefficients leave over."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from waferbot_twin.estimation.residual_curves import BinnedMeans
from waferbot_twin.html_page import html_page, picture
from waferbot_twin.identification.coefficient_names import coefficient_name
from waferbot_twin.identification.least_squares import AxisFit, LeastSquares, LogError
from waferbot_twin.plain_values import finite, significant
from waferbot_twin.recording.writer import as_json
from waferbot_twin.titles import with_titles

SCHEMA = 1
MEASURED, FITTED, LEVEL = '#1f5fa8', '#b5401f', '#999999'

MOST_NAMED = 5
"""Lines of the spectrum that are told in words."""


def unit_of(name: str, fit: AxisFit) -> str:
    """Return the unit of a coefficient: kg, N s/m, N, ... or, of a current without model, with A."""
    force, length = fit.force_unit, fit.length_unit
    if name == 'inertia':
        return {'N': 'kg', 'Nm': 'kg m²'}.get(force, f'{force} s²/{length}')
    if name.startswith('viscous'):
        return f'{force} s/{length}'
    return force


def label_of(name: str, fit: AxisFit) -> str:
    """Return a coefficient's name as a reader knows it."""
    return coefficient_name(name, fit.length_unit, fit.terms.wave_numbers)


def as_dict(result: LeastSquares) -> dict[str, Any]:
    """Return the result as plain values, as `report.json` has them (schema 1)."""
    return {
        'schema': SCHEMA,
        'method': 'least-squares',
        'logs': {'fitted': list(result.logs), 'judging': list(result.validation)},
        'axes': {fit.axis: _axis(fit) for fit in result.fits},
        'notes': list(result.notes),
    }


def _axis(fit: AxisFit) -> dict[str, Any]:
    found = fit.estimate
    return {
        'drive': fit.drive,
        'coefficients': {
            name: {
                'name': label_of(name, fit),
                'value': float(found.value[place]),
                'low95': float(found.low95[place]),
                'high95': float(found.high95[place]),
                'standard_error': float(found.standard_error[place]),
                'unit': unit_of(name, fit),
                'determined': bool(found.determined[place]),
            }
            for place, name in enumerate(found.names)
        },
        'degrees_of_freedom': found.degrees,
        'rise_speed': fit.terms.rise_speed,
        'cut_off_hz': fit.cut_off_hz,
        'noise_share_of_acceleration': fit.noise_share,
        'errors': [_error(one, fit) for one in fit.fitted],
        'validation_errors': [_error(one, fit) for one in fit.validation],
        'residual_over_speed': _means(fit.over_speed),
        'residual_over_position': _means(fit.over_position),
        'force_over_speed': _means(fit.measured),
        'lines_over_position': _lines(fit),
        'notes': list(fit.notes),
    }


def _error(one: LogError, fit: AxisFit) -> dict[str, Any]:
    return {
        'log': one.log,
        'relative': one.relative,
        'rms': one.rms,
        'unit': fit.force_unit,
        'used_s': one.used_s,
        **(
            {'nominal_model': one.of_models[0], 'extended_model': one.of_models[1]}
            if one.of_models
            else {}
        ),
    }


def _means(means: BinnedMeans) -> dict[str, Any]:
    return {
        'at': means.centre.tolist(),
        'mean': means.mean.tolist(),
        'low95': means.low95.tolist(),
        'high95': means.high95.tolist(),
    }


def _lines(fit: AxisFit) -> list[dict[str, float]]:
    """Return the lines of the residual over position: amplitude, and period in mm or per turn."""
    if fit.spectrum is None:
        return []
    rows = []
    for place in fit.spectrum.lines:
        waves, amplitude = float(fit.spectrum.waves[place]), float(fit.spectrum.amplitude[place])
        key, value = (
            ('period_mm', 1e3 / waves)
            if fit.length_unit == 'm'
            else ('per_turn', 2.0 * math.pi * waves)
        )
        rows.append({key: value, 'amplitude': amplitude})
    return rows


def table_rows(result: LeastSquares) -> list[tuple[str, ...]]:
    """Return axis, coefficient, value, both ends of the interval, and unit of each, as text."""
    rows: list[tuple[str, ...]] = []
    for axis, entry in as_dict(result)['axes'].items():
        for item in entry['coefficients'].values():
            values = (significant(item[key]) for key in ('value', 'low95', 'high95'))
            value, low, high = values
            if not item['determined']:
                value = 'left open'
            rows.append((result.titles[axis], item['name'], value, low, high, item['unit']))
    return rows


def errors_in_words(result: LeastSquares) -> list[str]:
    """Return, of each log and axis, how well the coefficients tell its force."""
    return [
        f'{result.titles[fit.axis]}, {one.log}{"" if one in fit.fitted else " (validation)"}: '
        f'relative force error {100.0 * one.relative:.2f} %, '
        f'RMS {significant(one.rms, 3)} {fit.force_unit}'
        for fit in result.fits
        for one in (*fit.fitted, *fit.validation)
    ]


def remarks(result: LeastSquares) -> list[str]:
    """Return how the filter stood, what stands out over position, and the notes."""
    said = []
    for fit in result.fits:
        title = result.titles[fit.axis]
        said.append(f'{title}: behind a low-pass filter of {significant(fit.cut_off_hz, 3)} Hz')
        if fit.terms.rise_speed is not None:
            said.append(
                f'{title}: what differs at rest fades with exp(-|speed| / '
                f'{significant(fit.terms.rise_speed, 3)} {fit.length_unit}/s)'
            )
        lines = _lines(fit)[:MOST_NAMED]
        if lines:
            texts = (
                f'{significant(one["amplitude"], 2)} {fit.force_unit} '
                + (
                    f'every {one["period_mm"]:.4g} mm'
                    if 'period_mm' in one
                    else f'{one["per_turn"]:.4g} a turn'
                )
                for one in lines
            )
            said.append(f'{title}: left over with position: {", ".join(texts)}')
        said += [with_titles(f'{fit.axis}: {note}', result.titles) for note in fit.notes]
    return [*said, *(with_titles(note, result.titles) for note in result.notes)]


def write(result: LeastSquares, folder: Path) -> None:
    """Write `report.json` and `report.html` into an existing folder."""
    (folder / 'report.json').write_text(as_json(finite(as_dict(result))) + '\n', 'utf-8')
    (folder / 'report.html').write_text(page(result), 'utf-8')


def page(result: LeastSquares) -> str:
    """Return the report as one HTML page with its pictures inside."""
    rows = ''.join(
        '<tr>' + ''.join(f'<td>{html.escape(cell)}</td>' for cell in row) + '</tr>'
        for row in table_rows(result)
    )
    body = [
        '<h1>Inverse-dynamics least squares</h1>',
        f'<p>Fitted to {html.escape(", ".join(result.logs))}.</p>',
        '<table><tr><th>axis</th><th>coefficient</th><th>value</th><th>95 % from</th><th>to</th>'
        f'<th>unit</th></tr>{rows}</table>',
        *(f'<p>{html.escape(line)}.</p>' for line in errors_in_words(result)),
        *(f'<p>{html.escape(line)}.</p>' for line in remarks(result)),
    ]
    for fit in result.fits:
        title = html.escape(result.titles[fit.axis])
        body += [f'<h2>{title}: what is left over</h2>', picture(draw(fit))]
    body.append(
        '<p>Bars are 95 % intervals from the scatter of passes. A line in the spectrum stands at one '
        'period of the position whatever the speed: cogging, a screw, teeth, an eccentric encoder.</p>'
    )
    return html_page('Inverse-dynamics least squares', body)


def draw(fit: AxisFit) -> Figure:
    """Draw force over speed with the fit, residual over speed and position, and its spectrum."""
    figure, panels = plt.subplots(2, 2, figsize=(11.0, 7.5), layout='constrained')
    length, force = fit.length_unit, fit.force_unit
    panel = panels[0][0]
    _bars(panel, fit.measured, 'force without inertia')
    panel.plot(fit.measured.centre, _line(fit), color=FITTED, lw=1.2, label='fit')
    panel.set_xlabel(f'speed [{length}/s]')
    panel.set_ylabel(f'force [{force}]')
    panel.legend(loc='best', fontsize=8)
    for panel, means, label in (
        (panels[0][1], fit.over_speed, f'speed [{length}/s]'),
        (panels[1][0], fit.over_position, f'position [{length}]'),
    ):
        _bars(panel, means, '')
        panel.axhline(0.0, color=LEVEL, lw=0.8)
        panel.set_xlabel(label)
        panel.set_ylabel(f'residual force [{force}]')
    _draw_spectrum(panels[1][1], fit)
    for panel in panels.flat:
        panel.grid(alpha=0.3)
    return figure


def _bars(panel: Axes, means: BinnedMeans, label: str) -> None:
    reach = np.nan_to_num(means.high95 - means.mean)
    panel.errorbar(
        means.centre, means.mean, yerr=reach, fmt='o', ms=3, lw=1.0, color=MEASURED, label=label
    )


def _line(fit: AxisFit) -> np.ndarray:
    """Return the force without that of inertia and position which the fit has at the speeds drawn."""
    speed = fit.measured.centre
    found = dict(zip(fit.estimate.names, fit.estimate.value, strict=True))
    columns = {
        'viscous': speed,
        'viscous_forward': np.maximum(speed, 0.0),
        'viscous_backward': np.minimum(speed, 0.0),
        'coulomb': np.sign(speed),
        'offset': np.ones(len(speed)),
    }
    if fit.terms.rise_speed is not None:
        columns['rise'] = np.sign(speed) * np.exp(-np.abs(speed) / fit.terms.rise_speed)
    return np.asarray(sum(found[name] * columns[name] for name in found if name in columns))


def _draw_spectrum(panel: Axes, fit: AxisFit) -> None:
    panel.set_ylabel(f'amplitude [{fit.force_unit}]')
    slides = fit.length_unit == 'm'
    panel.set_xlabel('period [mm]' if slides else 'waves per turn')
    if fit.spectrum is None:
        panel.text(0.5, 0.5, 'too short a way', ha='center', transform=panel.transAxes)
        return
    at = 1e3 / fit.spectrum.waves if slides else 2.0 * math.pi * fit.spectrum.waves
    panel.plot(at, fit.spectrum.amplitude, color=MEASURED, lw=0.8)
    panel.plot(at, fit.spectrum.level, color=LEVEL, lw=0.8, label='level')
    for place in fit.spectrum.lines:
        panel.plot(at[place], fit.spectrum.amplitude[place], 'o', ms=4, color=FITTED)
        panel.annotate(
            f'{at[place]:.3g}', (at[place], fit.spectrum.amplitude[place]), fontsize=7,
            textcoords='offset points', xytext=(3, 3),
        )  # fmt: skip
    if slides:
        panel.set_xscale('log')
    panel.legend(loc='best', fontsize=8)
