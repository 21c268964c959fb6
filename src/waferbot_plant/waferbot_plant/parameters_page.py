# SPDX-License-Identifier: Apache-2.0
"""
The tables of `docs/parameters.md`, written from the shipped description.

    python -m waferbot_plant.parameters_page docs/parameters.md

renews what stands between `<!-- generated: NAME -->` and `<!-- end -->`; the rest of the page is
prose. A test compares the page with the description, so that the two cannot drift apart.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

from waferbot_lockstep.errors import UserError
from waferbot_plant import modes
from waferbot_plant.description import DAMPING
from waferbot_plant.plant import config_folder, load_machine

UNITS = {
    'counts_per_m': 'counts/m', 'counts_per_revolution': 'counts/turn',
    'n_s_m': 'N s/m', 'nm_s_rad': 'Nm s/rad', 'n_m': 'N/m', 'nm_rad': 'Nm/rad',
    'v_s_m': 'V s/m', 'v_s_rad': 'V s/rad',
    'nm_per_arcmin': 'Nm/arcmin', 'n_per_m': 'N/m', 'rad_per_s': 'rad/s', 'per_block_n': 'N',
    's2_per_m': 's²/m', 's2_per_rad': 's²/rad', 's_per_m': 's/m', 's_per_rad': 's/rad',
    'per_m_s': '1/(m s)', 'per_rad_s': '1/(rad s)', 'per_m': '1/m', 'per_rad': '1/rad',
    '1_s2': '1/s²', '1_s': '1/s', 'ms': 'ms',
    'kg_m2': 'kg m²', 'm_s2': 'm/s²', 'k_w': 'K/W', 'j_k': 'J/K', '1_k': '1/K', 'degc': '°C',
    'm_s': 'm/s', 'rad_s': 'rad/s', 'hz': 'Hz', 'a': 'A', 's': 's', 'counts': 'counts',
    'rpm': 'rpm', 'ohm': 'ohm', 'kg': 'kg', 'pa': 'Pa', 'nm': 'Nm', 'rad': 'rad', 'm': 'm', 'n': 'N',
    'h': 'H', 'um': 'µm', 'urad': 'µrad',
}  # fmt: skip
"""Unit by the ending of a key; longer endings first."""

_SECTION = re.compile(r'(<!-- generated: (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)
_LONGEST_LIST = 3


def unit_of(key: str) -> str:
    """Return the unit that the ending of a key tells, nothing where it tells none."""
    endings = (unit for ending, unit in UNITS.items() if re.search(rf'(^|_){ending}$', key))
    return next(endings, '')


def renewed(page: str) -> str:
    """Return the page with its generated tables made anew; raises `UserError` for an unknown one."""

    def table(match: re.Match[str]) -> str:
        if match[2] not in TABLES:
            raise UserError(f'no table {match[2]!r}; there are {", ".join(TABLES)}')
        return f'{match[1]}{TABLES[match[2]]()}\n{match[3]}'

    return _SECTION.sub(table, page)


def first_frequencies() -> str:
    """Return Table 6.7 beside ours, with the inertia that counts, k / (2 pi f)^2."""
    description = load_machine('machine').description
    rows = [
        '| connection | thesis, Hz | ours, Hz | difference, % | stiffness | inertia that counts |'
    ]
    rows.append('|---|---|---|---|---|---|')
    for row in modes.table_of_first_frequencies(description):
        springs, inertia = [], ''
        for name in row.connections:
            part = description.connections[name]
            springs.append(f'{part.stiffness:.4g} {"Nm/rad" if part.rotary else "N/m"}')
            counts = part.stiffness / (2.0 * math.pi * row.frequency_hz) ** 2
            inertia = f'{counts:.4g} {"kg m²" if part.rotary else "kg"}'
        if len(springs) > 1:
            inertia = 'see text'
        thesis, difference = row.thesis_hz or math.nan, row.difference_percent or 0.0
        rows.append(
            f'| {" + ".join(row.connections)} | {thesis:.2f} | {row.frequency_hz:.2f} | '
            f'{difference:+.3f} | {", ".join(springs)} | {inertia} |'
        )
    return '\n'.join(rows)


def values() -> str:
    """Return every quantity of the description that has a provenance."""
    data = yaml.safe_load((config_folder() / 'machine.yaml').read_text('utf-8'))
    rows = ['| key | value | unit | provenance and range of real parts |', '|---|---|---|---|']
    for key, quantity in _quantities(data, ()):
        if 'value' in quantity:
            text = _text(quantity['value'])
        else:
            text = ', '.join(f'{name} {_text(quantity[name])}' for name in DAMPING)
        rows.append(f'| `{".".join(key)}` | {text} | {unit_of(key[-1])} | {quantity["from"]} |')
    return '\n'.join(rows)


def frictions() -> str:
    """Return the friction on every coordinate, with both sets of damping."""
    rows = [
        '| friction | on | dry, calculated | dry, improved | viscous |',
        '|---|---|---|---|---|',
    ]
    calculated, improved = (
        load_machine('machine', damping=damping).description for damping in DAMPING
    )
    for name, friction in calculated.frictions.items():
        rotary = calculated.revolute[friction.coordinate]
        force, damping = ('Nm', 'Nm s/rad') if rotary else ('N', 'N s/m')
        damper = calculated.dampers.get(name)
        viscous = f'{damper.damping:.3g} {damping}' if damper else ''
        rows.append(
            f'| {name} | {friction.coordinate} | {friction.resistances[0]:.3g} {force} | '
            f'{improved.frictions[name].resistances[0]:.3g} {force} | {viscous} |'
        )
    return '\n'.join(rows)


TABLES: dict[str, Callable[[], str]] = {
    'first_frequencies': first_frequencies,
    'values': values,
    'frictions': frictions,
}


def _quantities(data: Any, key: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], dict]]:
    if not isinstance(data, dict):
        return
    if 'from' in data:
        yield key, data
        return
    for name, value in data.items():
        yield from _quantities(value, (*key, str(name)))


def _text(value: Any) -> str:
    """Return a value for a cell; a long list by its length and ends."""
    if isinstance(value, dict):
        return ', '.join(f'{name} {_text(item)}' for name, item in value.items())
    if isinstance(value, list):
        if len(value) > _LONGEST_LIST:
            return f'{len(value)} points, {_text(value[0])} to {_text(value[-1])}'
        return '[' + ', '.join(_text(item) for item in value) + ']'
    return f'{value:g}' if isinstance(value, float) else str(value)


def main(arguments: list[str]) -> int:
    """Renew the page named on the command line."""
    if len(arguments) != 1:
        print(
            'usage: python -m waferbot_plant.parameters_page docs/parameters.md', file=sys.stderr
        )
        return 2
    path = Path(arguments[0])
    path.write_text(renewed(path.read_text('utf-8')), 'utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
