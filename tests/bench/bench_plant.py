# SPDX-License-Identifier: Apache-2.0
"""
Speed of the plant beside MuJoCo and pinocchio, and of the closed loop beside real time; one core.

Mechanics: one step of our plant (mechanism, springs, cable, dry friction, windings: implicit midpoint)
against `mj_step` (Euler, RK4) and pinocchio's articulated-body algorithm, on the same bodies and
freedoms. The other engines get less to do: no motors, no dry friction, no cable, and what a rigid
transmission ties together moves freely there. Pinocchio is called from Python, some tenths of a
microsecond each; it gives an acceleration only.

Closed loop: plant, PMAC and Copley at 18 kHz in one compiled loop, per model and experiment, beside
the run times of Table 6.8.

Shown is the best of some rounds: what the code takes when nothing else wants the core. Prints tables;
writes the same as JSON to bench-results/plant.json.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
from rich.console import Console
from rich.table import Table

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.timing import Timing
from waferbot_plant import plant
from waferbot_twin.cli.console import progress_bar
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.plan import make_plan

sys.path.insert(0, str(Path(__file__).parents[2] / 'src' / 'waferbot_plant' / 'test'))

from pinocchio_twin import PinocchioTwin
from plant_machines import MujocoTwin

MODELS = ('rigid', 'simplified', 'flexible')
EXPERIMENTS = ('step_y_linear', 'step_x_rotate', 'step_y_rotate')
TABLE_6_8 = {'simplified': (14.30, 2.82, 3.39), 'flexible': (68.16, 14.03, 23.37)}
"""The thesis' run times relative to its rigid model, for the steps of the three axes."""

LEAST_REALTIME_FACTOR = {'rigid': 50.0, 'simplified': 25.0, 'flexible': 10.0}
LARGEST_FLEXIBLE_TO_RIGID = 5.0
STEPS = 9000


@compiled
def advance_many(state, parameters, voltage, ticks):
    """Advance the plant by so many ticks."""
    for _ in range(ticks):
        plant.advance(state, parameters, voltage)


def microseconds_each(function: Callable[[], Any], repeats: int) -> float:
    """Return the wall time of a call over `repeats`, in us."""
    begun_s = time.perf_counter()
    function()
    return 1e6 * (time.perf_counter() - begun_s) / repeats


def time_plant(model: str) -> float:
    """Return us per tick of our plant, moving and vibrating freely."""
    machine = plant.load_machine(model)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    voltage = np.array([20.0, -10.0, -10.0] * 3)
    advance_many(state, parameters, voltage, 10)
    return microseconds_each(lambda: advance_many(state, parameters, voltage, STEPS), STEPS)


def time_mujoco(model: str, integrator: int) -> float:
    """Return us per step of MuJoCo."""
    twin = MujocoTwin(plant.load_machine(model))
    twin.model.opt.timestep = Timing().tick_s
    twin.model.opt.integrator = integrator
    data = mujoco.MjData(twin.model)
    mujoco.mj_step(twin.model, data, 10)
    return microseconds_each(lambda: mujoco.mj_step(twin.model, data, STEPS), STEPS)


def time_pinocchio(model: str) -> float:
    """Return us per call of the articulated-body algorithm, from Python."""
    twin = PinocchioTwin(plant.load_machine(model))
    q = np.full(twin.model.nv, 0.01)
    v = np.full(twin.model.nv, 0.1)
    force = np.ones(twin.model.nv)

    def calls() -> None:
        for _ in range(STEPS):
            pinocchio.aba(twin.model, twin.data, q, v, force)

    calls()
    return microseconds_each(calls, STEPS)


def time_closed_loop(model: str, experiment: str) -> float:
    """Return us per tick of the whole closed loop."""
    plan = make_plan(model, experiment, 0.5)
    Twin.of(plan.model, plan.timing, plan.experiment).advance(10)
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    return microseconds_each(lambda: twin.advance(plan.ticks), plan.ticks)


