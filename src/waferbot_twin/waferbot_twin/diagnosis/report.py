# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis: a sentence, JSON, an overlay that every node loads, and a page."""

from __future__ import annotations

import base64
import html
import io
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import significant
from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause
from waferbot_twin.diagnosis.gain import AxisGain
from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.plot import TITLES, scaled_unit
from waferbot_twin.recording.writer import as_json

SCHEMA = 1
BEFORE, AFTER, MEASURED = '#c46a1b', '#1f5fa8', '#222222'
NORMAL_95 = 1.96

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
p.verdict { font-size: 1.15rem; background: #eef3fa; padding: .8rem 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; } img { max-width: 100%; }
"""


def sentence(diagnosis: Diagnosis) -> str:
    """Return which effect, on which axis, how sure, what it gains, and what stays unexplained."""
    parts = []
    for found in diagnosis.causes:
        cause = found.cause
        values = ', '.join(
            f'{item.name} {significant(cause.values[item.name])} {item.unit}'.rstrip()
            for item in found.parameters
        )
        text = f'{cause.effect.name} on {TITLES[cause.axis]} ({values}; {_sure(found)})'
        if found.cannot_tell_from:
            text += f', which this data cannot tell from {", ".join(found.cannot_tell_from)}'
        parts.append(text)
    if not parts and not diagnosis.unexplained_where:
        return 'Nothing significant is wrong: the model explains the logs.'
    lines = []
    if parts:
        lines.append('The machine has ' + '; '.join(parts) + '.')
        best = max(diagnosis.gains, key=lambda item: item.improvement_percent, default=None)
        if best is not None and best.improvement_percent > 0.0:
            lines.append(
                f'With it the error in logs that were not used for the fit falls by '
                f'{best.improvement_percent:.1f} % on {TITLES[best.axis]}.'
            )
    if diagnosis.unexplained_where:
        axes = ', '.join(TITLES[axis] for axis in dict.fromkeys(diagnosis.unexplained_where))
        described = ', '.join(cause.effect.name for cause in diagnosis.unexplained)
        lines.append(
            f'Unexplained on {axes}' + (f', described by {described}.' if described else '.')
        )
    return ' '.join(lines)


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
        'verdict': diagnosis.verdict,
        'sentence': sentence(diagnosis),
        'causes': [_cause(found) for found in diagnosis.causes],
        'withdrawn': [cause.name for cause in diagnosis.withdrawn],
        'unexplained': _unexplained(diagnosis),
        'where': diagnosis.where,
        'gain': {
            'validation': diagnosis.judging,
            'axes': {
                axis: _gain([item for item in diagnosis.gains if item.axis == axis])
                for axis in dict.fromkeys(item.axis for item in diagnosis.gains)
            },
        },
        'logs': {'finding': diagnosis.finding, 'judging': diagnosis.judging},
        'notes': diagnosis.notes,
        'tried': diagnosis.search.tried,
        'runtime_s': diagnosis.runtime_s,
    }


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
                'low95': found.cause.values[item.name]
                - NORMAL_95 * found.standard_error.get(item.name, math.nan),
                'high95': found.cause.values[item.name]
                + NORMAL_95 * found.standard_error.get(item.name, math.nan),
            }
            for item in found.parameters
        },
        'confidence': found.confidence,
        'delta_bic': found.delta_bic,
        'cannot_tell_from': list(found.cannot_tell_from),
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


def _gain(items: list[AxisGain]) -> dict[str, Any]:
    """Return the gain of one axis over all judging logs."""
    before = math.sqrt(float(np.mean([item.rms_before**2 for item in items])))
    after = math.sqrt(float(np.mean([item.rms_after**2 for item in items])))
    improvement = 100.0 * (before - after) / before if before > 0.0 else 0.0
    return {
        'unit': items[0].unit,
        'rms_before': before,
        'rms_after': after,
        'improvement_percent': improvement,
        'metrics': {
            item.log: {
                'rms_before': item.rms_before,
                'rms_after': item.rms_after,
                'improvement_percent': item.improvement_percent,
            }
            for item in items
        },
    }


def prepare_folder(folder: Path, force: bool) -> None:
    """
    Make the folder of a report; raises `UserError` if it exists, unless `force` and it holds one.

    Done before the diagnosis, so that nobody waits for a result that cannot be written.
    """
    if folder.exists() and not force:
        raise UserError(f'--out {folder} exists; choose another folder or give --force')
    if folder.exists() and not (folder / 'report.json').exists() and any(folder.iterdir()):
        raise UserError(f'--out {folder} holds no report; --force only replaces reports')
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f'--out {folder} cannot be made: {error.strerror}') from error


def write(diagnosis: Diagnosis, folder: Path) -> None:
    """Write `report.json`, `report.html` and `extended.yaml` into an existing folder."""
    (folder / 'report.json').write_text(as_json(_finite(as_dict(diagnosis))) + '\n', 'utf-8')
    names = ', '.join(found.cause.name for found in diagnosis.causes) or 'no cause was found'
    header = f'# The model {diagnosis.nominal.name}, extended by a diagnosis: {names}.\n'
    (folder / 'extended.yaml').write_text(header + diagnosis.extended.model().text, 'utf-8')
    (folder / 'report.html').write_text(page(diagnosis), 'utf-8')


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def page(diagnosis: Diagnosis) -> str:
    """Return the report as one HTML page with its pictures inside."""
    body = [
        '<h1>Diagnosis: what the simulation gets wrong</h1>',
        f'<p class="verdict">{html.escape(sentence(diagnosis))}</p>',
        *(f'<p>{html.escape(note)}.</p>' for note in diagnosis.notes),
        '<h2>Error before and after, in logs that were not used for the fit</h2>',
        _picture(_draw_gains(diagnosis)),
        _gain_table(diagnosis),
        '<h2>Where: what each block alone leaves over</h2>',
        _picture(_draw_residuals(diagnosis)),
        '<h2>Causes</h2>',
        _cause_table(diagnosis),
        '<h2>Logs</h2>',
        f'<p>Found in {html.escape(", ".join(diagnosis.finding))}; judged by '
        f'{html.escape(", ".join(diagnosis.judging))}. {diagnosis.search.tried} effects were tried '
        f'in {diagnosis.runtime_s:.0f} s.</p>',
    ]
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Diagnosis</title>'
        f'<style>{STYLE}</style></head><body>{"".join(body)}</body></html>\n'
    )


def _picture(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=100, metadata={'Software': 'waferbot'})
    plt.close(figure)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="" src="data:image/png;base64,{data}">'


def _draw_gains(diagnosis: Diagnosis) -> Figure:
    """Draw measured position, and errors of both models, for every axis of the first judging log."""
    log = diagnosis.gains[0].log if diagnosis.gains else ''
    items = [item for item in diagnosis.gains if item.log == log]
    figure, panels = plt.subplots(
        2, max(1, len(items)), figsize=(12.0, 5.4), squeeze=False, layout='constrained',
        sharex='col',
    )  # fmt: skip
    for column, item in enumerate(items):
        factor, unit = scaled_unit(item.measured - item.measured[0], item.unit)
        panels[0][column].plot(item.time_s, item.measured * factor, color=MEASURED, lw=1.0)
        panels[0][column].set_title(TITLES[item.axis])
        panels[0][column].set_ylabel(f'measured [{unit}]')
        factor, unit = scaled_unit(item.error_before, item.unit)
        for error, colour, label in (
            (item.error_before, BEFORE, f'nominal, RMS {item.rms_before * factor:.3g} {unit}'),
            (item.error_after, AFTER, f'extended, RMS {item.rms_after * factor:.3g} {unit}'),
        ):
            panels[1][column].plot(item.time_s, error * factor, color=colour, lw=0.8, label=label)
        panels[1][column].set_ylabel(f'simulated - measured [{unit}]')
        panels[1][column].set_xlabel('time [s]')
        panels[1][column].legend(fontsize=8, loc='best')
        for row in range(2):
            panels[row][column].grid(alpha=0.3)
    figure.suptitle(log, fontsize=10)
    return figure


def _draw_residuals(diagnosis: Diagnosis) -> Figure:
    """Draw what every block leaves over in the first log for finding, before and after."""
    before, after = diagnosis.search.nothing, diagnosis.search.found
    rows = [
        (block, place) for block, names in diagnosis.where.items() for place in range(len(names))
    ]
    figure, panels = plt.subplots(
        len(rows), 1, figsize=(12.0, 1.2 + 1.5 * len(rows)), squeeze=False, layout='constrained'
    )
    for panel, (block, place) in zip(panels[:, 0], rows, strict=True):
        _draw_residual(panel, before, after, block, place)
        panel.set_title(f'{block}: {list(diagnosis.where[block])[place]}', fontsize=9, loc='left')
    panels[-1][0].set_xlabel('servo cycle')
    panels[0][0].legend(fontsize=8, loc='upper right')
    return figure


def _draw_residual(
    panel: Any, before: Hypothesis, after: Hypothesis, block: str, place: int
) -> None:
    unit = 'counts' if block == 'plant' else 'A'
    for hypothesis, colour, label in ((before, BEFORE, 'nominal'), (after, AFTER, 'extended')):
        panel.plot(hypothesis.residuals[block][place], color=colour, lw=0.7, label=label)
    panel.set_ylabel(f'[{unit}]')
    panel.grid(alpha=0.3)


def _gain_table(diagnosis: Diagnosis) -> str:
    rows = ''.join(
        f'<tr><td>{html.escape(item.log)}, {TITLES[item.axis]}</td>'
        f'<td>{item.rms_before:.4g} {item.unit}</td><td>{item.rms_after:.4g} {item.unit}</td>'
        f'<td>{item.improvement_percent:.1f} %</td></tr>'
        for item in diagnosis.gains
    )
    return (
        '<table><tr><th>log, axis</th><th>RMS error, nominal</th><th>RMS error, extended</th>'
        f'<th>improvement (6.1)</th></tr>{rows}</table>'
    )


def _cause_table(diagnosis: Diagnosis) -> str:
    if not diagnosis.causes:
        return '<p>None.</p>'
    rows = ''
    for found in diagnosis.causes:
        values = '<br>'.join(
            f'{item.name} = {significant(found.cause.values[item.name])} '
            f'± {significant(NORMAL_95 * found.standard_error.get(item.name, math.nan), 2)} '
            f'{html.escape(item.unit)}'
            for item in found.parameters
        )
        rows += (
            f'<tr><td>{found.cause.effect.name}<br><small>{html.escape(found.cause.effect.summary)}'
            f'</small></td><td>{TITLES[found.cause.axis]}</td><td>{values}</td>'
            f'<td>{found.delta_bic:.0f}</td><td>{100 * found.confidence:.0f} %</td>'
            f'<td>{", ".join(found.cannot_tell_from) or "-"}</td></tr>'
        )
    return (
        '<table><tr><th>effect</th><th>axis</th><th>parameters (95 %)</th><th>gain in BIC</th>'
        f'<th>confidence</th><th>cannot tell from</th></tr>{rows}</table>'
    )
