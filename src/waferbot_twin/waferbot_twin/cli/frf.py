# SPDX-License-Identifier: Apache-2.0
"""
Frequency response of an axis from logs, measured beside simulated, and the peaks that differ.

The logs are of a swept sine, a multisine or random positions; several are taken together. With the
commanded position in them the estimate is free of the loop's noise; the model is commanded the same and
its log goes through the same estimator. DIR gets frf.png and frf.json.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import known_name
from waferbot_twin.cli.console import new_table, print_json, result_console
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

if TYPE_CHECKING:
    from waferbot_twin.frequency_response.compare import Comparison

FILES = ('frf.png', 'frf.json')
RESPONSES = ('plant', 'loop', 'drive')

EXAMPLES = (
    'waferbot run --experiment multisine_x_rotate --engine inprocess --out runs/multisine',
    'waferbot frf runs/multisine --model flexible --out frf',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot frf`."""
    parser.add_argument(
        'logs', nargs='+', type=Path, metavar='LOG', help='recordings or other logs'
    )
    parser.add_argument(
        '--model', default='rigid', metavar='NAME|FILE',
        help='a model, or the description of a machine alone (default: rigid)',
    )  # fmt: skip
    parser.add_argument(
        '--axis', metavar='AXIS', help='default: the one that is commanded to move'
    )
    parser.add_argument(
        '--response', choices=RESPONSES, default='plant',
        help='plant: force to acceleration (default); loop: commanded position to position; '
        'drive: current command to current',
    )  # fmt: skip
    parser.add_argument(
        '--from', dest='source', metavar='SIGNAL', help='another input: KIND or AXIS.KIND'
    )
    parser.add_argument('--to', dest='target', metavar='SIGNAL', help='another output')
    parser.add_argument(
        '--resolution', type=float, metavar='HZ',
        help='average over this width (default: periods of a periodic command, else by length)',
    )  # fmt: skip
    parser.add_argument('--highest', type=float, metavar='HZ', help='default: 500 Hz')
    parser.add_argument(
        '--direct', action='store_true', help='leave the commanded position out of the estimate'
    )
    parser.add_argument(
        '--map', dest='mapping', metavar='FILE', help='mapping of logs that are text'
    )
    parser.add_argument(
        '--out', type=Path, metavar='DIR', help='a new folder for picture and JSON'
    )
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Estimate, compare, draw and tell."""
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.frequency_response import channels
    from waferbot_twin.frequency_response.compare import compare, read_log
    from waferbot_twin.frequency_response.report import as_dict, draw
    from waferbot_twin.models import load_model_or_machine
    from waferbot_twin.recording.writer import as_json

    for option in ('resolution', 'highest'):
        value = getattr(options, option)
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise UserError(f'--{option} is {value:g} Hz; it must be above 0')
    output = None if options.out is None else OutputFolder(options.out, options.force)
    variant = Variant.of(load_model_or_machine(options.model))
    logs = [read_log(path, options.mapping, options.model, variant) for path in options.logs]
    axes = variant.layout.axes
    axis = known_name(options.axis, axes, '--axis') if options.axis else channels.moving_axis(logs)
    source, target = channels.RESPONSES[options.response]
    chosen = (
        channels.parse_channel(options.source or source, axis, axes),
        channels.parse_channel(options.target or target, axis, axes),
    )
    comparison = compare(
        logs, chosen, variant, options.resolution, options.highest, options.direct
    )

    def write(folder: Path) -> None:
        draw(comparison, folder / FILES[0])
        (folder / FILES[1]).write_text(as_json(as_dict(comparison)) + '\n', 'utf-8')

    kept = keep(output, write)
    if options.json:
        print_json(as_dict(comparison))
    else:
        _print(comparison)
    return kept.tell(f'drew {{0}}/{FILES[0]}; all numbers are in {{0}}/{FILES[1]}')


def _print(comparison: Comparison) -> None:
    """Print how it was estimated, the peaks, and the sentence."""
    from waferbot_twin.frequency_response.report import how, sentence

    console = result_console
    source, target = comparison.channels
    console.print(f'{source.name} to {target.name} [{comparison.unit}]')
    console.print(f'estimate: {how(comparison.measured)}\n', soft_wrap=True)
    table = new_table(
        'peak', 'measured\n[Hz]', 'model\n[Hz]', 'shift\n[%]', 'damping\nmeasured [%]',
        'damping\nmodel [%]', 'stands out\n[dB]', 'coherence', '',
    )  # fmt: skip
    table.columns[-1].justify = 'left'
    for pair in comparison.pairs:
        peak = pair.measured or pair.model
        assert peak is not None
        sides = (pair.measured, pair.model)
        table.add_row(
            pair.kind,
            *(significant(side.frequency_hz if side else None) for side in sides),
            '-' if pair.shift_percent is None else f'{pair.shift_percent:+.2f}',
            *(
                ('≤ ' if side and side.bounded else '')
                + significant(100.0 * side.damping if side else None, 2)
                for side in sides
            ),
            f'{peak.prominence_db:.1f}',
            f'{peak.coherence:.3f}',
            pair.verdict,
        )
    if comparison.pairs:
        console.print(table, '')
    else:
        console.print('no peaks stand out\n')
    console.print(sentence(comparison), soft_wrap=True)
    for note in comparison.notes:
        console.print(f'note: {note}', soft_wrap=True)
