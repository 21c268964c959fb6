# SPDX-License-Identifier: Apache-2.0
"""
Logs as JSON: a line for each sample (JSON lines, `.jsonl`, `.ndjson`), or one list of samples (`.json`).

A column is the way to a number in the object of a sample: `position`, `axis0.encoder.pos`, `phases[0]`.
What is missing, or null, in a sample is NaN there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.columns import Table
from waferbot_twin.logs.findings import Finding, rows_text
from waferbot_twin.logs.text import lines_of

DEEPEST = 20
"""Levels that an object may have."""


def read_json(path: Path, encoding: str | None = None) -> Table:
    """Read a log of JSON; lines that are none are left out and reported. Raises `UserError`."""
    lines, _ = lines_of(path, encoding)
    file = str(path)
    samples, numbers, broken = [], [], []
    if path.suffix == '.json' and lines[0].lstrip().startswith('['):
        try:
            listed = json.loads('\n'.join(lines))
        except (ValueError, RecursionError) as error:
            raise UserError(f'{file}: is no JSON: {error}') from None
        samples = [dict(_leaves(item, file)) for item in listed]
        numbers = list(range(1, len(samples) + 1))
    for number, line in enumerate(lines if not samples else (), start=1):
        if not line.strip():
            continue
        try:
            samples.append(dict(_leaves(json.loads(line), file)))
            numbers.append(number)
        except (ValueError, RecursionError):
            broken.append(number)
    samples_there = [sample for sample in samples if sample]
    if not samples_there:
        raise UserError(f'{file}: holds no line with a JSON object')
    names = list(dict.fromkeys(name for sample in samples for name in sample))
    values = np.full((len(samples), len(names)), np.nan)
    texts: dict[int, list[str]] = {}
    for place, name in enumerate(names):
        cells = [sample.get(name) for sample in samples]
        values[:, place] = [
            float(cell) if isinstance(cell, (int, float)) else np.nan for cell in cells
        ]
        texts[place] = ['' if cell is None else str(cell) for cell in cells]
    findings = []
    if broken:
        where = rows_text(np.array(broken), lambda line: f'{file}, line {line}')
        findings.append(Finding(where, 'no JSON (cut off, or another part of the file)'))
    sample = np.arange(len(samples))
    return Table(file, names, values, 'line', np.array(numbers, np.int64), sample, findings, texts)


def _leaves(value: Any, file: str, name: str = '', depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Give the ways to all numbers and texts of a sample, and these."""
    if depth > DEEPEST:
        raise UserError(f'{file}: {name[:60]} is more than {DEEPEST} levels deep')
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, file, f'{name}.{key}' if name else str(key), depth + 1)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from _leaves(inner, file, f'{name}[{place}]', depth + 1)
    elif name:
        yield name, _number_or_text(value)


def _number_or_text(value: Any) -> Any:
    """Return a value; a whole number that no float holds becomes infinite, as in JSON's 1e999."""
    if isinstance(value, int):
        try:
            return float(value) if abs(value) > 2**53 else value
        except OverflowError:
            return float('inf')
    return value
