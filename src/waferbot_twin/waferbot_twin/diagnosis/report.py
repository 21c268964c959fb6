# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis: a sentence, JSON, an overlay that every node loads, and a page."""

from __future__ import annotations

import html
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from waferbot_twin.cli.console import finite, significant
from waferbot_twin.diagnosis.alike import Alike
from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.html_page import html_page, picture, save_picture
from waferbot_twin.plot import TITLES
from waferbot_twin.recording.writer import as_json
from waferbot_twin.residuals.problem import PLANT, UNITS
from waferbot_twin.validation.gain_report import (
    AFTER,
    BEFORE,
    draw_gains,
    gain_of_axes,
    gain_table,
)

SCHEMA = 1

ROUNDING = 1e-9
"""RMS residual (counts, A or V) below which nothing is left over."""

NO_INTERVAL = (math.nan, math.nan)
"""The ends of the interval of a parameter that has none: null in JSON."""

HARDLY_PERCENT = 1.0
"""Improvement of the RMS error below which it is no argument."""

MOST_NAMED = 6
"""How many causes the sentence names; all of them are in the table."""


def sentence(diagnosis: Diagnosis) -> str:
    """Return which effect, on which axis, how sure, what it gains, and what stays unexplained."""
    parts = [_one_cause(found) for found in diagnosis.causes]
    if not parts and not diagnosis.unexplained_where:
        return 'Nothing significant is wrong: the model explains the logs.'
    lines = []
    if parts:
        more = len(parts) - MOST_NAMED
        rest = f'; and {more} more' if more > 0 else ''
        lines.append('The machine has ' + '; '.join(parts[:MOST_NAMED]) + rest + '.')
        best = max(diagnosis.gains, key=lambda item: item.improvement_percent, default=None)
        if best is not None and best.improvement_percent >= HARDLY_PERCENT:
            lines.append(
                f'With it the error in logs that were not used for the fit falls by '
                f'{best.improvement_percent:.1f} % on {TITLES[best.axis]}.'
            )
        elif best is not None:
            lines.append(
                'The RMS error in logs that were not used for the fit hardly shows it (best: '
                f'{best.improvement_percent:+.1f} % on {TITLES[best.axis]}).'
            )
    if diagnosis.unexplained_where:
        axes = ', '.join(TITLES[axis] for axis in dict.fromkeys(diagnosis.unexplained_where))
        described = ', '.join(cause.effect.name for cause in diagnosis.unexplained)
        lines.append(
            f'Unexplained on {axes}' + (f', described by {described}.' if described else '.')
        )
    return ' '.join(lines)


def _alike(item: Alike) -> str:
    return f'{item.cause.name} (correlation of their signatures {item.correlation:.3f})'


def _one_cause(found: FoundCause) -> str:
    cause = found.cause
    values = ', '.join(
        f'{item.name} {significant(cause.values[item.name])} {item.unit}'.rstrip()
        for item in found.parameters
    )
    text = f'{cause.effect.name} on {TITLES[cause.axis]} ({values}; {_sure(found)})'
    if found.cannot_tell_from:
        text += f', which this data cannot tell from {", ".join(map(_alike, found.alike))}'
    return text


def _sure(found: FoundCause) -> str:
    if found.confidence > 0.99:
        return 'beyond doubt'
    if found.confidence > 0.9:
        return 'very likely'
    return 'likely' if found.confidence > 0.6 else 'perhaps'


