# SPDX-License-Identifier: Apache-2.0
"""The result of a diagnosis on the console: causes, gains, the sentence."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.cli.console import new_table, result_console, significant
from waferbot_twin.diagnosis.diagnose import Diagnosis
from waferbot_twin.diagnosis.report import sentence, uncertainty


def print_diagnosis(
    diagnosis: Diagnosis, others: Mapping[str, float] | None = None, heading: str = ''
) -> None:
    """Print causes, gains and the sentence; beside the gains those of `others` by axis, in percent."""
    if diagnosis.causes:
        causes = new_table(
            'what the model lacks', 'axis', 'value', '95 %', 'probability', 'share of the error'
        )
        for found in diagnosis.causes:
            for item in found.parameters:
                causes.add_row(
                    found.cause.effect.name,
                    found.cause.axis,
                    f'{item.name} {significant(found.cause.values[item.name])} {item.unit}',
                    uncertainty(found, item),
                    f'{found.probability:.2f}',
                    f'{100.0 * found.share:.0f} %',
                )
        result_console.print(causes)
    headings = ['log, axis', 'RMS nominal', 'RMS extended', 'improvement [%]']
    gains = new_table(*headings, *([heading] if others else []))
    for gain in diagnosis.gains:
        gains.add_row(
            f'{gain.log}, {gain.axis}',
            f'{gain.rms_before:.4g} {gain.unit}',
            f'{gain.rms_after:.4g} {gain.unit}',
            f'{gain.improvement_percent:.2f}',
            *([f'{others[gain.axis]:.2f}'] if others else []),
        )
    result_console.print(gains)
    print(sentence(diagnosis))
    for note in diagnosis.notes:
        print(f'Note: {note}.')
