# SPDX-License-Identifier: Apache-2.0
"""
Check the plant: mathematical against multibody, and the balance of energy.

  open loop   1 A on each axis from rest: accelerations of the two rigid plants, as in chapter 3
  random      the same over random machines, states and forces
  energy      supplied = stored + lost, driven, with all losses, for each model
  drift       stored energy of free motion without losses, and its order in the step

With --description: energy and drift of that machine. Ends with exit code 1 if a check fails.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from waferbot_lockstep.compiled import compiled_before
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.cli.seeds import add_seed

if TYPE_CHECKING:
    from waferbot_plant.plant import Machine

MODELS = ('rigid', 'simplified', 'flexible')
LARGEST_DIFFERENCE = 1e-9
LARGEST_IMBALANCE = 1e-6
LARGEST_DRIFT = 1e-4
SEED = 20240607


@dataclass(frozen=True)
class Check:
    """One check: what was found, at most how much it may be, and what the thesis had."""

    name: str
    found: float
    limit: float
    unit: str
    thesis: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the value found keeps the limit; one that is not a number does not."""
        return abs(self.found) <= self.limit


ROUNDING = 1e-12
"""Drifts below this are no drift, and have no order."""

EXAMPLES = ('waferbot verify', 'waferbot verify --description ball_screw_stage')
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot verify`."""
    parser.add_argument(
        '--description', metavar='NAME|FILE', help='the machine of this description instead'
    )
    add_seed(parser, 'seed of the random draws', SEED)
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Make all checks, print them, and return 1 if one failed."""
    checks = run_checks(options.seed, options.description)
    if options.json:
        print_json(
            {
                'seed': options.seed,
                'passed': all(check.passed for check in checks),
                'checks': [{**asdict(check), 'passed': check.passed} for check in checks],
            }
        )
    else:
        _print(checks)
    return 0 if all(check.passed for check in checks) else 1


def run_checks(seed: int, description: str | None = None) -> list[Check]:
    """Make all checks, of one machine those that any has; raises `UserError` if it cannot be read."""
    from waferbot_plant import verification
    from waferbot_plant.plant import load_machine

    checks = []
    if description is not None:
        machine = load_machine(description)
        with progress_bar('verifying') as progress:
            return _balance(machine, machine.description.name, progress, 0, 2)
    total = 2 + 2 * len(MODELS)
    if not compiled_before():
        say('compiling the model: once for these sources, half a minute, then kept on disk')
    with progress_bar('verifying') as progress:
        differences = verification.open_loop_differences(load_machine('rigid'))
        for axis, percent in differences.items():
            thesis = verification.THESIS_DIFFERENCE_PERCENT[axis]
            limit = 100.0 * LARGEST_DIFFERENCE
            checks.append(Check(f'open loop, 1 A on {axis}', percent, limit, '%', thesis))
        progress(1, total)
        worst = 100.0 * verification.random_agreement(seed)
        limit = 100.0 * LARGEST_DIFFERENCE
        checks.append(Check('1000 random machines and states', worst, limit, '%'))
        progress(2, total)
        for place, model in enumerate(MODELS):
            checks += _balance(load_machine(model), model, progress, 2 + 2 * place, total)
    return checks


def _balance(
    machine: Machine, name: str, progress: Callable[[int, int], None], done: int, total: int
) -> list[Check]:
    """Return the checks of a machine's energy; two steps of `total`, of which `done` are over."""
    from waferbot_plant import verification

    imbalance = verification.energy_imbalance(machine)
    found = [Check(f'energy, {name}: not accounted for', imbalance, LARGEST_IMBALANCE, '')]
    progress(done + 1, total)
    drifts = [verification.lossless_drift(machine, substeps) for substeps in (1, 2)]
    found.append(Check(f'drift, {name}: in 1 s without losses', drifts[0], LARGEST_DRIFT, ''))
    if drifts[0] > ROUNDING or math.isnan(drifts[0]):
        share = drifts[1] / drifts[0]
        found.append(Check(f'drift, {name}: of that left at half the step', share, 0.5, ''))
    progress(done + 2, total)
    return found


def _print(checks: list[Check]) -> None:
    table = new_table('check', 'found', 'at most', 'thesis', '')
    for check in checks:
        table.add_row(
            check.name,
            f'{check.found:.2g} {check.unit}'.strip(),
            f'{check.limit:.1g} {check.unit}'.strip(),
            '' if check.thesis is None else f'{check.thesis:.1e} {check.unit}',
            'passed' if check.passed else 'FAILED',
        )
    result_console.print(table)
    failed = sum(not check.passed for check in checks)
    verdict = f'{failed} of {len(checks)} checks failed' if failed else 'all checks passed'
    result_console.print(f'\n{verdict}')
