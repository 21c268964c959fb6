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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from diagnosis_matrix import demonstration, other_simulator, scoring
from diagnosis_matrix.cases import (
    AMONG_KNOWN,
    COUNTS,
    DEMO,
    GROUPS,
    NOTHING,
    OFF,
    OTHER,
    SEVERAL,
    SINGLE,
    TWO,
    UNKNOWN,
    Case,
    Drawn,
    draw,
)
from diagnosis_matrix.deviations import off, with_friction
from diagnosis_matrix.differences import same_names
from diagnosis_matrix.sizing import CLOSE, OutOfReach, scale_of_size, size, sizes_of_each
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

UNKNOWNS = (UNKNOWN, AMONG_KNOWN)

MOST_ATTEMPTS = 20
"""How often several effects at once are drawn anew if the machine does not run with them."""

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
    return {OTHER: other_simulator.MODEL, DEMO: demonstration.MODEL}.get(_kind(case), model)


def through(case: Case, through_files: bool) -> str:
    """Return how a case gets its logs, as its line of results has it."""
    return 'files' if through_files or _kind(case) in (OTHER, DEMO) else 'memory'


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
        if _kind(case) == DEMO:
            line |= demonstration.run()
            return line | {'case_s': time.perf_counter() - begun_s}
        # One case is one process: what is parallel inside would only get in the way.
        with joblib.parallel_config(backend='sequential'):
            if _kind(case) == OTHER:
                line |= other_simulator.run(case.seed, case.number)
            else:
                _run(case, model, through_files, line)
    except OutOfReach as error:
        line |= {'outcome': LEFT_OUT, 'reason': str(error)}
    except Exception:  # a defect must not end the bench; it counts as a case that failed
        line |= {'outcome': CRASHED, 'reason': traceback.format_exc(limit=-4)}
    return line | {'case_s': time.perf_counter() - begun_s}


@dataclass(frozen=True)
class Laid:
    """
    What is laid into a case's logs, and these.

    Logs of `machine` with `hidden` in it are diagnosed against `nominal`; the two models are the same
    but where everything is a little off (`drawn.deviations`).
    """

    drawn: Drawn
    nominal: Variant
    machine: Variant
    hidden: tuple[Cause, ...]
    sizes: tuple[float, ...]
    finding: list[Record]
    judging: list[Record]

    @property
    def true(self) -> Variant:
        """The model that the logs are of, but for the noise."""
        return apply_all(self.machine, self.hidden)

    @property
    def size_of(self) -> dict[str, float]:
        """The size of each hidden effect in the logs for finding, by `effect:axis`."""
        return {cause.name: one for cause, one in zip(self.hidden, self.sizes, strict=True)}


def _laid(case: Case, model: str) -> Laid:
    """Return what a case's logs are of, and the logs; raises `OutOfReach`."""
    if _kind(case) in COUNTS:
        return _several_laid(case, model)
    drawn = draw(case, nominal(model))
    hidden, sizes = _sized(case, drawn, model)
    try:
        finding, judging = _both_logs(apply_all(nominal(model), hidden), model, drawn)
    except UserError as error:
        raise OutOfReach(str(error)) from error
    own = nominal(model)
    return Laid(drawn, own, own, tuple(hidden), tuple(sizes), finding, judging)


def _several_laid(case: Case, model: str) -> Laid:
    """Return the first drawing of several effects with which the machine runs; raises `OutOfReach`."""
    own = nominal(model)
    if _kind(case) == OFF:
        own = with_friction(own)
    for attempt in range(MOST_ATTEMPTS):
        drawn = draw(case, own, attempt)
        hidden = []
        for name, direction in zip(drawn.hidden, drawn.directions, strict=True):
            effect_name, axis = name.split(':')
            values = direction.values(min(1.0, direction.largest_scale))
            hidden.append(Cause(find(effect_name), axis, values))
        try:
            machine = off(own, drawn.deviations) if drawn.deviations else own
            logs_of_both = _both_logs(apply_all(machine, hidden), model, drawn)
            sizes = sizes_of_each(Problem(machine, logs_of_both[0]), hidden)
        except UserError:
            continue
        return Laid(drawn, own, machine, tuple(hidden), tuple(sizes), *logs_of_both)
    raise OutOfReach(f'the machine does not run with any of {MOST_ATTEMPTS} drawings')


