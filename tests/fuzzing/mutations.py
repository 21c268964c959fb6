# SPDX-License-Identifier: Apache-2.0
"""
Ways in which files come damaged: cut off, bits flipped, parts doubled, lost or exchanged, values that
nobody thought of. Everything is drawn from a seeded generator, so a case can be repeated.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from random import Random
from typing import Any

STRANGE_TEXTS = (
    '', ' ', 'nan', '.nan', 'inf', '-.inf', '-1', '0', '1e400', '-1e308', '1e-320', '9' * 400, '1_000',
    '0x1F', '1e999999999', 'null', '~', 'true', 'no', '[]', '{}', '[[[[[[]]]]]]', '{a: {b: []}}', '""',
    "'", '"', '$', '$part', '%s', '{0}', '\\', 'ä€𝄞', '\x00', '\x1b[31m', '\ufeff', '\u2028',
    '2000-01-01', '2000-99-99', '1700000000.123456789', '12:30:45', '!!binary aGk=', '!!python/none',
    '*alias', '&a b', '? [a]', '1: 2', '- x', '|', '>', '#', ': ', '...', '---', '<<', 'a' * 5000,
    'x.y.z', '../..', '/', '/etc', '.', 'y_linear', 'x_rotate', 'position', 'constant',
    '18446744073709551616', '1.7e18', '1700000000000000000', '-1700000000',
)  # fmt: skip
"""In the place of a word of a text."""

STRANGE_VALUES = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, 1e308, -1e308, 5e-324, 0.5,
    float('nan'), float('inf'), '', 'x', 'ä€𝄞', '\x00', '\ud800', '1', 'nan', 'a' * 5000, [], {}, [[]],
    [None], {'': None}, {'a': {'b': {'c': []}}}, [1, 2, 3], '/', '../x', 'rigid', 'y_linear',
)  # fmt: skip
"""In the place of a value in JSON."""

_WORD = re.compile(r'[^\s:,\[\]{}#;]+')

Mutation = Callable[[bytes, Random], bytes]


def damaged(data: bytes, random: Random) -> bytes:
    """Return bytes with one to four kinds of damage that any file may have."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        data = random.choice(_BYTE_DAMAGE)(data, random)
    return data


def misspelt(data: bytes, random: Random) -> bytes:
    """Return a text with words exchanged, lines lost, doubled or shifted; now and then damaged bytes."""
    if random.random() < 0.2:
        return damaged(data, random)
    text = data.decode('utf-8', 'replace')
    for _ in range(random.choice((1, 1, 2, 3))):
        text = random.choice(_TEXT_DAMAGE)(text, random)
    return text.encode('utf-8', 'surrogatepass')


def exchanged(data: bytes, random: Random) -> bytes:
    """Return JSON in which one to three values are others, or not there; now and then damaged bytes."""
    if random.random() < 0.15:
        return damaged(data, random)
    value = json.loads(data)
    for _ in range(random.choice((1, 1, 2, 3))):
        value = _exchanged(value, random)
    return json.dumps(value).encode()


def _exchanged(value: Any, random: Random) -> Any:
    """Return a value with something in it exchanged: the deeper, the more often."""
    if isinstance(value, dict) and value and random.random() < 0.9:
        key = random.choice(list(value))
        others = {name: item for name, item in value.items() if name != key}
        what = random.random()
        if what < 0.1:
            return others
        if what < 0.15:
            return {**others, random.choice(('', 'x', key.upper(), key + 's')): value[key]}
        return {**value, key: _exchanged(value[key], random)}
    if isinstance(value, list) and value and random.random() < 0.9:
        place = random.randrange(len(value))
        what = random.random()
        if what < 0.1:
            return value[:place] + value[place + 1 :]
        if what < 0.15:
            return value + [value[place]]
        return [*value[:place], _exchanged(value[place], random), *value[place + 1 :]]
    return random.choice(STRANGE_VALUES)


# ---- bytes ---------------------------------------------------------------------------------------


def _cut(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 3, 20))):
        if changed:
            changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, random: Random) -> bytes:
    at = random.randrange(len(data) + 1)
    width = random.choice((1, 2, 4, 8, 16))
    new = random.choice((b'\xff' * width, b'\0' * width, random.randbytes(width), b'\x7f' * width))
    return data[:at] + new + data[at + width :]


def _lose(data: bytes, random: Random) -> bytes:
    begin, end = sorted(random.randrange(len(data) + 1) for _ in range(2))
    return data[:begin] + data[min(end, begin + 4096) :]


def _double(data: bytes, random: Random) -> bytes:
    begin, end = sorted(random.randrange(len(data) + 1) for _ in range(2))
    return data[:end] + data[begin:end][:4096] + data[end:]


def _nothing(data: bytes, random: Random) -> bytes:
    return random.choice((b'', b'\0' * 512, random.randbytes(300)))


_BYTE_DAMAGE: tuple[Mutation, ...] = (
    _cut, _flip, _flip, _overwrite, _overwrite, _overwrite, _lose, _double, _nothing,
)  # fmt: skip


# ---- texts ---------------------------------------------------------------------------------------


def _word(text: str, random: Random) -> str:
    words = list(_WORD.finditer(text))
    if not words:
        return random.choice(STRANGE_TEXTS)
    word = random.choice(words)
    other = random.choice((random.choice(STRANGE_TEXTS), random.choice(words).group()))
    return text[: word.start()] + other + text[word.end() :]


def _letter(text: str, random: Random) -> str:
    at = random.randrange(len(text) + 1)
    return text[:at] + random.choice(('', ' ', ':', ',', '[', '}', 'q', '0', '-')) + text[at + 1 :]


def _lines(text: str, random: Random) -> str:
    lines = text.split('\n')
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    what = random.randrange(5)
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(other, lines[at])
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif what == 3:
        lines[at] = '  ' + lines[at]
    else:
        lines[at] = lines[at] * random.choice((2, 50))
    return '\n'.join(lines)


_TEXT_DAMAGE: tuple[Callable[[str, Random], str], ...] = (_word, _word, _word, _letter, _lines)
