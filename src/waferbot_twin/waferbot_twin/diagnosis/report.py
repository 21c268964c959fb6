# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis in files: JSON, an overlay that every node loads, and a page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from waferbot_twin.diagnosis import figures
from waferbot_twin.diagnosis.bands import Band, band_of, band_text
from waferbot_twin.diagnosis.corrections import (
    StatedCorrection,
    stated,
    stated_accelerations,
)
from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause
from waferbot_twin.diagnosis.findings import AT_BOUND, NOT_TOLD, no_findings, on_bound, remark_of
from waferbot_twin.diagnosis.forces import BINS, draw_forces
from waferbot_twin.diagnosis.once import once
from waferbot_twin.diagnosis.parameters import parameter_texts
from waferbot_twin.diagnosis.reference import reference_dict, reference_remarks, reference_rows
from waferbot_twin.diagnosis.report_schema import SCHEMA
from waferbot_twin.diagnosis.unnamed import gains_with_unnamed
from waferbot_twin.diagnosis.wording import (
    BLOCKS,
    READINGS,
    UserUnit,
    capital,
    in_words,
    instead,
    percent_text,
    probability_text,
    reading,
    sentence,
    title,
)
from waferbot_twin.effects.variant import Variant
from waferbot_twin.html_page import STYLE, picture, save_picture
from waferbot_twin.identification.least_squares import LeastSquares
from waferbot_twin.plain_values import finite, significant, with_prefix
from waferbot_twin.recording.writer import as_json
from waferbot_twin.titles import with_titles
from waferbot_twin.validation.gain import AxisGain, gain_of_axes
from waferbot_twin.validation.gain_report import (
    HARDLY_PERCENT,
    change_text,
    draw_gains,
    gain_table,
)

NO_INTERVAL = (math.nan, math.nan)
"""The ends of the interval of a parameter that has none: null in JSON."""


def as_dict(
    diagnosis: Diagnosis, reference: LeastSquares | None = None, *, quick: bool = False
) -> dict[str, Any]:
    """
    Return the diagnosis as plain values, as `report.json` has them (schema 3).

    Values are in the unit that stands beside them; shares and probabilities are 0 to 1. `reference` are
    the least squares of the same logs, where somebody has them. `quick` leaves out what has to be
    simulated for it: bands, and the gain with what has no name.
    """
    with_unnamed: list[AxisGain] = []
    bands: list[Band | None] = [None] * len(diagnosis.unexplained)
    if not quick:
        with_unnamed, bands = _with_unnamed(diagnosis), _bands(diagnosis)
    return {
        'schema': SCHEMA,
        'model': diagnosis.nominal.name,
        'verdict': diagnosis.verdict,
        'sentence': sentence(diagnosis),
        'causes': [_cause(diagnosis.nominal, found) for found in diagnosis.causes],
        'possible': [_cause(diagnosis.nominal, found) for found in diagnosis.possible],
        'withdrawn': [cause.name for cause in diagnosis.withdrawn],
        'corrections': [
            {
                **dataclasses.asdict(item.correction),
                'parameter': with_titles(item.correction.parameter, diagnosis.nominal.titles),
                'told': item.told,
                'on_bound': item.on_bound,
            }
            for item in stated(diagnosis)
        ],
        'accelerations': [
            {
                **dataclasses.asdict(item),
                'parameter': with_titles(item.parameter, diagnosis.nominal.titles),
            }
            for item in diagnosis.accelerations
        ],
        'unexplained': [
            {**dataclasses.asdict(item), 'band_hz': band}
            for item, band in zip(diagnosis.unexplained, bands, strict=True)
        ],
        'residual_rms': diagnosis.residual_rms,
        'gain': {
            'validation': diagnosis.validation,
            'axes': gain_of_axes(diagnosis.gains),
            'with_unnamed': gain_of_axes(with_unnamed),
        },
        'least_squares': reference_dict(reference),
        'logs': {'estimation': diagnosis.estimation, 'validation': diagnosis.validation},
        'notes': [with_titles(note, diagnosis.nominal.titles) for note in diagnosis.notes],
        'settings': dataclasses.asdict(diagnosis.settings),
        'tried': diagnosis.tried,
        'runtime_s': diagnosis.runtime_s,
    }