def _both_logs(variant: Variant, model: str, drawn: Drawn) -> tuple[list[Record], list[Record]]:
    """Return the logs for finding and for judging; raises `UserError`."""
    finding = logs(variant, model, drawn.noise, drawn.finding)
    return finding, logs(variant, model, drawn.noise, drawn.judging, len(finding))


def _run(case: Case, model: str, through_files: bool, line: dict[str, Any]) -> None:
    """Put all that is found of a case into its line; what is known before stays if it crashes."""
    laid = _laid(case, model)
    hidden = laid.hidden
    unknown = [cause.effect.name for cause in hidden[:1]] if _kind(case) in UNKNOWNS else []
    line |= {
        'hidden': [cause.name for cause in hidden],
        'noise': laid.drawn.noise,
        'logs': len(laid.finding) + len(laid.judging),
        'values': [cause.values for cause in hidden],
        'sizes': list(laid.sizes),
        'deviations': {item.path: item.factor for item in laid.drawn.deviations},
        **scoring.effects_and_names([], _to_be_named(case, laid), {}),
    }
    if hidden:
        line['judging_size'] = size(Problem(laid.machine, laid.judging), hidden)
        line['gain_of_truth'] = [
            _gain_of_truth(laid, records) for records in (laid.finding, laid.judging)
        ]
    known = line['hidden'][1:] if unknown else []

    def judged(without: Sequence[str]) -> dict[str, Any]:
        if through_files:
            found = _through_files(laid, model, without)
        else:
            diagnosis = diagnose(laid.nominal, laid.finding, laid.judging, _silent, 1, without)
            found = json.loads(as_json(as_dict(diagnosis, quick=True))), laid.finding, laid.judging
        return _compared(case, laid, *found)

    line |= judged(unknown)
    if unknown:
        line['without_twins'] = _without_twins(line, unknown, judged, known)


def _without_twins(
    line: dict[str, Any],
    own: Sequence[str],
    judged: Callable[[Sequence[str]], dict[str, Any]],
    known: Sequence[str] = (),
) -> dict[str, Any]:
    """
    Return what becomes of an unknown effect if what does the same is unknown, too.

    An effect is out of the library only with all that the logs cannot tell from it: where it never
    turns back, a friction that differs with the direction is Coulomb's. So as long as simulation shows
    a twin, what was reported, with its group, is taken out as well (`taken_out`) and the same logs are
    diagnosed again. What is hidden beside it and known stays in the library.
    """
    taken_out, kept = list(own), {name.split(':')[0] for name in known}
    while line['outcome'] == scoring.TWIN:
        before = len(taken_out)
        for cause in line['reported']:
            for name in (cause['name'], *cause['group']):
                effect = name.split(':')[0]
                if effect not in taken_out and effect not in kept:
                    taken_out.append(effect)
        if len(taken_out) == before:
            break
        line = judged(taken_out)
    return {
        'taken_out': taken_out[len(own) :],
        **{key: line[key] for key in ('outcome', 'reported', 'unexplained')},
        'names': line.get('names', []),
    }


def _gain_of_truth(laid: Laid, records: Sequence[Record]) -> float:
    """
    Return 2 ln L of the true model over the nominal one, each with the noise that it leaves.

    Less than size^2 ln N where the nominal model takes a part of the effect for coloured noise.
    """
    true = evaluate(Problem(laid.machine, records), laid.hidden)
    without = evaluate(Problem(laid.nominal, records))
    return float(2.0 * (true.log_likelihood - without.log_likelihood))


