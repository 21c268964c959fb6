# SPDX-License-Identifier: Apache-2.0
"""
Cases of a second simulator, through the commands as a user: import, diagnose, read the report.

Machines, logs and truth are those of `tests/independent_machine`, which shares no code with waferbot. A
hidden effect is *named* if a reported cause has a name that is right for it, *in the set* if one of
those is in the credible set of a reported cause, *noted* if it stands in the table of small
corrections: a delay within a sample, or a mass or motor constant, or the acceleration per ampere that
both change, of which the logs tell that it is another one, with the true value in its interval; else
*missed*. A reported cause is *false* if neither
its name nor one of its set is right for anything that is hidden, nor related to it.
"""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

from independent_machine.answers import TIME, Answers, answers
from independent_machine.cases import Case, draw
from independent_machine.files import ESTIMATION, MACHINE, MAP, VALIDATION, write_case

from diagnosis_matrix.scoring import others_of

MODEL = 'of its own'
"""What stands in place of a model's name in a line of results: every case has another machine."""

PATIENCE_S = 900
"""Time of a processor that a command may take, s: what else the machine does is not its fault."""

SCALES = {'mass', 'motor_constant'}
"""Hidden effects that change what all forces are measured by."""


@dataclass(frozen=True)
class Named:
    """
    A cause as a report has it: name, probability, the rest of its credible set, parameters.

    A parameter is (value, low, high), the ends of its 95 % interval None where there is none. A small
    correction has its path for a name.
    """

    name: str
    probability: float
    alike: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float | None, float | None]]
    correction: bool = False

    @property
    def names(self) -> frozenset[str]:
        """The name and all of the set."""
        return frozenset((self.name, *self.alike))


@dataclass(frozen=True)
class Findings:
    """All of a report that is scored."""

    verdict: str
    causes: tuple[Named, ...]
    runtime_s: float


def read_findings(report: Mapping[str, Any]) -> Findings:
    """Return what a `report.json` says: the only place that knows how it is written."""
    causes = [
        Named(
            cause['effect'],
            float(cause['probability']),
            tuple(name.partition(':')[0] for name in others_of(cause)),
            {
                name: (item['value'], item['low95'], item['high95'])
                for name, item in cause['parameters'].items()
            },
        )
        for cause in report['causes']
    ]
    for item in (*report['accelerations'], *report['corrections']):
        low, high = item['low'], item['high']
        if item['path'].startswith('logs.') and low * high > 0.0:
            causes.append(Named(TIME, 1.0, (), {'late_s': (item['found'], low, high)}, True))
        elif not low <= item['nominal'] <= high:
            value = {'value': (item['found'], low, high)}
            causes.append(Named(item['path'], 1.0, (), value, True))
    return Findings(report['verdict'], tuple(causes), float(report['runtime_s']))


def answers_of(case: Case) -> dict[str, Answers]:
    """Return the answers to every hidden effect of a case."""
    return {
        effect.kind: answers(
            case.setup.machine, effect.kind, effect.values, case.truth, case.setup.drive_late_s
        )
        for effect in case.hidden
    }


def score(expected: Mapping[str, Answers], findings: Findings) -> dict[str, Any]:
    """
    Return what became of every hidden effect, the false names, the intervals, and the outcome.

    Outcomes: of nothing hidden `right`, `false alarm`, `unexplained`; else `all`, `some`, `none`, with
    ` and a false one` where another cause is named too. A correction is never a false name.
    """
    became, errors = {}, []
    scale_named = all(
        any(cause.name in expected[kind].names for cause in findings.causes)
        for kind in SCALES & expected.keys()
    )
    time_told = any(cause.name == TIME for cause in findings.causes)
    for kind, answer in expected.items():
        became[kind], cause = _found(answer, findings.causes)
        own = [] if cause is None else _errors(answer, cause, time_told)
        if scale_named:
            errors += [{'kind': kind, **error} for error in own]
        if kind in SCALES and became[kind] == 'noted' and not own[0]['covered']:
            became[kind] = 'missed'
    right = frozenset().union(*(answer.names for answer in expected.values()))
    related = frozenset().union(*(answer.related for answer in expected.values()))
    causes = [cause for cause in findings.causes if not cause.correction]
    false = [cause for cause in causes if not cause.names & right and cause.name not in related]
    return {
        'outcome': _outcome(became, false, findings.verdict),
        'became': became,
        'false': [{'name': cause.name, 'probability': cause.probability} for cause in false],
        'names': [
            {
                'name': cause.name,
                'probability': cause.probability,
                'true': cause.name in right,
                'in_set': bool(cause.names & right),
                'related': cause.name in related,
            }
            for cause in causes
        ],
        'other_errors': errors,
    }


