# SPDX-License-Identifier: Apache-2.0
"""
Tune an axis: PMAC gains for a bandwidth or for an experiment, with margins at every pose.

The loop is linearised at a grid of poses of the model, and of other machines that the same gains must
suit: those of --also, and the model with the parameters of --vary at their ends. Every one must have the
gain, phase and delay margins asked for. Without --bandwidth the gains are those with which a run of the
experiment is best. DIR gets tuned.yaml, a model with the new gains, margins.csv, bode.png, nichols.png
and tune.json.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import known_name
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder

MEASURES = ('settling_time', 'rms_following_error', 'overshoot_percent')

MOST_POSES = 200

EXAMPLES = (
    'waferbot tune --model as_built --axis y_linear --bandwidth 20 '
    '--notch --gain-margin 4 --phase-margin 25 --generations 8 --out stiff',
    'waferbot tune --model flexible --also as_built --axis y_rotate --bandwidth 5 '
    '--poses x_rotate=0:1.57:3',
    'waferbot tune --model as_built --experiment step_y_rotate --generations 8 --out retuned',
    'waferbot tune --model flexible --axis y_rotate --bandwidth 5 --poses x_rotate=0 '
    '--vary connections.belt.stiffness_n_m=3.2e5:4.2e5 '
    '--vary rotors.y_rotate_motor.inertia_kg_m2=1.2e-5:2.2e-5 --generations 10',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot tune`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE', help='default: as_built'
    )
    parser.add_argument(
        '--axis', metavar='AXIS', help='default: the one that the experiment moves'
    )
    parser.add_argument(
        '--bandwidth', type=float, metavar='HZ',
        help='natural frequency of the loop, as of a rigid axis',
    )  # fmt: skip
    parser.add_argument(
        '--experiment', metavar='NAME|FILE',
        help='run before and after, and tuned for if there is no --bandwidth',
    )  # fmt: skip
    parser.add_argument(
        '--measure', choices=MEASURES,
        help='what is to be small in the experiment (default: settling_time of a step, else '
        'rms_following_error)',
    )  # fmt: skip
    parser.add_argument(
        '--also', action='append', default=[], metavar='NAME|FILE',
        help='another machine that the gains must suit',
    )  # fmt: skip
    parser.add_argument(
        '--vary', action='append', default=[], metavar='PATH[=LOW:HIGH]',
        help='a parameter known to a range, by the paths of identify: the gains must suit the model '
        'with all such parameters at their ends',
    )  # fmt: skip
    parser.add_argument(
        '--library', type=Path, metavar='FILE', help='where --vary PATH has its range from'
    )
    parser.add_argument(
        '--poses', nargs='+', default=[], metavar='AXIS=LOW:HIGH:N',
        help='grid of poses, m or rad (default: where the shipped experiments go)',
    )  # fmt: skip
    parser.add_argument('--gain-margin', type=float, default=6.0, metavar='DB', help='default: 6')
    parser.add_argument(
        '--phase-margin', type=float, default=35.0, metavar='DEG', help='default: 35'
    )
    parser.add_argument(
        '--delay-margin', type=float, default=0.0, metavar='MS', help='default: none'
    )
    parser.add_argument(
        '--generations', type=int, default=20, metavar='N',
        help='how long to search: 10 candidates for each sought value a generation (default: 20)',
    )  # fmt: skip
    parser.add_argument('--notch', action='store_true', help='look for a notch (Ixx36-39), too')
    parser.add_argument('--out', type=Path, metavar='DIR', help='a new folder for the result')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Tune, print margins and runs, write the result."""
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.tuning import report
    from waferbot_twin.tuning.corners import corners, ranges
    from waferbot_twin.tuning.runs import moving_axis
    from waferbot_twin.tuning.search import Required
    from waferbot_twin.tuning.tune import design_of, poses_of, tune

    for option in ('gain_margin', 'phase_margin', 'delay_margin'):
        value = getattr(options, option)
        if not (math.isfinite(value) and value >= 0.0):
            raise UserError(f'--{option.replace("_", "-")} is {value:g}; it must be 0 or more')
    if options.bandwidth is not None and not 0.0 < options.bandwidth < 1000.0:
        raise UserError(f'--bandwidth is {options.bandwidth:g} Hz; it must be above 0, below 1000')
    if not 1 <= options.generations <= 1000:
        raise UserError(f'--generations is {options.generations}; it must be 1 to 1000')
    if options.bandwidth is None and options.experiment is None:
        raise UserError('give --bandwidth or --experiment: what to tune for')
    experiment = None if options.experiment is None else load_experiment(options.experiment)
    axis = options.axis or (None if experiment is None else moving_axis(experiment))
    if axis is None:
        raise UserError('say which axis to tune: --axis')
    output = None if options.out is None else OutputFolder(options.out, options.force)
    variant = Variant.of(load_model(options.model))
    known_name(axis, variant.layout.axes, '--axis')
    if options.library is not None and not options.vary:
        raise UserError('--library is for --vary: say which parameters take their range from it')
    others = [Variant.of(load_model(name)) for name in options.also]
    varied = ranges(options.vary, options.library, variant)
    for one in varied:
        say(f'{one.path}: {one.low:.5g} to {one.high:.5g} {one.parameter.unit}'.rstrip())
    others += corners(variant, varied)
    poses = poses_of(variant, dict(_grid(text) for text in options.poses))
    if len(poses) > MOST_POSES:
        raise UserError(f'--poses are {len(poses)} together; give at most {MOST_POSES}')
    required = Required(options.gain_margin, options.phase_margin, 1e-3 * options.delay_margin)
    design = design_of(variant, axis, poses, others, required, options.notch)
    steps = experiment is not None and any(
        'step' in motion.values['kind'] for motion in experiment.motion.get(axis, ())
    )
    measure = options.measure or ('settling_time' if steps else 'rms_following_error')
    if experiment is not None and not steps and measure != 'rms_following_error':
        raise UserError(f'--measure {measure}: {experiment.name} does not step {axis}')
    with progress_bar(f'tuning {axis}') as progress:
        tuned = tune(design, experiment, measure, options.bandwidth, options.generations, progress)
    kept = keep(output, lambda folder: report.write(tuned, folder))
    if options.json:
        print_json(report.as_dict(tuned))
    else:
        _print(tuned)
    code = kept.tell(f'model with the new gains: {{}}/{report.FILES[0]}')
    return code if tuned.met else 1