def _silent(what: str, done: int, total: int) -> None:
    """Show no progress."""


def _kind(case: Case) -> str:
    return GROUPS[case.group].kind


def _sized(case: Case, drawn: Drawn, model: str) -> tuple[list[Cause], list[float]]:
    """Return the hidden causes and their sizes in the logs for finding; raises `OutOfReach`."""
    hidden, sizes = [], []
    for place, (name, direction) in enumerate(zip(case.hidden, drawn.directions, strict=True)):
        # Those that are known beside an unknown one are of typical size.
        typical = _kind(case) == AMONG_KNOWN and place > 0
        wanted = None if typical else GROUPS[case.group].size
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
    laid: Laid, model: str, without: Sequence[str]
) -> tuple[dict[str, Any], list[Record], list[Record]]:
    """Write logs, run the command on them; return its report and the logs as read back."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, drawn = Path(temporary), laid.drawn
        made_of, against = model, model
        if laid.machine is not laid.nominal:
            made_of, against = folder / 'machine.yaml', folder / 'nominal.yaml'
            made_of.write_text(laid.machine.text, 'utf-8')
            against.write_text(laid.nominal.text, 'utf-8')
        effects = [
            f'{cause.name},' + ','.join(f'{key}={value!r}' for key, value in cause.values.items())
            for cause in laid.hidden
        ]
        paths = []
        for place, (experiment, seed) in enumerate((*drawn.finding, *drawn.judging)):
            motion = folder / f'motion_{place}.yaml'
            motion.write_text(experiment, 'utf-8')
            paths.append(folder / f'log_{place}')
            _waferbot(
                'synthesize', '--model', made_of, '--experiment', motion, '--seed', seed,
                '--noise', repr(drawn.noise), '--out', paths[-1],
                *(word for effect in effects for word in ('--effect', effect)),
            )  # fmt: skip
        finding, judging = paths[: len(drawn.finding)], paths[len(drawn.finding) :]
        _waferbot(
            'diagnose', *finding, '--validate', *judging, '--model', against, '--workers', 1,
            '--out', folder / 'report',
            *(word for name in without for word in ('--without', name)),
        )  # fmt: skip
        report = json.loads((folder / 'report' / 'report.json').read_text('utf-8'))
        return (
            report,
            load_records(finding, laid.nominal),
            load_records(judging, laid.nominal),
        )


def _waferbot(*arguments: Any) -> None:
    command = [sys.executable, '-m', 'waferbot_twin', *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f'waferbot {arguments[0]} failed: {done.stderr.strip()}')


def _compared(
    case: Case,
    laid: Laid,
    report: dict[str, Any],
    finding: Sequence[Record],
    judging: Sequence[Record],
) -> dict[str, Any]:
    """Return the outcome of a case, and the numbers that go with it."""
    kind = _kind(case)
    hidden = [cause.name for cause in laid.hidden]
    # Of several at once each is told apart by its own name or set.
    inseparable = kind not in COUNTS and _inseparable(laid, report, finding, judging)
    scored = scoring.effects_and_names(
        report['causes'],
        _to_be_named(case, laid),
        same_names(laid.nominal),
        kind in UNKNOWNS and inseparable,
    )
    outcome = {
        NOTHING: lambda: scoring.outcome_of_nothing(report),
        SINGLE: lambda: scoring.outcome_of_single(report, hidden[0], inseparable),
        TWO: lambda: scoring.outcome_of_two(report, hidden, inseparable),
        SEVERAL: lambda: scoring.outcome_of_several(scored['effects'], scored['names']),
        OFF: lambda: scoring.outcome_of_several(scored['effects'], scored['names']),
        UNKNOWN: lambda: scoring.outcome_of_unknown(report, hidden[0], inseparable),
        AMONG_KNOWN: lambda: scoring.outcome_of_unknown(
            report, hidden[0], inseparable, hidden[1:]
        ),
    }[kind]()
    truth = {item.path: item.factor for item in laid.drawn.deviations}
    return {
        'outcome': outcome,
        'verdict': report['verdict'],
        'reported': reported(report),
        'withdrawn': report['withdrawn'],
        'unexplained': report['unexplained'],
        'corrections': scoring.corrections(report, truth),
        'inseparable': inseparable,
        'wrong_and_sure': scoring.wrong_and_sure(report, outcome),
        'errors': _errors(laid, report),
        'gain_share': _gain_share(laid, report, _judged_by(report, finding, judging)),
        'runtime_s': report['runtime_s'],
        **scored,
    }


def _to_be_named(case: Case, laid: Laid) -> dict[str, float]:
    """Return the sizes of the hidden effects that are in the library, by `effect:axis`."""
    sizes = laid.size_of
    if _kind(case) in UNKNOWNS:
        del sizes[laid.hidden[0].name]
    return sizes


def reported(report: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a line of results keeps of the causes of a report."""
    return [
        {
            'name': scoring.name_of(cause),
            'probability': cause['probability'],
            'log_evidence': cause['log_evidence'],
            'group': scoring.others_of(cause),
            'values': {key: item['value'] for key, item in cause['parameters'].items()},
        }
        for cause in report['causes']
    ]


