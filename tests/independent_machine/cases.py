# SPDX-License-Identifier: Apache-2.0
"""
Cases from a seed: a machine, its loop, two logs with different motions, and what is hidden.

A hidden effect has a size: the RMS change that it makes in the logged signals, over the RMS change that
other noise makes in them, position and drive taken together (`sizes_in`). Each is made larger until its
size in the log for estimation is `LEAST_SIZE`, and is left out where its bounds do not allow that.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from independent_machine.answers import scaled
from independent_machine.machine import Hidden, Machine, Tuning, physics_of
from independent_machine.motions import Reach
from independent_machine.simulation import Log, Motion, Noise, Setup, simulate

NOTHING_SHARE = 0.2
COUNTS = {1: 0.35, 2: 0.3, 3: 0.2, 4: 0.15}
"""How many classes of effects are hidden where something is, and how often."""

LEAST_SIZE = 1.0
LARGER = 1.5
MOST_ENLARGED = 4
"""How often an effect is made larger, and by how much, before it is left out."""


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect: kind, values (see `answers`), sizes in the logs for estimation and validation."""

    kind: str
    values: Mapping[str, float]
    size: float
    validation_size: float


@dataclass(frozen=True)
class Case:
    """A case in full, with its truth."""

    seed: int
    number: int
    setup: Setup
    hidden: tuple[HiddenEffect, ...]
    estimation: Motion
    validation: Motion
    dialect: str

    @property
    def truth(self) -> Hidden:
        """The hidden effects by kind."""
        return {effect.kind: effect.values for effect in self.hidden}

    def logs(self) -> tuple[Log, Log]:
        """Return the logs for estimation and validation."""
        return (
            simulate(self.setup, self.truth, self.estimation, _noise_seed(self, 0)),
            simulate(self.setup, self.truth, self.validation, _noise_seed(self, 1)),
        )


def _noise_seed(case: Case, which: int) -> tuple[int, ...]:
    return case.seed, case.number, 7, which


DIALECTS = ('plain', 'metric', 'german', 'counts')


MOST_ATTEMPTS = 20


def draw(seed: int, number: int) -> Case:
    """
    Return a case; the same for the same seed and number.

    What no loop holds steady is drawn anew.
    """
    for attempt in range(MOST_ATTEMPTS):
        case = _draw(seed, number, np.random.default_rng([seed, number, attempt]))
        if case is not None:
            return case
    raise RuntimeError(f'no loop is steady in {MOST_ATTEMPTS} cases drawn for {seed}, {number}')


