# SPDX-License-Identifier: Apache-2.0
"""
One case from beginning to end: hide, log, diagnose, compare.

The diagnosis gets what a log file holds and nothing else: either the same records in memory, because
starting processes and reading files takes longer than the diagnosis, or files, with both commands
run as processes of their own. The truth is used before, to size the effect, and afterwards, to
compare.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from diagnosis_matrix import other_simulator, scoring
from diagnosis_matrix.cases import GROUPS, NOTHING, OTHER, SINGLE, TWO, UNKNOWN, Case, Drawn, draw
from diagnosis_matrix.sizing import CLOSE, OutOfReach, scale_of_size, size
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.servo import MOTOR_KILLED
from waferbot_twin.diagnosis.diagnose import diagnose
from waferbot_twin.diagnosis.report import as_dict
from waferbot_twin.effects import find
from waferbot_twin.effects.places import moving_inertia
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.recording.writer import as_json
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.load import load_records
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Record
from waferbot_twin.suggestion.separation import TELLS_APART
from waferbot_twin.synthesis import with_noise
from waferbot_twin.validation.gain import gains

LEFT_OUT, CRASHED = 'left out', 'crashed'

LARGEST_STEP = 2.0
"""Where an effect comes in steps, most that its size may exceed a small one that is wanted."""

LARGE = 5.0
"""Size wanted from which on the smallest step that is enough is taken, however large that is."""

LEAST_IMPROVEMENT = 0.02
"""Share of the RMS error that the true model must win for the gain to be compared with."""

FLAGS = slice(12, 15)
"""Columns of the controller's flags in `Signals.servo_state`."""


@functools.cache
def nominal(model: str) -> Variant:
    """Return the model that logs are diagnosed against."""
    return Variant.of(load_model(model))


def log(variant: Variant, model: str, noise: float, experiment: str, seed: int) -> Record:
    """
    Return what a machine like `variant` logs: the same as `waferbot synthesize` writes with that seed.

    Raises `UserError` if the loop is unstable or the controller kills a motor.
    """
    random = np.random.default_rng(seed)
    noisy = with_noise(variant, nominal(model), noise, random)
    motion = load_experiment(experiment)
    timing = Timing()
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, model)
    twin.commanded = commanded_positions(motion, twin.servo_parameters, timing.servo_hz)
    signals = twin.advance(timing.ticks(motion.duration_s))
    if (signals.servo_state[:, FLAGS].astype(int) & MOTOR_KILLED).any():
        raise UserError('the controller killed a motor')
    return record_of_signals('log', signals)


def logs(
    variant: Variant, model: str, noise: float, motions: Sequence[tuple[str, int]], first: int = 0
) -> list[Record]:
    """Return the logs of several motions, with the names that files would have."""
    return [
        dataclasses.replace(
            log(variant, model, noise, experiment, seed), name=f'log_{first + place}'
        )
        for place, (experiment, seed) in enumerate(motions)
    ]


def model_of(case: Case, model: str) -> str:
    """Return the model that a case is diagnosed with, as its line of results has it."""
    return other_simulator.MODEL if _kind(case) == OTHER else model


def through(case: Case, through_files: bool) -> str:
    """Return how a case gets its logs, as its line of results has it."""
    return 'files' if through_files or _kind(case) == OTHER else 'memory'


def run(case: Case, model: str, through_files: bool) -> dict[str, Any]:
    """Run a case; return a line of results, also where it fails."""
    begun_s = time.perf_counter()
    line: dict[str, Any] = {
        'key': case.key,
        'group': case.group,
        'hidden': list(case.hidden),
        'number': case.number,
        'seed': case.seed,
        'model': model_of(case, model),
        'through': through(case, through_files),
    }
    try:
        # One case is one process: what is parallel inside would only get in the way.
        with joblib.parallel_config(backend='sequential'):
            if _kind(case) == OTHER:
                line |= other_simulator.run(case.seed, case.number)
            else:
                line |= _run(case, model, through_files)
    except OutOfReach as error:
        line |= {'outcome': LEFT_OUT, 'reason': str(error)}
    except Exception:  # a defect must not end the bench; it counts as a case that failed
        line |= {'outcome': CRASHED, 'reason': traceback.format_exc(limit=-4)}
    return line | {'case_s': time.perf_counter() - begun_s}


