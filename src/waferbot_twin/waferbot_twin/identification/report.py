# SPDX-License-Identifier: Apache-2.0
"""The result of an identification: a table, JSON, a model that every node loads, and a page."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.html_page import html_page, picture
from waferbot_twin.identification.conditioning import Combination, in_words
from waferbot_twin.identification.identify import Identification
from waferbot_twin.plain_values import finite, significant
from waferbot_twin.recording.writer import as_json
from waferbot_twin.validation.gain import gain_of_axes
from waferbot_twin.validation.gain_report import (
    AFTER,
    BEFORE,
    draw_gains,
    gain_table,
)

SCHEMA = 1
MOST_CHANNELS = 8
"""Channels whose autocorrelation is drawn."""


def as_dict(result: Identification) -> dict[str, Any]:
    """Return the identification as plain values, as `report.json` has them (schema 1)."""
    names = [parameter.path for parameter in result.estimate.parameters]
    found = result.estimate.conditioning
    return {
        'schema': SCHEMA,
        'order': names,
        'parameters': dict(zip(names, _parameters(result), strict=True)),
        'no_influence': [names[place] for place in found.no_influence],
        'cannot_tell_apart': [_combination(result, item) for item in found.combinations],
        'singular_values': found.singular_values.tolist(),
        'condition_number': found.condition_number,
        'correlation': found.correlation.tolist(),
        'residuals': [
            {
                'block': item.block,
                'log': item.log,
                'channel': item.name,
                'unit': item.unit,
                'rms_before': item.rms_before,
                'rms_after': item.rms_after,
                'white_probability': None
                if item.whiteness is None
                else item.whiteness.probability,
                'input_probability': (
                    None if item.whiteness is None else item.whiteness.input_probability
                ),
            }
            for item in result.channels
        ],
        'gain': {
            'validation': list(result.judging),
            'independent': result.independent,
            'axes': gain_of_axes(result.gains),
        },
        'logs': {'fitted': list(result.fitted), 'judging': list(result.judging)},
        'settled': result.estimate.settled,
        'notes': result.notes,
        'runtime_s': result.runtime_s,
    }


def _parameters(result: Identification) -> list[dict[str, Any]]:
    """Return value, interval and doubt of every parameter; no interval for one that is left open."""
    found = result.estimate.conditioning
    rows = []
    for place, parameter in enumerate(result.estimate.parameters):
        scaled = float(result.estimate.scaled[place])
        reach = NORMAL_95 * float(found.standard_errors[place])
        ends = sorted(parameter.value(scaled + side) for side in (reach, -reach))
        left_open = found.open[place]
        rows.append(
            {
                'value': parameter.value(scaled),
                'unit': parameter.unit,
                'start': parameter.start,
                'low95': None if left_open else ends[0],
                'high95': None if left_open else ends[1],
                'identified': not left_open,
                'range': [parameter.low, parameter.high],
            }
        )
    return rows


def _combination(result: Identification, item: Combination) -> dict[str, Any]:
    parameters = result.estimate.parameters
    return {
        'parameters': [parameters[place].path for place in item.members],
        'move': list(item.move),
        'words': words(result, item),
    }


def words(result: Identification, item: Combination) -> str:
    """Return what is known of parameters that cannot be told apart."""
    parameters = result.estimate.parameters
    return in_words(
        item,
        [parameter.path for parameter in parameters],
        [parameter.logarithmic for parameter in parameters],
    )


def remarks(result: Identification) -> list[str]:
    """Return sentences about what could not be identified, and the notes."""
    found = result.estimate.conditioning
    parameters = result.estimate.parameters
    silent = [parameters[place].path for place in found.no_influence]
    said = [f'no influence on these logs: {", ".join(silent)}'] if silent else []
    said += [words(result, item) for item in found.combinations]
    return said + result.notes


def table_rows(result: Identification) -> list[tuple[str, ...]]:
    """Return path, unit, start, value, and both ends of the interval of every parameter as text."""
    rows: list[tuple[str, ...]] = []
    for name, row in as_dict(result)['parameters'].items():
        whole = (significant(row[key], 6) for key in ('start', 'value', 'low95', 'high95'))
        start, value, low, high = whole
        rows.append(
            (name, row['unit'], start, value, low, high)
            if row['identified']
            else (name, row['unit'], start, 'not identified', '-', '-')
        )
    return rows


def write(result: Identification, folder: Path) -> None:
    """Write `report.json`, `report.html` and `identified.yaml` into an existing folder."""
    (folder / 'report.json').write_text(as_json(finite(as_dict(result))) + '\n', 'utf-8')
    names = ', '.join(parameter.path for parameter in result.estimate.parameters)
    header = f'# The model {result.nominal.name} with identified parameters: {names}.\n'
    (folder / 'identified.yaml').write_text(header + result.identified.text, 'utf-8')
    (folder / 'report.html').write_text(page(result), 'utf-8')


def page(result: Identification) -> str:
    """Return the report as one HTML page with its pictures inside."""
    found = result.estimate.conditioning
    body = [
        '<h1>Identification</h1>',
        ''.join(f'<p class="verdict">{html.escape(line)}.</p>' for line in remarks(result)),
        _parameter_table(result),
        picture(_draw_parameters(result)),
        '<h2>How well the logs determine them</h2>',
        f'<p>Condition number {significant(found.condition_number, 3)} '
        f'{"(singular) " if math.isinf(found.condition_number) else ""}of the white, scaled '
        'sensitivities; a combination with a singular value s has a standard error of 1 / s.</p>',
        picture(_draw_conditioning(result)),
        '<h2>Residuals</h2>',
        _channel_table(result),
        picture(_draw_whiteness(result)),
        '<h2>Gain</h2>',
        '<p>Measured in logs that were not used for the fit.</p>'
        if result.independent
        else '<p>Measured in the logs of the fit: it says little.</p>',
        gain_table(result.gains, result.nominal.titles),
        picture(draw_gains(result.gains, result.nominal.titles)) if result.gains else '',
        f'<p>Fitted to {html.escape(", ".join(result.fitted))} in {result.runtime_s:.0f} s.</p>',
    ]
    return html_page('Identification', body)


def _parameter_table(result: Identification) -> str:
    rows = ''.join(
        '<tr>' + ''.join(f'<td>{html.escape(cell)}</td>' for cell in row) + '</tr>'
        for row in table_rows(result)
    )
    return (
        '<table><tr><th>parameter</th><th>unit</th><th>model</th><th>identified</th>'
        f'<th>95 % from</th><th>to</th></tr>{rows}</table>'
    )


def _channel_table(result: Identification) -> str:
    rows = ''
    for item in result.channels:
        white = item.whiteness
        chances = (
            ('-', '-')
            if white is None
            else tuple(significant(x, 2) for x in (white.probability, white.input_probability))
        )
        rows += (
            f'<tr><td>{html.escape(f"{item.block}, {item.log}, {item.name}")}</td>'
            f'<td>{significant(item.rms_before)} {item.unit}</td>'
            f'<td>{significant(item.rms_after)} {item.unit}</td>'
            f'<td>{chances[0]}</td><td>{chances[1]}</td></tr>'
        )
    return (
        '<table><tr><th>block, log, channel</th><th>RMS, model</th><th>RMS, identified</th>'
        '<th>p-value: white</th><th>p-value: independent of the command</th></tr>'
        f'{rows}</table>'
    )


def _draw_parameters(result: Identification) -> Figure:
    """Draw every identified parameter with its interval, in scaled values."""
    parameters, found = result.estimate.parameters, result.estimate.conditioning
    places = [place for place, left_open in enumerate(found.open) if not left_open]
    figure, panel = plt.subplots(figsize=(11.0, 1.4 + 0.4 * len(places)), layout='constrained')
    for row, place in enumerate(places):
        panel.errorbar(
            100.0 * result.estimate.scaled[place], row, fmt='o', color=AFTER, capsize=4,
            xerr=100.0 * NORMAL_95 * found.standard_errors[place],
        )  # fmt: skip
    panel.axvline(0.0, color=BEFORE, lw=1.0, label='model')
    panel.set_yticks(range(len(places)), [parameters[place].path for place in places])
    panel.set_ylim(len(places) - 0.5, -0.5)
    panel.set_xlabel('change and 95 % interval [% (logarithmic), or % of half the range]')
    panel.grid(alpha=0.3)
    panel.legend(loc='best', fontsize=8)
    return figure


def _draw_conditioning(result: Identification) -> Figure:
    """Draw singular values, and the correlation of the estimates as a matrix."""
    found = result.estimate.conditioning
    names = [parameter.path for parameter in result.estimate.parameters]
    size = max(3.2, 0.5 * len(names) + 1.5)
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11.0, size), layout='constrained', width_ratios=(1.0, 1.6)
    )
    values = np.maximum(found.singular_values, 1e-6)
    left.semilogy(np.arange(1, len(values) + 1), values, 'o-', color=AFTER)
    left.axhline(2.0, color=BEFORE, lw=1.0, label='below: left open')
    left.set_xticks(range(1, len(values) + 1))
    left.set_xlabel('combination')
    left.set_ylabel('singular value')
    left.grid(alpha=0.3, which='both')
    left.legend(fontsize=8)
    image = right.imshow(found.correlation, cmap='RdBu_r', vmin=-1.0, vmax=1.0)
    for row, line in enumerate(found.correlation):
        for column, value in enumerate(line):
            colour = 'white' if abs(value) > 0.6 else 'black'
            right.text(
                column, row, f'{value:.2f}', ha='center', va='center', fontsize=8, color=colour
            )
    right.set_yticks(range(len(names)), names, fontsize=8)
    right.set_xticks(range(len(names)), [str(place + 1) for place in range(len(names))])
    right.set_title('correlation of the estimates', fontsize=10)
    figure.colorbar(image, ax=right, shrink=0.8)
    return figure


def _draw_whiteness(result: Identification) -> Figure:
    """Draw autocorrelations of what is left, and their correlation with earlier input."""
    items = [item for item in result.channels if item.whiteness is not None][:MOST_CHANNELS]
    figure, panels = plt.subplots(
        max(1, len(items)), 2, figsize=(11.0, 1.0 + 1.5 * max(1, len(items))), squeeze=False,
        layout='constrained', sharex=True,
    )  # fmt: skip
    for row, item in zip(panels, items, strict=False):
        assert item.whiteness is not None
        for panel, values, first in (
            (row[0], item.whiteness.autocorrelation, 1),
            (row[1], item.whiteness.input_correlation, 0),
        ):
            if values is not None:
                lags_ms = 1e3 * item.step_s * np.arange(first, first + len(values))
                panel.bar(lags_ms, values, color=AFTER, width=0.7e3 * item.step_s)
            bound = item.whiteness.bound
            panel.axhspan(-bound, bound, color='#dddddd', zorder=0)
            panel.grid(alpha=0.3)
        row[0].set_title(f'{item.block}, {item.log}: {item.name}', fontsize=9, loc='left')
    panels[-1][0].set_xlabel('lag of the residual with itself [ms]')
    panels[-1][1].set_xlabel('lag behind the commanded position [ms]')
    return figure