def _draw(seed: int, number: int, random: np.random.Generator) -> Case | None:
    machine, reach = _machine(random)
    classes = 0
    if random.random() >= NOTHING_SHARE:
        classes = int(random.choice(list(COUNTS), p=list(COUNTS.values())))
    drive = str(random.choice(['current', 'current_command', 'force'], p=[0.5, 0.3, 0.2]))
    tick_hz = float(random.choice([1000.0, 1500.0, 2000.0]))
    every = 2 if drive != 'current_command' and tick_hz == 2000.0 and random.random() < 0.3 else 1
    hidden = _hidden(machine, reach, drive, classes, random)
    noise = _noise(machine, random)
    tuning = _tuning(machine, hidden, drive, tick_hz, random)
    setup = Setup(
        machine, tuning, noise, bool(random.random() < 0.5), tick_hz, every, drive, reach
    )
    kinds = random.choice(['trapezoids', 'random moves', 'sines', 'steps'], 2, False)
    if kinds[0] == 'steps':  # hardly moves: steps are left to validation
        kinds = kinds[::-1]
    case = Case(
        seed,
        number,
        setup,
        (),
        Motion(str(kinds[0]), round(random.uniform(4.0, 10.0), 1), (seed, number, 1)),
        Motion(str(kinds[1]), round(random.uniform(3.0, 6.0), 1), (seed, number, 2)),
        str(random.choice(DIALECTS)),
    )
    steady = _steady(case, hidden)
    return steady and _sized(steady, hidden)


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _machine(random: np.random.Generator) -> tuple[Machine, Reach]:
    """Return a machine and what it may do: first the mass, then a motor that moves it well."""
    kind = str(random.choice(['linear', 'rotary', 'geared'], p=[0.35, 0.25, 0.4]))
    upright = bool(random.random() < (0.2 if kind == 'linear' else 0.5))
    mass = _log_uniform(random, 0.2, 100.0 if kind == 'linear' else 30.0)
    radius = random.uniform(0.05, 0.15) * (mass / 5.0) ** (1.0 / 3.0)
    inertia = 0.0 if kind == 'linear' else 0.5 * mass * radius**2
    centre = (0.0, 0.0)
    if kind != 'linear' and not upright and random.random() < 0.4:
        centre = (0.0, -float(random.uniform(0.05, 0.3)) * radius)
    ratio = float(random.choice([3.0, 5.0, 7.0, 10.0])) if kind == 'geared' else 1.0
    load = mass if kind == 'linear' else inertia + mass * centre[1] ** 2
    motor = load * random.uniform(0.2, 1.5) / ratio**2 if kind == 'geared' else 0.0
    total = load + motor * ratio**2
    if kind == 'linear':
        acceleration = _log_uniform(random, 1.0, 12.0)
        stroke = _log_uniform(random, 0.04, 0.5)
        cycle = 1.0 / float(random.choice([0.024, 0.032, 0.048]))
        resolution = float(random.choice([1e-7, 5e-7, 1e-6, 5e-6]))
    else:
        acceleration = _log_uniform(random, 15.0, 150.0)
        stroke = _log_uniform(random, 1.0, 8.0)
        cycle = float(random.choice([4, 5, 7, 10, 11]))
        resolution = 2.0 * math.pi / float(random.choice([20000, 65536, 262144, 1048576]))
    weight = 0.0
    if upright and kind == 'linear':
        weight = mass * 9.81
    elif not upright and kind != 'linear':
        weight = mass * 9.81 * abs(centre[1])
    rated = total * acceleration * random.uniform(1.2, 1.8) + weight
    amperes = _log_uniform(random, 1.0, 10.0)
    known = random.random() < 0.35
    speed = float(random.uniform(0.4, 0.8)) * math.sqrt(acceleration * stroke)
    stiffness = (2.0 * math.pi * random.uniform(50.0, 150.0)) ** 2 * load
    machine = Machine(
        kind=kind,
        upright=upright,
        mass=_rounded(mass),
        inertia=_rounded(inertia),
        centre=(0.0, _rounded(centre[1])),
        motor_inertia=_rounded(motor),
        ratio=ratio,
        constant=_rounded(rated / amperes / ratio),
        cycle=cycle,
        gear_stiffness=_rounded(stiffness) if kind == 'geared' else 0.0,
        resolution=resolution,
        motor_resolution=(
            2.0 * math.pi / float(random.choice([8192, 65536, 131072]))
            if kind == 'geared' and random.random() < 0.7
            else 0.0
        ),
        coulomb=_rounded(rated * random.uniform(0.02, 0.1)) if known else 0.0,
        viscous=_rounded(rated * random.uniform(0.02, 0.08) / speed) if known else 0.0,
        rated_force=rated,
        current_limit=4.0 * amperes,
    )
    start = 0.0 if machine.linear else float(random.uniform(-0.5, 0.5))
    return machine, Reach(start, stroke, speed, acceleration)


def _rounded(value: float) -> float:
    """Return a value as a data sheet has it: four digits."""
    return float(f'{value:.4g}')


def _noise(machine: Machine, random: np.random.Generator) -> Noise:
    level = _log_uniform(random, 0.3, 2.0)
    amperes = machine.rated_force / machine.axis_constant
    return Noise(
        force=level * 2e-3 * machine.rated_force,
        corner_hz=_log_uniform(random, 3.0, 100.0),
        counts=float(random.choice([0.0, 0.3, 0.6])),
        motor_counts=float(random.choice([0.0, 0.3, 0.6])),
        current=level * 2e-3 * amperes,
    )


def _tuning(
    machine: Machine,
    hidden: Hidden,
    drive: str,
    tick_hz: float,
    random: np.random.Generator,
) -> Tuning:
    """
    Return a loop as somebody tunes it who sees the real machine ring, but not why.

    A lag of the current would be a delay that is hidden where the log has the command, so there is none
    then. A current that is sampled as the next command goes out stands in the log later than it acts
    (`Setup.drive_late_s`), as it does in a real one: a position that is as late is not late there.
    """
    lag_s = random.uniform(0.1, 0.5) / tick_hz
    if drive == 'current_command':
        lag_s = 0.0
    late_s = 1.5 / tick_hz + lag_s
    for kind in ('encoder_delay', 'drive_delay'):
        late_s += hidden.get(kind, {}).get('delay_s', 0.0)
    bandwidth = min(2.0 * math.pi * random.uniform(10.0, 40.0), 0.35 / late_s)
    two = machine.motor_resolution > 0.0
    position_on_motor = two and bool(random.random() < (0.7 if 'backlash' in hidden else 0.4))
    physics = physics_of(machine, hidden)
    if physics.elastic:
        held = math.sqrt(physics.stiffness / physics.load_mass)
        bandwidth = min(bandwidth, (0.6 if two else 0.3) * held)
    return Tuning(
        bandwidth=float(bandwidth),
        cascade=bool(random.random() < 0.6),
        velocity_feedforward=float(random.choice([0.0, 1.0], p=[0.3, 0.7])),
        mass_feedforward=float(random.choice([0.0, 0.8, 1.0], p=[0.4, 0.2, 0.4])),
        position_on_motor=position_on_motor,
        velocity_on_motor=two,
        lag_s=float(lag_s),
    )