def measure(rounds: int, progress: Callable[[int, int], None]) -> list[dict[str, Any]]:
    """Return a row per model; the best of rounds, the engines in turn within each."""
    integrators = mujoco.mjtIntegrator
    rows = []
    for model in MODELS:
        cases: dict[str, Callable[[], float]] = {
            'plant_us': lambda model=model: time_plant(model),
            'mujoco_euler_us': lambda model=model: time_mujoco(model, integrators.mjINT_EULER),
            'mujoco_rk4_us': lambda model=model: time_mujoco(model, integrators.mjINT_RK4),
            'pinocchio_aba_us': lambda model=model: time_pinocchio(model),
            **{
                f'closed_loop_{experiment}_us': lambda model=model, experiment=experiment: (
                    time_closed_loop(model, experiment)
                )
                for experiment in EXPERIMENTS
            },
        }
        found: dict[str, list[float]] = {name: [] for name in cases}
        for number in range(rounds):
            for name, case in cases.items():
                found[name].append(case())
            progress(len(rows) * rounds + number + 1, len(MODELS) * rounds)
        rows.append(
            {
                'model': model,
                'coordinates': len(plant.load_machine(model).coordinates),
                **{name: min(values) for name, values in found.items()},
            }
        )
    return rows


def closed_loop_us(row: dict[str, Any]) -> float:
    """Return the mean of a model's closed loops over the experiments."""
    return statistics.mean(row[f'closed_loop_{experiment}_us'] for experiment in EXPERIMENTS)


def aims(rows: list[dict[str, Any]]) -> list[tuple[str, float, str, float, bool]]:
    """Return what was aimed at: (what, found, at most or at least, limit, reached)."""
    tick_us = 1e6 * Timing().tick_s
    by_model = {row['model']: row for row in rows}
    flexible = closed_loop_us(by_model['flexible'])
    found = [
        (
            'closed loop, flexible, over MuJoCo Euler alone',
            flexible / by_model['flexible']['mujoco_euler_us'], 'at most', 1.0,
        ),
        (
            'closed loop, flexible over rigid',
            flexible / closed_loop_us(by_model['rigid']), 'at most', LARGEST_FLEXIBLE_TO_RIGID,
        ),
        *(
            (
                f'closed loop, {model}, times real time',
                tick_us / closed_loop_us(by_model[model]), 'at least', least,
            )
            for model, least in LEAST_REALTIME_FACTOR.items()
        ),
    ]  # fmt: skip
    return [
        (what, value, sense, limit, value <= limit if sense == 'at most' else value >= limit)
        for what, value, sense, limit in found
    ]


def print_tables(rows: list[dict[str, Any]]) -> None:
    """Print mechanics, closed loop and aims."""
    console = Console(markup=False, width=110)
    mechanics = Table(title='One step of the mechanics, us (best of rounds)')
    for heading in ('model', 'coordinates', 'ours', 'MuJoCo Euler', 'MuJoCo RK4', 'pinocchio ABA'):
        mechanics.add_column(heading, justify='right')
    for row in rows:
        names = ('plant_us', 'mujoco_euler_us', 'mujoco_rk4_us', 'pinocchio_aba_us')
        mechanics.add_row(
            row['model'], str(row['coordinates']), *(f'{row[name]:.2f}' for name in names)
        )
    console.print(mechanics)
    loop = Table(title='Closed loop at 18 kHz: us per tick, times real time, relative to rigid')
    for heading in ('model', 'experiment', 'us', 'x real time', 'to rigid', 'thesis (Table 6.8)'):
        loop.add_column(heading, justify='right')
    for row in rows:
        for place, experiment in enumerate(EXPERIMENTS):
            spent = row[f'closed_loop_{experiment}_us']
            thesis = TABLE_6_8.get(row['model'])
            loop.add_row(
                row['model'],
                experiment,
                f'{spent:.2f}',
                f'{1e6 * Timing().tick_s / spent:.1f}',
                f'{spent / rows[0][f"closed_loop_{experiment}_us"]:.2f}',
                f'{thesis[place]:.2f}' if thesis else '',
            )
    console.print(loop)
    for what, value, sense, limit, reached in aims(rows):
        verdict = 'reached' if reached else 'MISSED'
        console.print(f'{what}: {value:.2f} ({sense} {limit:g}) {verdict}')


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=7, help='rounds; the best is shown')
    options = parser.parse_args()
    with progress_bar('measuring') as progress:
        rows = measure(options.rounds, progress)
    print_tables(rows)
    folder = Path('bench-results')
    folder.mkdir(exist_ok=True)
    names = ('what', 'found', 'sense', 'limit', 'reached')
    result = {
        'rows': rows,
        'aims': [dict(zip(names, aim, strict=True)) for aim in aims(rows)],
    }
    (folder / 'plant.json').write_text(json.dumps(result, indent=2) + '\n', 'utf-8')
    print(f'as JSON: {folder / "plant.json"}')


if __name__ == '__main__':
    main()
