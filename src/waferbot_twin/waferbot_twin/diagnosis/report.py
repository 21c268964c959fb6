# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis: a sentence, JSON, an overlay that every node loads, and a page."""

from __future__ import annotations

import dataclasses
import html
import math
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from waferbot_twin.cli.console import finite, significant
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

SCHEMA = 2

ROUNDING = 1e-9
"""RMS residual (counts, A or V) below which nothing is left over."""

NO_INTERVAL = (math.nan, math.nan)
"""The ends of the interval of a parameter that has none: null in JSON."""

HARDLY_PERCENT = 1.0
"""Improvement of the RMS error below which it is no argument."""

MOST_NAMED = 6
"""How many causes the sentence names; all of them are in the table."""


def sentence(diagnosis: Diagnosis) -> str:
    """Return in a few words what explains most of the error, how sure that is, and what stays open."""
    if not diagnosis.causes:
        if not diagnosis.unexplained:
            return 'Nothing significant is wrong: the model explains the logs.'
        return f'No known cause explains {_places_left(diagnosis)}.'
    first = diagnosis.causes[0]
    text = f'{in_words(first)} on {TITLES[first.cause.axis]} {_reading(first)}'
    more = len(diagnosis.causes) - 1
    if more:
        text += f', with {more} more {"causes" if more > 1 else "cause"}'
    text += '.'
    best = max(diagnosis.gains, key=lambda item: item.improvement_percent, default=None)
    if best is not None and best.improvement_percent >= HARDLY_PERCENT:
        text += (
            f' The error in the validation data falls by {best.improvement_percent:.0f} % on '
            f'{TITLES[best.axis]}.'
        )
    if diagnosis.unexplained:
        text += f' Unexplained: {_places_left(diagnosis)}.'
    return text


def _places_left(diagnosis: Diagnosis) -> str:
    axes = dict.fromkeys(TITLES[item.axis] for item in diagnosis.unexplained)
    return 'something on ' + ', '.join(axes)


def in_words(found: FoundCause) -> str:
    """Return a cause with its main value: what an engineer calls it, how large, in its unit."""
    name = found.cause.effect.name.replace('_', ' ')
    main = next((item for item in found.parameters if not item.shape), None)
    if main is None:
        return name
    value = f'{significant(found.cause.values[main.name])} {main.unit}'.rstrip()
    return f'{name} ({main.name} {value})'


def _reading(found: FoundCause) -> str:
    """Return how a probability reads; with what the cause cannot be told from."""
    if found.probability >= 0.95:
        return 'is there beyond doubt'
    others = ', '.join(item.cause.effect.name.replace('_', ' ') for item in found.alternatives)
    doubt = 'likely' if found.probability >= 0.8 else 'perhaps'
    rest = f'; these logs cannot tell it from {others}' if others else ''
    return f'explains it, {doubt} (probability {found.probability:.2f}{rest})'


def as_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the diagnosis as plain values, as `report.json` has them (schema 2)."""
    return {
        'schema': SCHEMA,
        'model': diagnosis.nominal.name,
        'verdict': diagnosis.verdict,
        'sentence': sentence(diagnosis),
        'causes': [_cause(found) for found in diagnosis.causes],
        'withdrawn': [cause.name for cause in diagnosis.withdrawn],
        'unexplained': [dataclasses.asdict(item) for item in diagnosis.unexplained],
        'residual_rms': diagnosis.residual_rms,
        'gain': {
            'validation': diagnosis.validation,
            'axes': gain_of_axes(diagnosis.gains),
        },
        'logs': {'estimation': diagnosis.estimation, 'validation': diagnosis.validation},
        'notes': diagnosis.notes,
        'settings': dataclasses.asdict(diagnosis.settings),
        'tried': diagnosis.tried,
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
        'probability': found.probability,
        'log_evidence': found.log_evidence,
        'share': found.share,
        'credible_set': [
            {
                'effect': item.cause.effect.name,
                'axis': item.cause.axis,
                'probability': item.probability,
                'values': item.cause.values,
            }
            for item in found.credible_set
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
        f'<p>Estimation: {html.escape(", ".join(diagnosis.estimation))}; validation: '
        f'{html.escape(", ".join(diagnosis.validation))}. {diagnosis.tried} effects were tried '
        f'in {diagnosis.runtime_s:.0f} s.</p>',
    ]
    return html_page('Diagnosis', body)


def _draw_residuals(diagnosis: Diagnosis) -> Figure:
    """
    Draw what every block leaves over in the first log for finding, before and after.

    Channels of which nothing but rounding is left have no panel.
    """
    before, after = diagnosis.before, diagnosis.after
    shown = [
        (block, place, name)
        for block, channels in diagnosis.residual_rms.items()
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
            f'<td>{100 * found.probability:.0f} %</td><td>{100 * found.share:.0f} %</td>'
            f'<td>{_set_in_words(found)}</td></tr>'
        )
    return (
        '<table><tr><th>effect</th><th>axis</th><th>parameters (95 %)</th><th>probability</th>'
        f'<th>share of the error</th><th>credible set</th></tr>{rows}</table>'
    )


def _set_in_words(found: FoundCause) -> str:
    """Return the members of a credible set, each with its probability."""
    return '<br>'.join(
        f'{item.cause.effect.name.replace("_", " ")} ({item.cause.axis}) {100 * item.probability:.0f} %'
        for item in found.credible_set
    )
