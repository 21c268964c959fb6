# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis in files: JSON, an overlay that every node loads, and a page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from waferbot_twin.diagnosis import figures
from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause
from waferbot_twin.diagnosis.wording import (
    BLOCKS,
    UserUnit,
    capital,
    in_words,
    interval_text,
    percent_text,
    probability_text,
    reading,
    sentence,
    title,
    user_unit,
)
from waferbot_twin.effects.variant import Variant
from waferbot_twin.html_page import STYLE, picture, save_picture
from waferbot_twin.plain_values import finite, significant, with_prefix
from waferbot_twin.plot import TITLES
from waferbot_twin.recording.writer import as_json
from waferbot_twin.validation.gain_report import (
    HARDLY_PERCENT,
    draw_gains,
    gain_of_axes,
    gain_table,
)

SCHEMA = 2

NO_INTERVAL = (math.nan, math.nan)
"""The ends of the interval of a parameter that has none: null in JSON."""


def as_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """
    Return the diagnosis as plain values, as `report.json` has them (schema 2).

    Values are in the unit that stands beside them; shares and probabilities are 0 to 1.
    """
    return {
        'schema': SCHEMA,
        'model': diagnosis.nominal.name,
        'verdict': diagnosis.verdict,
        'sentence': sentence(diagnosis),
        'causes': [_cause(diagnosis.nominal, found) for found in diagnosis.causes],
        'possible': [_cause(diagnosis.nominal, found) for found in diagnosis.possible],
        'withdrawn': [cause.name for cause in diagnosis.withdrawn],
        'corrections': [dataclasses.asdict(item) for item in diagnosis.corrections],
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


def _cause(nominal: Variant, found: FoundCause) -> dict[str, Any]:
    return {
        'effect': found.cause.effect.name,
        'axis': found.cause.axis,
        'block': found.cause.effect.block.value,
        'title': title(found.cause),
        'words': in_words(nominal, found.cause),
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
        'inclusion': found.inclusion,
        'probability': found.probability,
        'reading': reading(found.probability),
        'log_evidence': found.log_evidence,
        'share': found.share,
        'credible_set': [
            {
                'effect': item.cause.effect.name,
                'axis': item.cause.axis,
                'title': title(item.cause),
                'probability': item.probability,
                'values': item.cause.values,
            }
            for item in found.credible_set
        ],
    }


def write(diagnosis: Diagnosis, folder: Path) -> None:
    """Write `report.json`, `report.html`, `gain.png` and `extended.yaml` into an existing folder."""
    (folder / 'report.json').write_text(as_json(finite(as_dict(diagnosis))) + '\n', 'utf-8')
    (folder / 'extended.yaml').write_text(extended_text(diagnosis), 'utf-8')
    (folder / 'report.html').write_text(page(diagnosis), 'utf-8')
    save_picture(draw_gains(diagnosis.gains), folder / 'gain.png')


def extended_text(diagnosis: Diagnosis) -> str:
    """Return the extended model as the text of a file that nodes load; of a machine alone, its own."""
    every = [*diagnosis.causes, *diagnosis.possible]
    names = ', '.join(found.cause.name for found in every) or 'no cause was found'
    header = f'# The model {diagnosis.nominal.name}, extended by a diagnosis: {names}.\n'
    return header + diagnosis.extended.text


def page(diagnosis: Diagnosis) -> str:
    """Return the report as one HTML page with its pictures inside."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        files('waferbot_twin.diagnosis').joinpath('report.html').read_text('utf-8')
    )
    nominal, forces = diagnosis.nominal, figures.draw_forces(diagnosis)
    return template.render(
        style=Markup(STYLE),
        model=nominal.name,
        sentence=sentence(diagnosis),
        notes=[capital(note) for note in diagnosis.notes],
        causes=[_row(nominal, found) for found in diagnosis.causes],
        possible=[_row(nominal, found) for found in diagnosis.possible],
        named_from=probability_text(diagnosis.settings.named_from),
        credible=percent_text(diagnosis.settings.credible_level),
        corrections=[_correction_row(item) for item in diagnosis.corrections],
        unexplained=[
            {
                'axis': TITLES[item.axis],
                'share': percent_text(item.share),
                'width': _width(item.share),
                'block': BLOCKS[item.block],
                'with_what': item.with_what,
            }
            for item in diagnosis.unexplained
        ],
        validation_words=_validation_words(diagnosis),
        # Made by us, of escaped text and numbers.
        gain_picture=Markup(picture(draw_gains(diagnosis.gains))),
        gain_table=Markup(gain_table(diagnosis.gains)),
        first_log=diagnosis.problem.records[0].name,
        residual_picture=Markup(picture(figures.draw_residuals(diagnosis))),
        force_picture=Markup(picture(forces)) if forces is not None else '',
        bins=figures.BINS,
        estimation=diagnosis.estimation,
        validation=diagnosis.validation,
        tried=diagnosis.tried,
        runtime=f'{diagnosis.runtime_s:.0f}',
    )


def _width(share: float) -> str:
    """Return how long the bar of a share is, in percent of its track."""
    return f'{100.0 * min(max(share, 0.0), 1.0):.1f}'


def _row(nominal: Variant, found: FoundCause) -> dict[str, Any]:
    return {
        'share': percent_text(found.share),
        'width': _width(found.share),
        'words': capital(in_words(nominal, found.cause)),
        'summary': found.cause.effect.summary,
        'reading': reading(found.probability),
        'probability': probability_text(found.probability),
        'parameters': list(_parameter_rows(nominal, found)),
        'alternatives': [
            {
                'words': in_words(nominal, item.cause),
                'probability': probability_text(item.probability),
            }
            for item in found.alternatives
        ],
    }


def _parameter_rows(nominal: Variant, found: FoundCause) -> Iterator[dict[str, str]]:
    for label, value, interval in parameter_texts(nominal, found):
        yield {'label': label, 'value': value, 'interval': interval}


def parameter_texts(nominal: Variant, found: FoundCause) -> list[tuple[str, str, str]]:
    """Return name, value and 95 % interval of every parameter of a cause, in the user's units."""
    rows = []
    for item in found.parameters:
        value = found.cause.values[item.name]
        shown = user_unit(nominal, found.cause.axis, item, value)
        label = 'difference from the model' if item.name == 'ratio' else item.name
        if item.name == 'difference':  # of an I-variable
            label = f'{item.meaning.split()[0]}, more than in the model'
        interval = interval_text(found, item, shown)
        rows.append((label.replace('_', ' '), shown.text(value, 4), interval))
    return rows


def _correction_row(item: Correction) -> dict[str, str]:
    factor, unit = with_prefix(max(abs(item.nominal), abs(item.found)), item.unit)
    shown = UserUnit(factor, unit)
    low, high = significant(shown.of(item.low)), significant(shown.of(item.high))
    return {
        'parameter': item.parameter,
        'nominal': shown.text(item.nominal, 4),
        'found': shown.text(item.found, 4),
        'interval': f'{low} to {high} {unit}'.rstrip(),
    }


def _validation_words(diagnosis: Diagnosis) -> str:
    """Return what the largest gain is, or that there is none."""
    best = max(diagnosis.gains, key=lambda item: item.improvement_percent, default=None)
    if best is None:
        return 'The validation data have no axis whose position is known.'
    how = 'closed loop' if best.closed_loop else 'plant, driven by the measured currents'
    said = (
        'For this the causes were fitted to the estimation data alone; their values above are those of '
        f'all logs. Error is simulated less measured position ({how}); '
    )
    if best.improvement_percent < HARDLY_PERCENT:
        return said + 'the extended model is not nearer to them than the nominal one.'
    return said + (
        f'its RMS falls most on {TITLES[best.axis]}, by {best.improvement_percent:.0f} %.'
    )