def _with_unnamed(diagnosis: Diagnosis) -> list[AxisGain]:
    """Return the gain with what has no name."""
    return once(diagnosis, 'gains_with_unnamed', lambda: gains_with_unnamed(diagnosis))


def _bands(diagnosis: Diagnosis) -> list[Band | None]:
    """Return the band of each item that stays unexplained."""
    return once(
        diagnosis, 'bands', lambda: [band_of(diagnosis, item) for item in diagnosis.unexplained]
    )


def _cause(nominal: Variant, found: FoundCause) -> dict[str, Any]:
    return {
        'effect': found.cause.effect.name,
        'axis': found.cause.axis,
        'block': found.cause.effect.block.value,
        'title': title(nominal, found.cause),
        'words': in_words(nominal, found.cause, no_findings(found)),
        'summary': found.cause.effect.summary,
        'parameters': {
            item.name: {
                'value': found.cause.values[item.name],
                'unit': item.unit,
                'low95': found.intervals_95.get(item.name, NO_INTERVAL)[0],
                'high95': found.intervals_95.get(item.name, NO_INTERVAL)[1],
                'told': remark_of(found, item) != NOT_TOLD,
                'on_bound': on_bound(found, item),
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
                'title': title(nominal, item.cause),
                'probability': item.probability,
                'values': item.cause.values,
            }
            for item in found.credible_set
        ],
        'unnamed': found.unnamed,
    }


def write(diagnosis: Diagnosis, folder: Path, reference: LeastSquares | None = None) -> None:
    """Write `report.json`, `report.html`, `gain.png` and `extended.yaml` into an existing folder."""
    content = as_json(finite(as_dict(diagnosis, reference)))
    (folder / 'report.json').write_text(content + '\n', 'utf-8')
    (folder / 'extended.yaml').write_text(extended_text(diagnosis), 'utf-8')
    (folder / 'report.html').write_text(page(diagnosis, reference), 'utf-8')
    save_picture(draw_gains(diagnosis.gains, diagnosis.nominal.titles), folder / 'gain.png')


def extended_text(diagnosis: Diagnosis) -> str:
    """Return the extended model as the text of a file that nodes load; of a machine alone, its own."""
    names = '; '.join(in_words(diagnosis.nominal, found.cause) for found in diagnosis.causes)
    names = names or 'no cause was found'
    header = f'# The model {diagnosis.nominal.name}, extended by a diagnosis: {names}.\n'
    return header + diagnosis.extended.text