def _run(case: Case, model: str, through_files: bool) -> dict[str, Any]:
    drawn = draw(case, nominal(model))
    hidden, sizes = _sized(case, drawn, model)
    variant = apply_all(nominal(model), hidden)
    try:
        finding = logs(variant, model, drawn.noise, drawn.finding)
        judging = logs(variant, model, drawn.noise, drawn.judging, len(finding))
    except UserError as error:
        raise OutOfReach(str(error)) from error
    line: dict[str, Any] = {
        'noise': drawn.noise,
        'logs': len(finding) + len(judging),
        'values': [cause.values for cause in hidden],
        'sizes': sizes,
    }
    if hidden:
        line['judging_size'] = size(Problem(nominal(model), judging), hidden)
        line['gain_of_truth'] = [
            _gain_of_truth(hidden, model, records) for records in (finding, judging)
        ]

    def judged(without: Sequence[str]) -> dict[str, Any]:
        if through_files:
            found = _through_files(case, drawn, hidden, model, without)
        else:
            diagnosis = diagnose(nominal(model), finding, judging, _silent, 1, without)
            found = json.loads(as_json(as_dict(diagnosis))), finding, judging
        return _compared(case, hidden, model, *found)

    if _kind(case) != UNKNOWN:
        return line | judged(())
    own = [cause.effect.name for cause in hidden]
    line |= judged(own)
    return line | {'without_twins': _without_twins(line, own, judged)}


def _without_twins(
    line: dict[str, Any], own: Sequence[str], judged: Callable[[Sequence[str]], dict[str, Any]]
) -> dict[str, Any]:
    """
    Return what becomes of an unknown effect if what does the same is unknown, too.

    An effect is out of the library only with all that the logs cannot tell from it: where it never
    turns back, a friction that differs with the direction is Coulomb's. So as long as simulation shows
    a twin, what was reported, with its group, is taken out as well (`taken_out`) and the same logs are
    diagnosed again.
    """
    taken_out = list(own)
    while line['outcome'] == scoring.TWIN:
        for cause in line['reported']:
            for name in (cause['name'], *cause['group']):
                effect = name.split(':')[0]
                if effect not in taken_out:
                    taken_out.append(effect)
        line = judged(taken_out)
    return {
        'taken_out': taken_out[len(own) :],
        **{key: line[key] for key in ('outcome', 'reported', 'unexplained')},
    }


def _gain_of_truth(hidden: Sequence[Cause], model: str, records: Sequence[Record]) -> float:
    """
    Return 2 ln L of the true model over the nominal one, each with the noise that it leaves.

    Less than size^2 ln N where the nominal model takes a part of the effect for coloured noise.
    """
    problem = Problem(nominal(model), records)
    true, without = evaluate(problem, tuple(hidden)), evaluate(problem)
    return float(2.0 * (true.log_likelihood - without.log_likelihood))


def _silent(what: str, done: int, total: int) -> None:
    """Show no progress."""


def _kind(case: Case) -> str:
    return GROUPS[case.group].kind


def _sized(case: Case, drawn: Drawn, model: str) -> tuple[list[Cause], list[float]]:
    """Return the hidden causes and their sizes in the logs for finding; raises `OutOfReach`."""
    wanted = GROUPS[case.group].size
    hidden, sizes = [], []
    for name, direction in zip(case.hidden, drawn.directions, strict=True):
        effect_name, axis = name.split(':')
        effect = find(effect_name)

        def at(scale: float, effect=effect, axis=axis, direction=direction) -> Cause:
            return Cause(effect, axis, direction.values(scale))

        def size_at(scale: float, at=at) -> float:
            cause = at(scale)
            variant = apply_all(nominal(model), [cause])
            records = logs(variant, model, drawn.noise, drawn.finding)
            return size(Problem(nominal(model), records), [cause])

        if wanted is None:
            scale = min(1.0, direction.largest_scale)
            found = _possible(name, size_at, scale)
        else:
            scale, found = scale_of_size(size_at, wanted, direction.largest_scale)
            if wanted < LARGE and found > wanted * max(CLOSE, LARGEST_STEP):
                raise OutOfReach(f'{name}: the smallest step that is seen has size {found:.3g}')
        hidden.append(at(scale))
        sizes.append(found)
    return hidden, sizes


def _possible(name: str, size_at: Callable[[float], float], scale: float) -> float:
    """
    Return the size of an effect at a scale.

    Raises `OutOfReach` where the machine does not run, or where the motion does not show it: below a
    size of one no test could.
    """
    try:
        found = size_at(scale)
    except UserError as error:
        raise OutOfReach(f'{name}: {error}') from error
    if found < 1.0:
        raise OutOfReach(f'{name}: this motion does not show it (size {found:.2g})')
    return found