def _found(answer: Answers, causes: Sequence[Named]) -> tuple[str, Named | None]:
    for cause in causes:
        if cause.name in answer.names:
            return ('noted' if cause.correction else 'named'), cause
    if any(cause.names & answer.names for cause in causes):
        return 'in the set', None
    return 'missed', None


def _errors(answer: Answers, cause: Named, time_told: bool) -> list[dict[str, Any]]:
    """
    Return the parameters of a cause that was named right: expected, found, whether covered.

    `time_told` says whether the report tells the drive's time as well.
    """
    expected = next(item for item in answer.right if item.effect == cause.name)
    found = []
    for name, truth in (
        {**expected.values, **(expected.beside_time if time_told else {})}
    ).items():
        if name not in cause.parameters:
            continue
        value, low, high = cause.parameters[name]
        known = low is not None and high is not None
        found.append(
            {
                'effect': cause.name,
                'name': name,
                'truth': truth,
                'found': value,
                'covered': bool(low <= truth <= high) if known else None,
            }
        )
    return found


def _outcome(became: Mapping[str, str], false: Sequence[Named], verdict: str) -> str:
    if not became:
        if false:
            return 'false alarm'
        return 'right' if verdict == 'consistent' else 'unexplained'
    hits = sum(value != 'missed' for value in became.values())
    outcome = 'all' if hits == len(became) else 'some' if hits else 'none'
    return outcome + (' and a false one' if false else '')


def run(seed: int, number: int) -> dict[str, Any]:
    """Return the line of results of a case; raises `RuntimeError` where a command fails."""
    case = draw(seed, number)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_case(case, folder)
        for name in (ESTIMATION, VALIDATION):
            _waferbot(
                'import', folder / name, '--map', folder / MAP, '--out', folder / Path(name).stem
            )
        _waferbot(
            'diagnose', folder / Path(ESTIMATION).stem, '--validate',
            folder / Path(VALIDATION).stem, '--model', folder / MACHINE, '--workers', 1,
            '--out', folder / 'report',
        )  # fmt: skip
        report = json.loads((folder / 'report' / 'report.json').read_text('utf-8'))
    findings = read_findings(report)
    return {
        **score(answers_of(case), findings),
        'hidden': [effect.kind for effect in case.hidden],
        'values': [dict(effect.values) for effect in case.hidden],
        'sizes': [effect.size for effect in case.hidden],
        'validation_sizes': [effect.validation_size for effect in case.hidden],
        'machine': case.setup.machine.kind,
        'drive': case.setup.drive,
        'motions': [case.estimation.kind, case.validation.kind],
        'verdict': findings.verdict,
        'reported': [
            {
                'name': cause.name,
                'probability': cause.probability,
                'group': list(cause.alike),
                'values': {name: value[0] for name, value in cause.parameters.items()},
            }
            for cause in findings.causes
        ],
        'runtime_s': findings.runtime_s,
    }


def _waferbot(*arguments: Any) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'waferbot_twin', *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=10 * PATIENCE_S,
        preexec_fn=_no_longer_than_patience,
    )
    if done.returncode == -signal.SIGXCPU:
        raise RuntimeError(f'waferbot {arguments[0]} did not end in {PATIENCE_S} s of a processor')
    if done.returncode != 0:
        raise RuntimeError(f'waferbot {arguments[0]} failed: {done.stderr.strip()}')


def _no_longer_than_patience() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE_S, hard))
