# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis on the console: the sentence, causes, gains."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.cli.console import new_table, result_console
from waferbot_twin.diagnosis.diagnose import Diagnosis
from waferbot_twin.diagnosis.report import parameter_texts
from waferbot_twin.diagnosis.wording import (
    capital,
    percent_text,
    probability_text,
    sentence,
    title,
)
from waferbot_twin.plot import TITLES


def print_diagnosis(
    diagnosis: Diagnosis, others: Mapping[str, float] | None = None, heading: str = ''
) -> None:
    """Print sentence, causes and gains; beside the gains those of `others` by axis, in percent."""
    print(sentence(diagnosis))
    for note in diagnosis.notes:
        print(f'Note: {note}.')
    for heading_of_causes, found_causes in (
        ('cause', diagnosis.causes),
        ('possible, not named', diagnosis.possible),
    ):
        if not found_causes:
            continue
        print()
        causes = new_table(
            heading_of_causes, 'share of the error', 'probability', '', 'value', '95 %'
        )
        for found in found_causes:
            first = (
                capital(title(found.cause)),
                percent_text(found.share),
                probability_text(found.probability),
            )
            for row in parameter_texts(diagnosis.nominal, found):
                causes.add_row(*first, *row)
                first = ('', '', '')
        result_console.print(causes)
    print()
    headings = ['validation log, axis', 'RMS nominal', 'RMS extended', 'improvement [%]']
    gains = new_table(*headings, *([heading] if others else []))
    for gain in diagnosis.gains:
        gains.add_row(
            f'{gain.log}, {TITLES[gain.axis]}',
            f'{gain.rms_before:.4g} {gain.unit}',
            f'{gain.rms_after:.4g} {gain.unit}',
            f'{gain.improvement_percent:.2f}',
            *([f'{others[gain.axis]:.2f}'] if others else []),
        )
    result_console.print(gains)
