# SPDX-License-Identifier: Apache-2.0
"""
The diagnosis in blind tests: is the hidden cause named, how small may it be, what is named wrongly?

Effects of the whole library, on every axis, at given sizes, in logs with motions and noise that are
drawn; nothing hidden; two and up to eight effects at once; machines of which everything is a little off;
effects that the diagnosis does not know; machines of another simulator, in files as a user has them; the
logs of `waferbot demo`. Every case is one line of bench-results/diagnosis.jsonl, written as soon as it
is done: what a commit has done there it does not do again, so the bench can be stopped and goes on where
it was. At the end tables of all lines of this seed by the last commit, the same as diagnosis.json and a
picture, diagnosis.png. Seeds from 5000 are for a final table: they are run once, by one commit.

The full matrix takes many hours on two cores. For a part of it:

  make bench-diagnosis OPTIONS='--only single-10 --effects backlash,cogging --minutes 20'
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

# Imported first: it decides where compiled code is kept.
import waferbot_lockstep.compiled  # noqa: F401  isort: skip

import joblib
from diagnosis_matrix import (
    demonstration,
    other_simulator,
    picture,
    requirements,
    summary,
    trial,
)
from diagnosis_matrix.cases import GROUPS, Case, cases, pairs
from diagnosis_matrix.differences import same_names

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import in_words
from waferbot_twin.cluster import cluster
from waferbot_twin.effects import find

FOLDER = Path('bench-results')
PACKAGE = Path(__file__).parent / 'diagnosis_matrix'


def main() -> int:
    """Run what is left to do, print and write what is known."""
    options = _options()
    try:
        _bench(options)
    except UserError as error:
        print(f'bench_diagnosis: error: {error}', file=sys.stderr)
        return 1
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--seed', type=int, default=1, help='what everything is drawn from')
    parser.add_argument(
        '--only', default='', metavar='GROUP,..', help=f'of {", ".join(GROUPS)} (default: all)'
    )
    parser.add_argument('--effects', default='', metavar='NAME,..', help='hide only these')
    parser.add_argument('--cases', type=int, help='so many of each group (default: full matrix)')
    parser.add_argument(
        '--minutes', type=float, help='start no new case after this time (0: tables only)'
    )
    parser.add_argument('--workers', type=int, default=os.cpu_count() or 1, help='processes')
    parser.add_argument(
        '--cluster', metavar='ADDRESS', help='send the cases to the Dask scheduler there'
    )
    parser.add_argument(
        '--subprocess', action='store_true',
        help='logs are files, and the diagnosis is the command (slower; a sample will do)',
    )  # fmt: skip
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument('--out', type=Path, default=FOLDER, metavar='DIR', help='for results')
    return parser.parse_args()


def _bench(options: argparse.Namespace) -> None:
    groups = _names(options.only) or list(GROUPS)
    effects = _names(options.effects)
    for name in groups:
        if name not in GROUPS:
            raise UserError(f'--only: there is no group {name!r} (groups: {", ".join(GROUPS)})')
    for name in effects:
        find(name)
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / 'diagnosis.jsonl'
    lines = read_lines(results)
    commit = _commit()
    done = {_key(line) for line in lines}
    wanted = list(_interleaved(groups, effects, options))
    left = [
        case
        for case in wanted
        if (
            case.key,
            trial.model_of(case, options.model),
            trial.through(case, options.subprocess),
            commit,
        )
        not in done
    ]
    if left and options.minutes != 0:
        _refuse_second_run(lines, options.seed, commit, results)
    print(f'{len(wanted)} cases, {len(left)} to do; results: {results}')
    begun_s = time.monotonic()
    with cluster(options.cluster, PACKAGE) as cores, results.open('a', encoding='utf-8') as file:
        for number, line in enumerate(_run_all(left, cores, options), 1):
            line['commit'] = commit
            file.write(json.dumps(line) + '\n')
            file.flush()
            lines.append(line)
            reported = ', '.join(item['name'] for item in line.get('reported', []))
            more = len(left) - number
            left_s = (time.monotonic() - begun_s) / number * more
            print(
                f'{number}/{len(left)}  {line["key"]}: {line["outcome"]}'
                f'{f" ({reported})" if reported else ""}, {line["case_s"]:.0f} s'
                f'{f"; about {in_words(left_s)} left for all" if more else ""}',
                flush=True,
            )
    of_seed = [
        line
        for line in lines
        if line['seed'] == options.seed
        and line['model'] in (options.model, other_simulator.MODEL, demonstration.MODEL)
    ]
    commit, own, refused = requirements.of_one_commit(of_seed)
    found = summary.summarise(own)
    rows = requirements.table_of(own, summary.is_named)
    summary.print_tables(found)
    same = same_names(trial.nominal(options.model))
    console = summary.plain_console()
    requirements.print_table(console, rows, commit, refused, options.seed, same)
    found['requirements'] = {
        'commit': commit,
        'seed': options.seed,
        'refused': refused,
        'rows': [dataclasses.asdict(row) for row in rows],
    }
    (options.out / 'diagnosis.json').write_text(json.dumps(found, indent=2) + '\n', 'utf-8')
    picture.draw(found, options.out / 'diagnosis.png')
    print(
        f'as JSON and picture: {options.out / "diagnosis.json"}, {options.out / "diagnosis.png"}'
    )


def _refuse_second_run(lines: list[dict[str, Any]], seed: int, commit: str, path: Path) -> None:
    """Raise `UserError` if a final seed has been run by other sources: it is run once."""
    others = {line.get('commit') or 'not known' for line in lines if line['seed'] == seed}
    others.discard(commit)
    if seed >= requirements.FINAL_SEED and others:
        raise UserError(
            f'{path} has cases of seed {seed} by {", ".join(sorted(others))}: a final seed is run once, '
            'by one commit. Take another seed, or --minutes 0 for the table'
        )


def _commit() -> str:
    """
    Return the commit that changed the sources last; nothing if git knows none.

    With `-dirty-` and a checksum of the changes if they differ from it. Sources are what results depend
    on: neither tests nor what counts the results, nor results that are committed.
    """
    counts = (
        f'tests/bench/diagnosis_matrix/{name}.py'
        for name in ('requirements', 'summary', 'picture')
    )
    others = (f':(top,exclude,glob){path}' for path in ('src/*/test/**', *counts))
    sources = ('--', ':/src', ':/tests/bench/diagnosis_matrix', *others)
    try:
        last = _git('log', '-1', '--format=%h', *sources)
        changed = _git('diff', 'HEAD', *sources)
    except (OSError, subprocess.SubprocessError):
        return ''
    return f'{last}-dirty-{zlib.crc32(changed.encode()):08x}' if changed else last


def _git(*arguments: str) -> str:
    found = subprocess.run(
        ['git', *arguments], cwd=PACKAGE, capture_output=True, text=True, check=True, timeout=60.0
    )
    return found.stdout.strip()


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return the results so far; a last line that was cut off is left out."""
    if not path.exists():
        return []
    text = path.read_text('utf-8')
    whole = text[: text.rfind('\n') + 1]
    if whole != text:
        path.write_text(whole, 'utf-8')
    return [json.loads(line) for line in whole.splitlines()]


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(',') if name.strip()]


