# SPDX-License-Identifier: Apache-2.0
"""
Feed damaged input of every kind that comes from outside, and count tracebacks; there should be none.

  python tests/bench/bench_fuzz.py [CATEGORY...] [--count N] [--seed N]

A case is repeated by its category, seed and number.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import waferbot_twin  # noqa: F401  isort: skip  linear algebra on one thread

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzzing.categories import CATEGORIES, tracebacks


def main() -> int:
    """Feed all, print as it goes; return 1 if there was a traceback."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('categories', nargs='*', choices=[[], *CATEGORIES], metavar='CATEGORY')
    parser.add_argument('--count', type=int, default=5000, help='of each category (5000)')
    parser.add_argument('--seed', type=int, default=1, help='default: 1')
    options = parser.parse_args()
    total = 0
    for name in options.categories or CATEGORIES:
        begun_s = time.perf_counter()
        found = 0
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / 'fuzz'
            place.mkdir()
            for text in tracebacks(CATEGORIES[name], options.count, options.seed, place):
                found += 1
                print(f'{name}, seed {options.seed}, {text}', flush=True)
        total += found
        took_s = time.perf_counter() - begun_s
        print(f'{name}: {found} tracebacks in {options.count} inputs, {took_s:.1f} s', flush=True)
    print(f'{total} tracebacks, seed {options.seed}')
    return 1 if total else 0


if __name__ == '__main__':
    sys.exit(main())
