# SPDX-License-Identifier: Apache-2.0
"""
Run an experiment on the twin and record it.

Engines:
  ros        plant, pmac and copley as separate processes over ROS 2 (default)
  composed   the same nodes in one process: faster, nothing to swap
  inprocess  the same model functions compiled into one loop, without ROS: fastest

With --engine ros, --compose takes some nodes into one process. Delivery, how messages reach the nodes:
  topics     by their ROS topics
  direct     from node to node inside a process, by topics between processes (default)
  channel    from node to node inside a process, by Unix sockets between processes: faster
Every message is published on its ROS topic in any case.

All of them give bit-identical signals.

With --model mathematical the machine moves by the equations of the thesis' Appendix B; how far its
positions come apart from those of the multibody plant is told at the end.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from waferbot_copley.node_settings import POLICIES
from waferbot_lockstep.compiled import compiled_before
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_plant.foreign_plant import foreign_plant, identity, read_mapping
from waferbot_pmac.settings import load_settings
from waferbot_twin.cli.console import print_json, progress_bar, say
from waferbot_twin.cli.seeds import add_seed
from waferbot_twin.engines.layout import DELIVERIES, DIRECT, startup_timeout_s
from waferbot_twin.engines.with_ros import engine_with_ros
from waferbot_twin.plan import Outcome, Plan, make_plan
from waferbot_twin.plant_difference import is_mathematical, plant_differences
from waferbot_twin.validity import OUTSIDE

ENGINES = ('ros', 'composed', 'inprocess')

EXAMPLES = (
    'waferbot run --experiment step --out runs/step',
    'waferbot run --compose plant,copley --delivery channel --out runs/composed',
    'waferbot run --experiment step_x_rotate --model as_built --engine inprocess --out runs/measured',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot run`."""
    parser.add_argument('--experiment', default='step', metavar='NAME|FILE', help='default: step')
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument(
        '--pmac-settings',
        type=Path,
        metavar='FILE',
        help='I-variables to lay over the model: a plain listing (I130=2000 ...) or YAML',
    )
    parser.add_argument('--engine', choices=ENGINES, default='ros', help='default: ros')
    parser.add_argument(
        '--compose', type=_names, default=(), metavar='NODE,NODE',
        help='nodes that share the process of this command (engine ros)',
    )  # fmt: skip
    parser.add_argument(
        '--delivery', choices=DELIVERIES, default=DIRECT, help='see above; default: direct'
    )
    parser.add_argument('--out', type=Path, metavar='DIR', help='record to this new folder')
    parser.add_argument('--force', action='store_true', help='replace the recording at --out')
    parser.add_argument('--duration', type=float, metavar='S', help="default: the experiment's")
    add_seed(parser, 'seed of whatever is random')
    parser.add_argument(
        '--copley-per-axis', action='store_true', help='three Copley nodes, one for each axis'
    )
    parser.add_argument(
        '--without', action='append', default=[], metavar='NODE',
        help='do not start this node (plant, pmac, copley, copley_<axis>): yours takes its place',
    )  # fmt: skip
    parser.add_argument(
        '--device-clock', choices=POLICIES,
        help='the controller is the clock: each current command lets one servo cycle pass, whenever it '
        'comes. If none comes: time stands (hold), current goes to zero (ramp), an error (fault)',
    )  # fmt: skip
    parser.add_argument(
        '--device-timeout', type=float, default=1.0, metavar='S',
        help='wall time to wait for such a command (default 1)',
    )  # fmt: skip
    parser.add_argument(
        '--startup-timeout', type=float, metavar='S',
        help='wall time to wait for all nodes, yours as well '
        '(default 60, and 240 more where the model has to be compiled)',
    )  # fmt: skip
    parser.add_argument(
        '--plant', type=Path, metavar='FMU',
        help='an FMU in the place of the plant, with each engine; as the plant node over ROS',
    )  # fmt: skip
    parser.add_argument(
        '--plant-map', type=Path, metavar='FILE',
        help='YAML: what the FMU calls the inputs and outputs (docs/fmi.md)',
    )  # fmt: skip
    parser.add_argument('--domain', type=int, help='ROS domain (default: a free one)')
    parser.add_argument(
        '--any-host', action='store_true', help='let nodes on other machines take part'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run, and say what came of it."""
    if options.duration is not None and not 0.0 < options.duration < 1e6:
        raise UserError(f'--duration is {options.duration:g} s; it must be above 0 and below 1e6')
    if options.startup_timeout is not None and not 0.0 < options.startup_timeout <= 3600.0:
        raise UserError(
            f'--startup-timeout is {options.startup_timeout:g} s; it must be above 0 and at most 3600'
        )
    if not 0.05 <= options.device_timeout <= 3600.0:
        raise UserError(
            f'--device-timeout is {options.device_timeout:g} s; it must be from 0.05 to 3600'
        )
    if options.plant is None and options.plant_map is not None:
        raise UserError('--plant-map belongs to --plant')
    if options.plant is not None and 'plant' in options.without:
        raise UserError('--plant is what the plant node runs: not with --without plant')
    _refuse_options_of_other_engines(options)
    plan = make_plan(options.model, options.experiment, options.duration, options.seed)
    if options.pmac_settings is not None:
        plan = with_pmac_settings(plan, options.pmac_settings)
    if options.plant is not None:
        plan = replace(plan, foreign_plant=identity(options.plant))
    result = run_plan(plan, options)
    if options.json:
        print_json(result)
    else:
        print(
            f'{result["experiment"]} on {result["model"]}, {result["engine"]}: '
            f'{result["sim_s"]:.3f} s in {result["loop_s"]:.2f} s '
            f'({result["realtime_factor"]:.2f} x real time; {result["wall_s"]:.1f} s with start-up)'
        )
        print(result['recorder'])
        for line in result['outside']:
            print(f'{OUTSIDE}: {line}')
        for line in result.get('difference', ()):
            print(f'difference to the multibody plant, {line}')
        if result['out']:
            print(f'recorded to {result["out"]}')
    return 0


def _refuse_options_of_other_engines(options: argparse.Namespace) -> None:
    """Refuse what would have no effect: options of ROS without ROS, `--compose` of what is composed."""
    if options.engine == 'composed' and options.compose:
        raise UserError('--compose is for --engine ros; composed has one process in any case')
    if options.engine != 'inprocess':
        return
    of_ros = {
        '--compose': options.compose,
        '--delivery': options.delivery != DIRECT,
        '--copley-per-axis': options.copley_per_axis,
        '--without': options.without,
        '--device-clock': options.device_clock,
        '--domain': options.domain is not None,
        '--any-host': options.any_host,
    }
    for name, given in of_ros.items():
        if given:
            raise UserError(
                f'{name} is for nodes over ROS; with --engine inprocess there are none'
            )


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(',') if name.strip())


def with_pmac_settings(plan: Plan, file: Path) -> Plan:
    """Return the plan with I-variables from a file; tell what in a listing was not taken over."""
    listing = load_settings(file, layout=plan.model.layout)
    for problem in listing.problems:
        say(f'{file}: {problem}')
    if not listing.settings:
        raise UserError(f'{file}: no I-variable of its motors is set in it')
    return replace(plan, model=plan.model.with_settings('pmac', listing.settings))


def run_plan(plan: Plan, options: argparse.Namespace) -> dict[str, Any]:
    """Run a plan on the chosen engine; return the result as plain values."""
    if not compiled_before():
        say('compiling the model: once for these sources, half a minute, then kept on disk')
    begun_s = time.perf_counter()
    with progress_bar(f'{plan.experiment.name} on {plan.model.name}') as progress:
        if options.engine == 'inprocess':
            outcome = _run_in_process(plan, options, progress)
        else:
            outcome = _run_over_ros(plan, options, progress)
    wall_s = time.perf_counter() - begun_s
    difference = {}
    if options.plant is None and not options.without and is_mathematical(plan):
        difference = {'difference': [apart.text for apart in plant_differences(plan)]}
    sim_s = plan.timing.seconds(plan.ticks)
    return {
        'engine': options.engine + (f', plant {options.plant}' if options.plant else ''),
        'experiment': plan.experiment.name,
        'model': plan.model.name,
        'seed': plan.seed,
        'ticks': plan.ticks,
        'sim_s': sim_s,
        'wall_s': wall_s,
        'loop_s': outcome.loop_s,
        'realtime_factor': sim_s / outcome.loop_s,
        'recorder': outcome.recorder,
        'outside': list(outcome.departures),
        **difference,
        'out': str(options.out) if options.out else None,
    }


def _run_in_process(plan: Plan, options: argparse.Namespace, progress: Any) -> Outcome:
    """Run a plan in this process, with an FMU in the place of its plant if there is one."""
    from waferbot_twin.engines import inprocess

    if options.plant is None:
        return inprocess.run(plan, options.out, options.force, progress)
    from waferbot_twin.fmi.lockstep import advance

    layout = plan.model.layout
    names = read_mapping(options.plant_map, layout)
    with foreign_plant(options.plant, names, plan.timing, layout) as foreign:
        return inprocess.run(
            plan,
            options.out,
            options.force,
            progress,
            lambda twin: lambda ticks: advance(twin, foreign, ticks),
        )


def _run_over_ros(plan: Plan, options: argparse.Namespace, progress: Any) -> Outcome:
    ros = engine_with_ros('ros')
    ros_options = ros.RosOptions(
        composed=options.engine == 'composed',
        compose=options.compose,
        delivery=options.delivery,
        device_clock=options.device_clock or '',
        device_timeout_s=options.device_timeout,
        one_copley_per_axis=options.copley_per_axis,
        without=tuple(options.without),
        startup_timeout_s=options.startup_timeout or startup_timeout_s(compiled_before()),
        domain=options.domain,
        any_host=options.any_host,
        on_domain=lambda number: say(f'ROS_DOMAIN_ID={number}'),
        overrides=_overrides(options, plan.model.layout),
    )
    outcome: Outcome = ros.run(plan, options.out, options.force, progress, ros_options)
    return outcome


def _overrides(options: argparse.Namespace, layout: Layout) -> dict[str, dict[str, Any]]:
    """Return the parameters of the plant's node that say which FMU it runs."""
    if options.plant is None:
        return {}
    read_mapping(options.plant_map, layout)  # its mistakes are told before any node starts
    names = '' if options.plant_map is None else str(options.plant_map.resolve())
    return {'plant': {'fmu': str(options.plant.resolve()), 'fmu_map': names}}