def _hidden(
    machine: Machine, reach: Reach, drive: str, classes: int, random: np.random.Generator
) -> dict[str, dict[str, float]]:
    """Return what is hidden: one effect of each of so many classes; Stribeck's comes with Coulomb's."""
    geared = machine.kind == 'geared'
    of_class = {
        'dry': ['coulomb', 'direction_dependent', 'stribeck'],
        'viscous': ['viscous'],
        'scale': ['mass', 'motor_constant'],
        'still': ['constant_force'] + (['imbalance'] if _can_tilt(machine) else []),
        'cogging': ['cogging'],
        'sensor': ['eccentricity', 'encoder_delay']
        + (['motor_eccentricity'] if machine.motor_resolution else [])
        + (['drive_delay'] if drive == 'current_command' else []),
    }
    if geared:
        of_class['transmission'] = ['backlash', 'compliance']
        of_class['before'] = ['motor_coulomb']
    found: dict[str, dict[str, float]] = {}
    for place in random.choice(len(of_class), classes, replace=False):
        kind = str(random.choice(of_class[list(of_class)[place]]))
        if kind == 'stribeck':
            found['coulomb'] = _values('coulomb', machine, reach, random)
        found[kind] = _values(kind, machine, reach, random)
    return found


def _can_tilt(machine: Machine) -> bool:
    return not machine.linear and machine.has_gravity


def _values(
    kind: str, machine: Machine, reach: Reach, random: np.random.Generator
) -> dict[str, float]:
    """Return the values of an effect of moderate size; forces by the motor's rated one."""
    rated = machine.rated_force
    sign = float(random.choice([-1.0, 1.0]))
    angle = random.uniform(0.0, 2.0 * np.pi)
    wave = {'cosine': math.cos(angle), 'sine': math.sin(angle)}
    turn = 2.0 * math.pi
    if kind == 'coulomb':
        return {'friction': rated * _log_uniform(random, 0.02, 0.2)}
    if kind == 'motor_coulomb':
        return {'friction': rated / machine.ratio * _log_uniform(random, 0.02, 0.15)}
    if kind == 'direction_dependent':
        mean, share = rated * _log_uniform(random, 0.03, 0.15), sign * random.uniform(0.2, 0.8)
        return {'forward': mean * (1.0 + share), 'backward': mean * (1.0 - share)}
    if kind == 'stribeck':
        return {
            'breakaway': rated * _log_uniform(random, 0.02, 0.1),
            'speed': min(
                _log_uniform(random, 2e-3, 2e-2) * (1.0 if machine.linear else 10.0),
                0.05 * reach.speed,
            ),
        }
    if kind == 'viscous':
        return {'damping': rated * _log_uniform(random, 0.02, 0.15) / reach.speed}
    if kind == 'mass':
        part = machine.mass if machine.linear else machine.inertia
        share = random.uniform(0.05, 0.4) if sign > 0.0 else -random.uniform(0.05, 0.3)
        return {'amount': part * share}
    if kind == 'motor_constant':
        return {'ratio': 1.0 + sign * random.uniform(0.04, 0.15)}
    if kind == 'constant_force':
        return {'force': sign * rated * _log_uniform(random, 0.02, 0.15)}
    if kind == 'imbalance':
        arm = rated * _log_uniform(random, 0.03, 0.2) / (machine.mass * 9.81)
        return {'offset_x': arm * wave['cosine'], 'offset_y': arm * wave['sine']}
    if kind == 'cogging':
        return _cogging_values(machine, random)
    if kind == 'eccentricity':
        amplitude = (
            _log_uniform(random, 2e-6, 2e-5)
            if machine.linear
            else _log_uniform(random, 5e-5, 5e-4)
        )
        period = turn if not machine.linear else float(random.choice([0.01, 0.02, 0.04]))
        amplitude = max(amplitude, 4.0 * machine.resolution)
        return {**{key: amplitude * value for key, value in wave.items()}, 'period': period}
    if kind == 'motor_eccentricity':
        amplitude = max(_log_uniform(random, 3e-4, 3e-3), 4.0 * machine.motor_resolution)
        return {**{key: amplitude * value for key, value in wave.items()}, 'period': turn}
    if kind in ('encoder_delay', 'drive_delay'):
        return {'delay_s': _log_uniform(random, 3e-4, 1.2e-3)}
    if kind == 'backlash':
        return {'gap': max(_log_uniform(random, 3e-4, 5e-3), 6.0 * machine.resolution)}
    assert kind == 'compliance'
    return {'compliance': _log_uniform(random, 0.7, 6.0) / machine.gear_stiffness}