def _through_files(
    case: Case, drawn: Drawn, hidden: Sequence[Cause], model: str, without: Sequence[str]
) -> tuple[dict[str, Any], list[Record], list[Record]]:
    """Write logs, run the command on them; return its report and the logs as read back."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        effects = [
            f'{cause.name},' + ','.join(f'{key}={value!r}' for key, value in cause.values.items())
            for cause in hidden
        ]
        paths = []
        for place, (experiment, seed) in enumerate((*drawn.finding, *drawn.judging)):
            motion = folder / f'motion_{place}.yaml'
            motion.write_text(experiment, 'utf-8')
            paths.append(folder / f'log_{place}')
            _waferbot(
                'synthesize', '--model', model, '--experiment', motion, '--seed', seed,
                '--noise', repr(drawn.noise), '--out', paths[-1],
                *(word for effect in effects for word in ('--effect', effect)),
            )  # fmt: skip
        finding, judging = paths[: len(drawn.finding)], paths[len(drawn.finding) :]
        _waferbot(
            'diagnose', *finding, '--validate', *judging, '--model', model, '--workers', 1,
            '--out', folder / 'report',
            *(word for name in without for word in ('--without', name)),
        )  # fmt: skip
        report = json.loads((folder / 'report' / 'report.json').read_text('utf-8'))
        return (
            report,
            load_records(finding, nominal(model)),
            load_records(judging, nominal(model)),
        )


def _waferbot(*arguments: Any) -> None:
    command = [sys.executable, '-m', 'waferbot_twin', *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f'waferbot {arguments[0]} failed: {done.stderr.strip()}')


def _compared(
    case: Case,
    hidden: Sequence[Cause],
    model: str,
    report: dict[str, Any],
    finding: Sequence[Record],
    judging: Sequence[Record],
) -> dict[str, Any]:
    """Return the outcome of a case, and the numbers that go with it."""
    inseparable = _inseparable(hidden, report, model, finding, judging)
    outcome = {
        NOTHING: lambda: scoring.outcome_of_nothing(report),
        SINGLE: lambda: scoring.outcome_of_single(report, case.hidden[0], inseparable),
        TWO: lambda: scoring.outcome_of_two(report, case.hidden, inseparable),
        UNKNOWN: lambda: scoring.outcome_of_unknown(report, case.hidden[0], inseparable),
    }[_kind(case)]()
    return {
        'outcome': outcome,
        'verdict': report['verdict'],
        'reported': [
            {
                'name': scoring.name_of(cause),
                'probability': cause['probability'],
                'log_evidence': cause['log_evidence'],
                'group': scoring.others_of(cause),
                'values': {key: item['value'] for key, item in cause['parameters'].items()},
            }
            for cause in report['causes']
        ],
        'withdrawn': report['withdrawn'],
        'unexplained': report['unexplained'],
        'inseparable': inseparable,
        'wrong_and_sure': scoring.wrong_and_sure(report, outcome),
        'errors': _errors(hidden, report, model),
        'gain_share': _gain_share(hidden, report, model, _judged_by(report, finding, judging)),
        'runtime_s': report['runtime_s'],
    }


def _inseparable(
    hidden: Sequence[Cause],
    report: dict[str, Any],
    model: str,
    finding: Sequence[Record],
    judging: Sequence[Record],
) -> bool:
    """
    Return whether the true causes explain no log better than the reported ones, by simulation.

    The true causes have values fitted to the same logs as those reported have.
    """
    if not hidden or not report['causes']:
        return False
    fitted = judging if _judged_by(report, finding, judging) is finding else finding
    true_ones = fit_causes(Problem(nominal(model), fitted), tuple(hidden)).causes
    reported = tuple(
        Cause(
            find(cause['effect']),
            cause['axis'],
            {key: item['value'] for key, item in cause['parameters'].items()},
        )
        for cause in report['causes']
    )
    for records in (finding, judging):
        problem = Problem(nominal(model), records)
        true, found = evaluate(problem, true_ones), evaluate(problem, reported)
        if 2.0 * (true.log_likelihood - found.log_likelihood) >= TELLS_APART:
            return False
    return True


def _errors(hidden: Sequence[Cause], report: dict[str, Any], model: str) -> list[dict[str, Any]]:
    """Return the errors of all parameters of causes that were named right."""
    reported = {scoring.name_of(cause): cause for cause in report['causes']}
    return [
        {'effect': cause.effect.name, **dataclasses.asdict(error)}
        for cause in hidden
        if cause.name in reported
        for error in scoring.parameter_errors(
            reported[cause.name],
            cause.values,
            cause.effect.parameters(nominal(model), cause.axis),
            moving_inertia(nominal(model), cause.axis),
        )
    ]


def _judged_by(
    report: dict[str, Any], finding: Sequence[Record], judging: Sequence[Record]
) -> Sequence[Record]:
    """Return the logs on which a report measured its gain: a diagnosis may change their roles."""
    names = set(report['gain']['validation'])
    return judging if names == {record.name for record in judging} else finding


def _gain_share(
    hidden: Sequence[Cause], report: dict[str, Any], model: str, judging: Sequence[Record]
) -> float | None:
    """
    Return what the extended model gains in the logs for judging over what the true one would.

    On the axis where the true one gains most, in the logs that judged; None where it gains next to
    nothing.
    """
    if not hidden:
        return None
    true = gains(nominal(model), apply_all(nominal(model), hidden), list(judging))
    best = max(true, key=lambda item: 1.0 - item.rms_after / item.rms_before)
    possible = best.rms_before - best.rms_after
    if possible < LEAST_IMPROVEMENT * best.rms_before:
        return None
    found = report['gain']['axes'][best.axis]
    share = (found['rms_before'] - found['rms_after']) / possible
    return share if math.isfinite(share) else None