def _key(line: dict[str, Any]) -> tuple[str, str, str, str]:
    return line['key'], line['model'], line['through'], line.get('commit', '')


def _interleaved(
    groups: Sequence[str], effects: Sequence[str], options: argparse.Namespace
) -> Iterator[Case]:
    """Return the cases of all groups in turn, so that a part of the matrix has some of each."""
    names = pairs(trial.nominal(options.model), effects)
    each = [
        itertools.islice(
            cases(GROUPS[name], names, options.seed), options.cases or GROUPS[name].cases
        )
        for name in groups
    ]
    for row in itertools.zip_longest(*each):
        yield from (case for case in row if case is not None)


def _run_all(
    left: Iterable[Case], cores: int | None, options: argparse.Namespace
) -> Iterator[dict[str, Any]]:
    """Run cases side by side, each in one process; give the results as they come."""
    begun_s = time.monotonic()
    longest_s = math.inf if options.minutes is None else 60.0 * options.minutes

    def in_time() -> Iterator[Any]:
        for case in left:
            if time.monotonic() - begun_s >= longest_s:
                return
            yield joblib.delayed(trial.run)(case, options.model, options.subprocess)

    workers = cores or options.workers
    pool = joblib.Parallel(
        n_jobs=workers, batch_size=1, pre_dispatch='n_jobs', return_as='generator_unordered'
    )
    yield from pool(in_time())


if __name__ == '__main__':
    sys.exit(main())
