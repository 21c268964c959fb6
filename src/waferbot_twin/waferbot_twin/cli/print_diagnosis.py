# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis on the console: sentence, causes, corrections, what is left, gains."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.cli.console import new_table, result_console
from waferbot_twin.diagnosis.corrections import stated, stated_accelerations
from waferbot_twin.diagnosis.diagnose import Diagnosis, FoundCause
from waferbot_twin.diagnosis.parameters import ParameterText, parameter_texts
from waferbot_twin.diagnosis.report import correction_row, gain_with_unnamed, unexplained_rows
from waferbot_twin.diagnosis.wording import (
    capital,
    instead,
    percent_text,
    probability_text,
    reading,
    sentence,
    title,
)
from waferbot_twin.plain_values import with_prefix
from waferbot_twin.titles import with_titles


def print_diagnosis(
    diagnosis: Diagnosis, others: Mapping[str, float] | None = None, heading: str = ''
) -> None:
    """Print what the page says; beside the gains those of `others` by axis, in percent."""
    titles = diagnosis.nominal.titles
    print(sentence(diagnosis))
    _print_causes(diagnosis, 'cause', diagnosis.causes)
    _print_causes(diagnosis, 'possible, not named', diagnosis.possible)
    told = [item for item in stated(diagnosis) if item.told]
    told += stated_accelerations(diagnosis)
    corrections = [correction_row(item, titles) for item in told]
    if corrections:
        _print_table(['small correction', 'nominal', 'found', '95 %'], corrections)
    left = [
        {key: value for key, value in row.items() if key != 'width'}
        for row in unexplained_rows(diagnosis)
    ]
    if left:
        headings = ['unexplained', 'share of the error', 'band', 'where', 'goes with']
        _print_table(headings, left)
    _print_gains(diagnosis, others, heading)
    for line in gain_with_unnamed(diagnosis):
        print(line)
    for note in diagnosis.notes:
        print(f'Note: {with_titles(note, titles)}.')


def _print_causes(diagnosis: Diagnosis, heading: str, causes: list[FoundCause]) -> None:
    if not causes:
        return
    print()
    table = new_table(
        heading, 'share', 'how sure', '', 'value', '95 %', text=('how sure', '', '95 %')
    )
    for found in causes:
        first = (
            capital(title(diagnosis.nominal, found.cause)),
            percent_text(found.share),
            f'{reading(found.probability)}, {probability_text(found.probability)}',
        )
        for row in parameter_texts(diagnosis.nominal, found):
            table.add_row(*first, *_cells(row))
            first = ('', '', '')
    result_console.print(table)
    for found in causes:
        others = '; '.join(
            f'{words} ({probability_text(probability)})'
            for words, probability in instead(diagnosis.nominal, found)
        )
        if others:
            print(f'{capital(title(diagnosis.nominal, found.cause))} may be instead: {others}.')


def _cells(row: ParameterText) -> tuple[str, str, str]:
    return row.label, row.value, row.remark or row.interval


def _print_table(headings: list[str], rows: list[dict[str, str]]) -> None:
    print()
    table = new_table(*headings, text=headings)
    for row in rows:
        table.add_row(*row.values())
    result_console.print(table)


def _print_gains(diagnosis: Diagnosis, others: Mapping[str, float] | None, heading: str) -> None:
    if not diagnosis.gains:
        return
    print()
    headings = ['validation log, axis', 'RMS nominal', 'RMS extended', 'improvement [%]']
    table = new_table(*headings, *([heading] if others else []))
    for gain in diagnosis.gains:
        factor, unit = with_prefix(max(gain.rms_before, gain.rms_after), gain.unit)
        table.add_row(
            f'{gain.log}, {diagnosis.nominal.titles[gain.axis]}',
            f'{factor * gain.rms_before:.4g} {unit}',
            f'{factor * gain.rms_after:.4g} {unit}',
            f'{gain.improvement_percent:.2f}',
            *([f'{others[gain.axis]:.2f}'] if others else []),
        )
    result_console.print(table)
