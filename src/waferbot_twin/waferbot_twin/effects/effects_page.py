# SPDX-License-Identifier: Apache-2.0
"""
The table of `docs/effects.md`, written from the library.

    python -m waferbot_twin.effects.effects_page docs/effects.md

renews what stands between `<!-- generated: effects -->` and `<!-- end -->`; the rest of the page is
prose. A test compares the page with the library, so that the two cannot drift apart.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import yaml

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import find_description
from waferbot_twin.effects import library
from waferbot_twin.effects.effect import Effect, Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model

MODELS = ('rigid', 'simplified')
"""Models that the axes and parameters of the table are of; the first that has the effect counts."""

EXAMPLE = 'two_mass_drive'
"""The example of a description for what none of these models can have; no current is measured there."""

_SECTION = re.compile(r'(<!-- generated: effects -->\n).*?(<!-- end -->)', re.DOTALL)


def renewed(page: str) -> str:
    """Return the page with its table made anew; raises `UserError` if it has no place for one."""
    if not _SECTION.search(page):
        raise UserError('the page has no <!-- generated: effects --> ... <!-- end -->')
    return _SECTION.sub(lambda match: f'{match[1]}{table()}\n{match[2]}', page)


def table() -> str:
    """Return the library as tables in Markdown, one for each block."""
    example = yaml.safe_load(whole_text(find_description(EXAMPLE)))
    variants = [Variant.of(load_model(name)) for name in MODELS]
    axes = frozenset(example['motors'])
    variants.append(
        Variant(EXAMPLE, example, 'improved', {}, {}, told_alone=axes, brought_in=axes)
    )
    blocks: dict[str, list[str]] = {}
    for effect in library().values():
        blocks.setdefault(effect.block.value, []).append(_row(effect, variants))
    head = '| effect | axes | parameters | equation |\n|---|---|---|---|\n'
    return '\n\n'.join(
        f'### {block.capitalize()}\n\n{head}' + '\n'.join(rows) for block, rows in blocks.items()
    )


def _row(effect: Effect, variants: list[Variant]) -> str:
    """Return the row of an effect."""
    found = {
        axis for variant in variants if variant.name != EXAMPLE for axis in effect.axes(variant)
    }
    axes = [axis for axis in AXES if axis in found] or [f'of `{EXAMPLE}`']
    variant = next(variant for variant in variants if effect.axes(variant))
    named: dict[str, list[Parameter]] = {}
    for axis in effect.axes(variant):
        for item in effect.parameters(variant, axis):
            named.setdefault(item.name, []).append(item)
    parameters = '<br>'.join(_parameter(items) for items in named.values())
    marks = {' (threshold)': effect.threshold, ' (usual)': effect.usual}
    mark = ''.join(text for text, holds in marks.items() if holds)
    return (
        f'| `{effect.name}`{mark}, {effect.title}: {effect.summary} | {", ".join(axes)} | '
        f'{parameters} | {_cell(effect.equation)} |'
    )


def _parameter(items: list[Parameter]) -> str:
    """Return name, units and meaning of a parameter on all axes."""
    units = ' or '.join(dict.fromkeys(item.unit for item in items))
    shape = ', shape' if items[0].shape else ''
    whole = ', whole steps' if items[0].resolution else ''
    return f'`{items[0].name}` ({units or "-"}{shape}{whole}): {_cell(items[0].meaning)}'


def _cell(text: str) -> str:
    """Return text that may stand in a table."""
    return text.replace('|', '\\|')


def main() -> int:
    """Renew the page named on the command line."""
    if len(sys.argv) != 2:
        print(
            'usage: python -m waferbot_twin.effects.effects_page docs/effects.md', file=sys.stderr
        )
        return 2
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text('utf-8')), 'utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