def _inseparable(
    laid: Laid,
    report: dict[str, Any],
    finding: Sequence[Record],
    judging: Sequence[Record],
) -> bool:
    """
    Return whether the true causes explain no log better than the reported ones, by simulation.

    The true causes have values fitted to the same logs as those reported have.
    """
    if not laid.hidden or not report['causes']:
        return False
    fitted = judging if _judged_by(report, finding, judging) is finding else finding
    true_ones = fit_causes(Problem(laid.nominal, fitted), laid.hidden).causes
    found_ones = tuple(
        Cause(
            find(cause['effect']),
            cause['axis'],
            {key: item['value'] for key, item in cause['parameters'].items()},
        )
        for cause in report['causes']
    )
    for records in (finding, judging):
        problem = Problem(laid.nominal, records)
        true, found = evaluate(problem, true_ones), evaluate(problem, found_ones)
        if 2.0 * (true.log_likelihood - found.log_likelihood) >= TELLS_APART:
            return False
    return True


def _errors(laid: Laid, report: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the errors of all parameters of causes that were named right."""
    by_name = {scoring.name_of(cause): cause for cause in report['causes']}
    return [
        {'effect': cause.effect.name, **dataclasses.asdict(error)}
        for cause in laid.hidden
        if cause.name in by_name
        for error in scoring.parameter_errors(
            by_name[cause.name],
            cause.values,
            cause.effect.parameters(laid.nominal, cause.axis),
            moving_inertia(laid.nominal, cause.axis),
        )
    ]


def _judged_by(
    report: dict[str, Any], finding: Sequence[Record], judging: Sequence[Record]
) -> Sequence[Record]:
    """Return the logs on which a report measured its gain: a diagnosis may change their roles."""
    names = set(report['gain']['validation'])
    return judging if names == {record.name for record in judging} else finding


def _gain_share(laid: Laid, report: dict[str, Any], judging: Sequence[Record]) -> float | None:
    """
    Return what the extended model gains in the logs for judging over what the true one would.

    On the axis where the true one gains most, in the logs that judged; None where it gains next to
    nothing.
    """
    if not laid.hidden:
        return None
    true = gains(laid.nominal, laid.true, list(judging))
    best = max(true, key=lambda item: 1.0 - item.rms_after / item.rms_before)
    possible = best.rms_before - best.rms_after
    if possible < LEAST_IMPROVEMENT * best.rms_before:
        return None
    found = report['gain']['axes'][best.axis]
    share = (found['rms_before'] - found['rms_after']) / possible
    return share if math.isfinite(share) else None