def _cogging_values(machine: Machine, random: np.random.Generator) -> dict[str, float]:
    """Return one to three orders, per turn of the motor or, of a linear motor, per electrical cycle."""
    pole_pairs = 1.0 if machine.linear else machine.cycle
    usual = [round(pole_pairs * share) for share in (1, 2, 6)]
    if not machine.linear:
        usual.append(round(6.0 * max(1.0, round(2.0 * machine.cycle / 6.0))))
    orders = random.choice(sorted(set(usual)), int(random.integers(1, 4)), replace=False)
    values = {}
    for order in sorted(int(order) for order in orders):
        amplitude = machine.rated_force / machine.ratio * _log_uniform(random, 0.01, 0.07)
        angle = random.uniform(0.0, 2.0 * np.pi)
        values[f'cosine_{order}'] = amplitude * math.cos(angle)
        values[f'sine_{order}'] = amplitude * math.sin(angle)
    return values


CALM = 2e-3
"""RMS following error at rest, of the stroke, above which a loop is no loop that anybody runs."""

SLOWER = 0.6


SLOWER_ATTEMPTS = 6


def _steady(case: Case, hidden: Hidden) -> Case | None:
    """
    Return the case with a bandwidth at which it neither swings nor asks for more than there is.

    In both logs; None if none of `SLOWER_ATTEMPTS` does.
    """
    for _ in range(SLOWER_ATTEMPTS):
        if all(
            _is_steady(case.setup, simulate(case.setup, hidden, motion, _noise_seed(case, which)))
            for which, motion in enumerate((case.estimation, case.validation))
        ):
            return case
        setup, reach = case.setup, case.setup.reach
        tuning = dataclasses.replace(setup.tuning, bandwidth=SLOWER * setup.tuning.bandwidth)
        reach = dataclasses.replace(reach, acceleration=0.8 * reach.acceleration)
        setup = dataclasses.replace(setup, tuning=tuning, reach=reach)
        case = dataclasses.replace(case, setup=setup)
    return None


def _is_steady(setup: Setup, log: Log) -> bool:
    error = np.abs(log.commanded - log.position)
    follows = np.isfinite(error).all() and error.max() < 0.2 * setup.reach.stroke
    return bool(follows and log.saturated < 0.02 and log.restless < CALM)


def change(first: Log, second: Log) -> np.ndarray:
    """Return the RMS differences of two logs: position, motor position, drive."""
    return np.array(
        [
            np.sqrt(np.mean((one - other) ** 2))
            for one, other in (
                (first.position, second.position),
                (first.motor_position, second.motor_position),
                (first.drive, second.drive),
            )
        ]
    )


def sizes_in(case: Case, hidden: Hidden, which: int) -> dict[str, float]:
    """
    Return the size of every hidden effect in log 0 (estimation) or 1 (validation).

    The RMS differences between the log with all effects and that without this one, noise the same, over
    those (by root two) between two logs with other noise; summed in squares over the signals. The second
    encoder counts only where there is one.
    """
    motion = (case.estimation, case.validation)[which]
    full = simulate(case.setup, hidden, motion, _noise_seed(case, which))
    other = simulate(case.setup, hidden, motion, (*_noise_seed(case, which), 1))
    used = [True, case.setup.machine.motor_resolution > 0.0, True]
    noise = change(full, other) / math.sqrt(2.0)
    # A standstill of rounded readings has no noise; a third of a count is that of rounding.
    ratio = case.setup.machine
    least = [0.3 * ratio.resolution, 0.3 * ratio.motor_resolution, 1e-9]
    noise = np.maximum(noise, least)[used]
    sizes = {}
    for kind in hidden:
        rest = {name: values for name, values in hidden.items() if name != kind}
        log = simulate(case.setup, rest, motion, _noise_seed(case, which))
        sizes[kind] = float(np.sqrt(np.sum((change(full, log)[used] / noise) ** 2)))
    return sizes


def _sized(case: Case, hidden: Hidden) -> Case | None:
    """Return the case with its hidden effects, each large enough to matter; None if it swings then."""
    for attempt in range(MOST_ENLARGED + 1):
        sizes = sizes_in(case, hidden, 0)
        small = {kind for kind, size in sizes.items() if size < LEAST_SIZE}
        if not small:
            break
        if attempt == MOST_ENLARGED:
            hidden = {kind: values for kind, values in hidden.items() if kind not in small}
            sizes = sizes_in(case, hidden, 0)
            break
        hidden = {
            kind: scaled(kind, values, LARGER) if kind in small else values
            for kind, values in hidden.items()
        }
        steady = _steady(case, hidden)
        if steady is None:
            return None
        case = steady
    later = sizes_in(case, hidden, 1)
    effects = tuple(
        HiddenEffect(kind, dict(values), sizes[kind], later[kind])
        for kind, values in hidden.items()
    )
    return dataclasses.replace(case, hidden=effects)