def page(diagnosis: Diagnosis, reference: LeastSquares | None = None) -> str:
    """Return the report as one HTML page with its pictures inside."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        files('waferbot_twin.diagnosis').joinpath('report.html').read_text('utf-8')
    )
    nominal, forces = diagnosis.nominal, draw_forces(diagnosis)
    return template.render(
        style=Markup(STYLE),
        model=nominal.name,
        sentence=sentence(diagnosis),
        notes=[_note(diagnosis, note) for note in diagnosis.notes],
        causes=[_row(nominal, found) for found in diagnosis.causes],
        possible=[_row(nominal, found) for found in diagnosis.possible],
        named_from=probability_text(diagnosis.settings.named_from),
        included_from=probability_text(diagnosis.settings.included_from),
        credible=percent_text(diagnosis.settings.credible_level),
        readings=_readings(),
        corrections=[
            correction_row(item, nominal.titles)
            for item in (*stated(diagnosis), *stated_accelerations(diagnosis))
        ],
        unexplained=unexplained_rows(diagnosis),
        force_picture=Markup(picture(forces)) if forces is not None else '',
        bins=BINS,
        validation_words=_validation_words(diagnosis),
        # Made by us, of escaped text and numbers.
        gain_picture=Markup(picture(draw_gains(diagnosis.gains, nominal.titles))),
        gain_table=Markup(gain_table(diagnosis.gains, nominal.titles)),
        gain_with_unnamed=gain_with_unnamed(diagnosis),
        first_log=diagnosis.problem.records[0].name,
        residual_picture=Markup(picture(figures.draw_residuals(diagnosis))),
        reference=[]
        if reference is None
        else reference_rows(reference, nominal, diagnosis.extended),
        reference_remarks=[] if reference is None else reference_remarks(reference),
        estimation=diagnosis.estimation,
        validation=diagnosis.validation,
        tried=diagnosis.tried,
        runtime=f'{diagnosis.runtime_s:.0f}',
    )


def _note(diagnosis: Diagnosis, note: str) -> str:
    """Return a note as a sentence; the name of a log that it begins with stays as it is."""
    logs = (*diagnosis.estimation, *diagnosis.validation)
    text = with_titles(note, diagnosis.nominal.titles)
    return text if any(note.startswith(f'{name}:') for name in logs) else capital(text)


def _readings() -> list[tuple[str, str]]:
    """Return what a probability reads as, and from where on."""
    lowest = READINGS[-1][1]
    return [(words, f'from {least:g} on') for least, words in READINGS[:-1]] + [(lowest, 'below')]


def unexplained_rows(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """Return what stays unexplained: axis, share, band, where it shows and what it goes with."""
    return [
        {
            'axis': diagnosis.nominal.titles[item.axis],
            'share': percent_text(item.share),
            'width': _width(item.share),
            'band': band_text(band),
            'block': BLOCKS[item.block],
            'with_what': item.with_what,
        }
        for item, band in zip(diagnosis.unexplained, _bands(diagnosis), strict=True)
    ]


def gain_with_unnamed(diagnosis: Diagnosis) -> list[str]:
    """Return, of each axis, what all without a name gains beside what the extended model does."""
    without = gain_of_axes(diagnosis.gains)
    return [
        f'{diagnosis.nominal.titles[axis]}: '
        f'{without[axis]["improvement_percent"]:.1f} % with the extended model, '
        f'{found["improvement_percent"]:.1f} % with what has no name beside it'
        for axis, found in gain_of_axes(_with_unnamed(diagnosis)).items()
        if axis in without
    ]


def _width(share: float) -> str:
    """Return how long the bar of a share is, in percent of its track."""
    return f'{100.0 * min(max(share, 0.0), 1.0):.1f}'


def _row(nominal: Variant, found: FoundCause) -> dict[str, Any]:
    return {
        'share': percent_text(found.share),
        'width': _width(found.share),
        'words': capital(in_words(nominal, found.cause, no_findings(found))),
        'summary': found.cause.effect.summary,
        'reading': reading(found.probability),
        'probability': probability_text(found.probability),
        'parameters': parameter_texts(nominal, found),
        'alternatives': [
            {'words': words, 'probability': probability_text(probability)}
            for words, probability in instead(nominal, found)
        ],
    }


def correction_row(item: StatedCorrection, titles: Mapping[str, str]) -> dict[str, str]:
    """Return a correction in words: what, nominal, found, interval or that the logs do not tell it."""
    own = item.correction
    factor, unit = with_prefix(max(abs(own.nominal), abs(own.found)), own.unit)
    shown = UserUnit(factor, unit)
    low, high = significant(shown.of(item.low)), significant(shown.of(item.high))
    interval = f'{low} to {high} {unit}'.rstrip()
    if item.on_bound:
        interval = f'{interval}; {AT_BOUND}'
    elif not item.told:
        interval = f'{NOT_TOLD}; usual are {interval}'
    return {
        'parameter': with_titles(own.parameter, titles),
        'nominal': shown.text(own.nominal, 4),
        'found': shown.text(own.found, 4),
        'interval': interval,
    }


def _validation_words(diagnosis: Diagnosis) -> str:
    """Return what is gained on each axis over all validation data, the largest gain first."""
    of_axes = gain_of_axes(diagnosis.gains)
    if not of_axes:
        return 'In the validation data no position is known for long enough to predict a motion.'
    how = (
        'closed loop' if diagnosis.gains[0].closed_loop else 'plant, driven by what the drive gave'
    )
    said = (
        'For this the causes were fitted to the estimation data alone; their values above are those of '
        f'all logs. Error is simulated less measured position ({how}); '
    )
    percent = {axis: item['improvement_percent'] for axis, item in of_axes.items()}
    if max(percent.values()) < HARDLY_PERCENT:
        return said + 'the extended model is not nearer to them than the nominal one.'
    titles = diagnosis.nominal.titles
    of_each = [
        f'{change_text(one)} {"smaller" if one >= 0.0 else "larger"} on {titles[axis]}'
        for axis, one in sorted(percent.items(), key=lambda item: -item[1])
    ]
    return said + f'the RMS error of the extended model is {", ".join(of_each)}.'
