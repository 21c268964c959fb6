# SPDX-License-Identifier: Apache-2.0
"""
What a Turbo PMAC answers to LIST GATHER: hexadecimal longs, as text.

Each long is 12 hexadecimal digits, 48 bits. Its two 24-bit words belong to the sources in their
order, **the last six digits first**; a source of 48 bits takes two words, the lower one first, which
is one long in natural order where it starts a long. An odd number of words leaves one dummy word
behind every sample. Words are in two's complement.

The first digit of a source (I5001 to I5048) says what it is: 0 and 4 a word of Y or X memory, 8 an
integer of 48 bits. Known registers of motor xx, at $80 * xx, are scaled:

    position and following error   raw / (32 Ixx08)                counts
    actual velocity ($1D)          raw / (32 Ixx09 (Ixx60 + 1))    counts per servo cycle
    servo output ($2E, $3F)        raw / 256                       DAC bits

All others are raw. Columns are named by their source, `$80008B`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.columns import Table
from waferbot_twin.logs.findings import Finding, rows_text
from waferbot_twin.logs.text import lines_of

_MOTOR_MEMORY = range(0x80, 0x1080)
_POSITIONS = (0x08, 0x0B, 0x0D, 0x10, 0x11)
_VELOCITY = 0x1D
_OUTPUTS = (0x2E, 0x3F)
_LONG = re.compile(r'^\$?[0-9A-Fa-f]{12}$')
_WORDS = {'0': 1, '4': 1, '8': 2}


def read_gather(path: Path, gather: Mapping[str, Any]) -> Table:
    """
    Read a gather file; `gather` is that key of a mapping (`sources`, `Ixx08`, ...).

    A word that is no number makes the sources in it missing for that sample. Raises `UserError` for
    a source of 48-bit floating point, which the gather should fetch as integer (first digit 8).
    """
    sources = [str(source).upper() for source in gather['sources']]
    for source in sources:
        if source[1] == 'C':
            raise UserError(
                f'{path}: source {source} is floating point of 48 bits, whose layout is not '
                'supported; gather it as integer (first digit 8), or let the gather program '
                'convert it'
            )
        if source[1] not in _WORDS:
            raise UserError(f'{path}: source {source}: the first digit must be 0, 4 or 8')
    lines, _ = lines_of(path)
    tokens = [(number, token) for number, line in enumerate(lines, 1) for token in line.split()]
    findings = []
    words: list[int | None] = []
    lines_of_words: list[int] = []
    for number, token in tokens:
        text = token.removeprefix('$')
        if _LONG.match(token):
            words += [int(text[6:], 16), int(text[:6], 16)]
        else:
            words += [None, None]
            findings.append(
                Finding(f'{path}, line {number}', f'{token[:20]!r} is no gathered long')
            )
        lines_of_words += [number, number]
    per_source = [_WORDS[source[1]] for source in sources]
    per_sample = sum(per_source) + sum(per_source) % 2
    samples = len(words) // per_sample
    if not samples:
        raise UserError(f'{path}: holds no whole sample of {per_sample // 2} longs')
    if len(words) % per_sample:
        place = f'{path}, line {lines_of_words[samples * per_sample]}'
        findings.append(Finding(place, 'the last sample is not whole'))
    values = np.full((samples, len(sources)), np.nan)
    for sample in range(samples):
        at = sample * per_sample
        for column, count in enumerate(per_source):
            value = _signed(words[at : at + count])
            if value is not None:
                values[sample, column] = value
            at += count
    for column, source in enumerate(sources):
        values[:, column] *= _scale(int(source[2:], 16), gather)
    first_line = np.array(lines_of_words[: samples * per_sample : per_sample], np.int64)
    if len(findings) > 3:
        reason = f'{len(findings)} longs are broken: sources in them are missing there'
        rows = np.flatnonzero(np.isnan(values).any(axis=1))
        if len(rows):
            findings = [
                Finding(rows_text(rows, lambda row: f'{path}, line {first_line[row]}'), reason)
            ]
    return Table(str(path), sources, values, 'line', first_line, np.arange(samples), findings)


def _signed(words: list[int | None]) -> int | None:
    """Return words, the lowest first, as one number in two's complement; None if one is missing."""
    value = 0
    for place, word in enumerate(words):
        if word is None:
            return None
        value |= word << (24 * place)
    bits = 24 * len(words)
    return value - (1 << bits) if value >> (bits - 1) else value


def _scale(address: int, gather: Mapping[str, Any]) -> float:
    """Return the factor of an address; 1 for what is no motor's register, or not known."""
    if address not in _MOTOR_MEMORY:
        return 1.0
    register = address & 0x7F
    if register in _POSITIONS:
        return 1.0 / (32.0 * gather.get('Ixx08', 96))
    if register == _VELOCITY:
        return 1.0 / (32.0 * gather.get('Ixx09', 96) * (gather.get('Ixx60', 0) + 1))
    return 1.0 / 256.0 if register in _OUTPUTS else 1.0