def _grid(text: str) -> tuple[str, tuple[float, ...]]:
    """Return the axis and its values of `AXIS=LOW:HIGH:N`, or of `AXIS=VALUE`."""
    import numpy as np

    axis, _, values = text.partition('=')
    parts = values.split(':')
    try:
        if len(parts) == 1:
            found = [float(parts[0])]
        else:
            low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
            found = np.linspace(low, high, count).tolist()
        if not found or len(parts) not in (1, 3) or not all(map(math.isfinite, found)):
            raise ValueError
    except (ValueError, IndexError):
        raise UserError(f'--poses {text}: give AXIS=LOW:HIGH:N, or AXIS=VALUE') from None
    return axis, tuple(found)


def _print(tuned: object) -> None:
    """Print gains, margins at every pose, and the sentence."""
    from waferbot_twin.tuning import report
    from waferbot_twin.tuning.tune import Tuned

    assert isinstance(tuned, Tuned)
    table = new_table('gain', 'before', 'after')
    for name, value in tuned.after.items():
        if value or tuned.before[name]:
            table.add_row(name, f'{tuned.before[name]:.8g}', f'{value:.8g}')
    result_console.print(table, '')
    table = new_table(
        'machine', 'pose', 'gain [dB]\nbefore', 'after', 'phase [°]\nbefore', 'after',
        'delay [ms]\nbefore', 'after', 'crossover [Hz]\nbefore', 'after',
    )  # fmt: skip
    for row in report.lines_of(tuned):
        table.add_row(*row)
    result_console.print(table, '')
    print(report.sentence(tuned))
