# SPDX-License-Identifier: Apache-2.0
"""
What the twin must bear for long: starts in any order, a bad network, nodes killed at any tick.

  starts   the three nodes in real time, in any order, up to 2 s between them: do they run?
  losses   minutes with a controller that loses 1 % and delays 1 % of its commands: no stop, and are the
           counts right to the message?
  kills    a node of a recorded run is killed at any tick: a named error within 5 s, a readable
           recording, nothing left behind?

Everything is drawn from the seed and the number of the case. Each case is a line of --out, written as
soon as it is done; what is there for this seed is not done again.

  python tests/bench/bench_endurance.py --starts 200 --minutes 10 --kills 100 --seed 1
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from endurance.kills import one_kill
from endurance.losses import losses
from endurance.starts import one_start

Rows = list[dict[str, Any]]
WORST = {
    'starts': 'wall time behind the last start [s]',
    'losses': 'wall time [s]',
    'kills': 'error after [s]',
}
"""What the table gives the median and the worst of."""


def main() -> int:
    """Do what is left to do, print a table; return 1 if anything was not as it must be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--starts', type=int, default=200, help='default: 200')
    parser.add_argument('--minutes', type=float, default=10.0, help='of losses (10); 0: none')
    parser.add_argument('--kills', type=int, default=100, help='default: 100')
    parser.add_argument('--seed', type=int, default=1, help='default: 1')
    parser.add_argument('--out', type=Path, default=Path('bench-results/endurance.jsonl'))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)

    def lossy(rng: random.Random, folder: Path) -> dict[str, Any]:
        return losses(60.0 * options.minutes, rng.randrange(2**31), folder)

    cases: list[tuple[str, int, Callable[[random.Random, Path], dict[str, Any]]]] = [
        *(('losses', number, lossy) for number in range(options.minutes > 0.0)),
        *(('kills', number, one_kill) for number in range(options.kills)),
        *(('starts', number, one_start) for number in range(options.starts)),
    ]
    for part, number, do in cases:
        if any(_is(row, part, number, options.seed) for row in read(options.out)):
            continue
        rng = random.Random(f'{options.seed} {part} {number}')
        with tempfile.TemporaryDirectory(prefix='waferbot-endurance-') as folder:
            result = do(rng, Path(folder))
        row = {'part': part, 'number': number, 'seed': options.seed, **result}
        row |= {'commit': commit(), 'at': time.strftime('%Y-%m-%d %H:%M:%S')}
        with options.out.open('a', encoding='utf-8') as stream:
            stream.write(json.dumps(row) + '\n')
        print(f'{part} {number}: {"ok" if row["ok"] else json.dumps(row)}', flush=True)
    rows = [row for row in read(options.out) if row['seed'] == options.seed]
    show(rows)
    return 0 if all(row['ok'] for row in rows) else 1


def read(file: Path) -> Rows:
    """Return the lines that are there."""
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text('utf-8').splitlines()]


def _is(row: dict[str, Any], part: str, number: int, seed: int) -> bool:
    return (row['part'], row['number'], row['seed']) == (part, number, seed)


def commit() -> str:
    """Return the commit of the sources, with a plus if there are changes beside it."""
    told = subprocess.run(
        ['git', 'describe', '--always', '--dirty=+'],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
    )
    return told.stdout.strip()


def show(rows: Rows) -> None:
    """Print how many of each part were as they must be, and the times."""
    table = Table(title='Endurance')
    for heading in ('part', 'ok', 'of', 'time', 'median', 'worst'):
        table.add_column(heading, justify='left' if heading in ('part', 'time') else 'right')
    for part, key in WORST.items():
        times = sorted(row[key] for row in rows if row['part'] == part and key in row)
        ok = sum(row['ok'] for row in rows if row['part'] == part)
        if times:
            median, worst = times[len(times) // 2], times[-1]
            found = sum(row['part'] == part for row in rows)
            table.add_row(part, str(ok), str(found), key, f'{median:g}', f'{worst:g}')
    Console(markup=False, width=110).print(table)
    for row in rows:
        if row['part'] == 'losses':
            print(f'losses, done: {row["done"]}\n        told: {row["told"]}')


if __name__ == '__main__':
    sys.exit(main())