def as_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the diagnosis as plain values, as `report.json` has them (schema 1)."""
    return {
        'schema': SCHEMA,
        'model': diagnosis.nominal.name,
        'verdict': diagnosis.verdict,
        'sentence': sentence(diagnosis),
        'causes': [_cause(found) for found in diagnosis.causes],
        'withdrawn': [cause.name for cause in diagnosis.withdrawn],
        'unexplained': _unexplained(diagnosis),
        'where': diagnosis.where,
        'gain': {
            'validation': diagnosis.judging,
            'axes': gain_of_axes(diagnosis.gains),
        },
        'logs': {'finding': diagnosis.finding, 'judging': diagnosis.judging},
        'notes': diagnosis.notes,
        'tried': diagnosis.search.tried,
        'runtime_s': diagnosis.runtime_s,
    }


def uncertainty(found: FoundCause, parameter: Parameter) -> str:
    """Return the interval of a parameter as text."""
    if parameter.name not in found.intervals_95:
        return '(chosen from a few)' if parameter.name in found.cause.held else '± -'
    value, (low, high) = found.cause.values[parameter.name], found.intervals_95[parameter.name]
    below, above = value - low, high - value
    if math.isclose(below, above, rel_tol=0.01, abs_tol=1e-9 * abs(value)):
        return f'± {significant(above, 2)}'
    return f'({significant(low)} to {significant(high)})'


def _cause(found: FoundCause) -> dict[str, Any]:
    return {
        'effect': found.cause.effect.name,
        'axis': found.cause.axis,
        'block': found.cause.effect.block.value,
        'summary': found.cause.effect.summary,
        'parameters': {
            item.name: {
                'value': found.cause.values[item.name],
                'unit': item.unit,
                'low95': found.intervals_95.get(item.name, NO_INTERVAL)[0],
                'high95': found.intervals_95.get(item.name, NO_INTERVAL)[1],
            }
            for item in found.parameters
        },
        'confidence': found.confidence,
        'delta_bic': found.delta_bic,
        'cannot_tell_from': list(found.cannot_tell_from),
        'rivals': [
            {
                'effect': item.cause.effect.name,
                'axis': item.cause.axis,
                'values': item.cause.values,
                'behind': item.behind,
                'correlation': item.correlation,
            }
            for item in found.alike
        ],
    }


def _unexplained(diagnosis: Diagnosis) -> dict[str, Any] | None:
    if not diagnosis.unexplained_where:
        return None
    return {
        'axes': list(dict.fromkeys(diagnosis.unexplained_where)),
        'described_by': [
            {'table': cause.effect.name, 'axis': cause.axis, 'values': cause.values}
            for cause in diagnosis.unexplained
        ],
    }


def write(diagnosis: Diagnosis, folder: Path) -> None:
    """Write `report.json`, `report.html`, `gain.png` and `extended.yaml` into an existing folder."""
    (folder / 'report.json').write_text(as_json(finite(as_dict(diagnosis))) + '\n', 'utf-8')
    names = ', '.join(found.cause.name for found in diagnosis.causes) or 'no cause was found'
    header = f'# The model {diagnosis.nominal.name}, extended by a diagnosis: {names}.\n'
    extended = diagnosis.extended
    text = extended.machine_text if extended.is_machine_alone else extended.model().text
    (folder / 'extended.yaml').write_text(header + text, 'utf-8')
    (folder / 'report.html').write_text(page(diagnosis), 'utf-8')
    save_picture(draw_gains(diagnosis.gains), folder / 'gain.png')


def page(diagnosis: Diagnosis) -> str:
    """Return the report as one HTML page with its pictures inside."""
    body = [
        '<h1>Diagnosis: what the simulation gets wrong</h1>',
        f'<p class="verdict">{html.escape(sentence(diagnosis))}</p>',
        *(f'<p>{html.escape(note)}.</p>' for note in diagnosis.notes),
        '<h2>Error before and after, in logs that were not used for the fit</h2>',
        picture(draw_gains(diagnosis.gains)),
        gain_table(diagnosis.gains),
        '<h2>Where: what each block alone leaves over</h2>',
        picture(_draw_residuals(diagnosis)),
        '<h2>Causes</h2>',
        _cause_table(diagnosis),
        '<h2>Logs</h2>',
        f'<p>Found in {html.escape(", ".join(diagnosis.finding))}; judged by '
        f'{html.escape(", ".join(diagnosis.judging))}. {diagnosis.search.tried} effects were tried '
        f'in {diagnosis.runtime_s:.0f} s.</p>',
    ]
    return html_page('Diagnosis', body)


def _draw_residuals(diagnosis: Diagnosis) -> Figure:
    """
    Draw what every block leaves over in the first log for finding, before and after.

    Channels of which nothing but rounding is left have no panel.
    """
    before, after = diagnosis.search.nothing, diagnosis.search.found
    shown = [
        (block, place, name)
        for block, channels in diagnosis.where.items()
        for place, (name, left) in enumerate(channels.items())
        if left > ROUNDING
    ]
    rows = max(1, -(-len(shown) // 2))
    figure, panels = plt.subplots(
        rows, 2, figsize=(12.0, 1.2 + 1.5 * rows), squeeze=False, layout='constrained'
    )
    for panel, (block, place, name) in zip(panels.T.flat, shown, strict=False):
        _draw_residual(panel, before, after, block, place)
        title = f'{block}: {name}{_coarser(diagnosis, block, name)}'
        panel.set_title(title, fontsize=9, loc='left')
    for panel in panels.T.flat[len(shown) :]:
        panel.set_axis_off()
    for panel in panels[-1]:
        panel.set_xlabel('servo cycle')
    if shown:
        panels[0][0].legend(fontsize=8, loc='upper right')
    return figure


def _coarser(diagnosis: Diagnosis, block: str, name: str) -> str:
    """Return in which steps the residual of an encoder is that was found to be coarse."""
    if block != PLANT:
        return ''
    before, after = (
        model.description.encoders[name].errors.coarseness
        for model in (diagnosis.nominal, diagnosis.extended)
    )
    return f' (extended: in steps of {after:g} counts)' if after != before else ''


def _draw_residual(
    panel: Any, before: Hypothesis, after: Hypothesis, block: str, place: int
) -> None:
    for hypothesis, colour, label in ((before, BEFORE, 'nominal'), (after, AFTER, 'extended')):
        panel.plot(hypothesis.residuals[block][place], color=colour, lw=0.7, label=label)
    panel.set_ylabel(f'[{UNITS[block]}]')
    panel.grid(alpha=0.3)


def _cause_table(diagnosis: Diagnosis) -> str:
    if not diagnosis.causes:
        return '<p>None.</p>'
    rows = ''
    for found in diagnosis.causes:
        values = '<br>'.join(
            f'{item.name} = {significant(found.cause.values[item.name])} '
            f'{html.escape(item.unit)} {uncertainty(found, item)}'
            for item in found.parameters
        )
        rows += (
            f'<tr><td>{found.cause.effect.name}<br><small>{html.escape(found.cause.effect.summary)}'
            f'</small></td><td>{TITLES[found.cause.axis]}</td><td>{values}</td>'
            f'<td>{found.evidence}</td><td>{100 * found.confidence:.0f} %</td>'
            f'<td>{"<br>".join(map(_alike, found.alike)) or "-"}</td></tr>'
        )
    return (
        '<table><tr><th>effect</th><th>axis</th><th>parameters (95 %)</th><th>gain in BIC</th>'
        f'<th>confidence</th><th>cannot tell from</th></tr>{rows}</table>'
    )
