# SPDX-License-Identifier: Apache-2.0
"""
Cases: what is hidden in which logs, all drawn from a seed.

A case is told by its kind, what is hidden and a number; with the bench's seed that says everything
else. What is drawn does not depend on the size, so that the cases of a detection curve differ in
nothing but the size of the effect.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis_matrix.deviations import BESIDE_THEM, CORRECTED, Deviation, draw_deviations
from diagnosis_matrix.motions import draw_experiment
from waferbot_twin.effects import find, library
from waferbot_twin.effects.effect import Parameter, Values
from waferbot_twin.effects.variant import Variant

SINGLE, NOTHING, TWO, UNKNOWN = 'single', 'nothing', 'two', 'unknown'
AMONG_KNOWN = 'unknown among known'
"""The first of three effects is out of the library, the others are of typical size."""

SEVERAL, OFF = 'several', 'off'
"""Effects of typical size at once; the same on a machine of which every number is a little off."""

OTHER = 'other'
"""Machines of another simulator, which draws them itself: `diagnosis_matrix.other_simulator`."""

DEMO = 'demo'
"""The logs that come with the package: `diagnosis_matrix.demonstration`."""

COUNTS = {SEVERAL: (3, 8), OFF: (1, 3)}
"""The fewest and the most effects that are hidden at once."""


@dataclass(frozen=True)
class Group:
    """
    Cases that are counted together: their kind, their size, how many are in the full matrix.

    Without a size effects are as large as they typically are, by half more or less.
    """

    name: str
    kind: str
    size: float | None
    cases: int


GROUPS = {
    group.name: group
    for group in (
        Group('single-10', SINGLE, 10.0, 304),
        Group('single-3', SINGLE, 3.0, 304),
        Group('single-1', SINGLE, 1.0, 152),
        Group('typical', SINGLE, None, 152),
        Group('nothing', NOTHING, 0.0, 304),
        Group('two', TWO, 5.0, 152),
        Group('several', SEVERAL, None, 100),
        Group('everything-off', OFF, None, 60),
        Group('unknown', UNKNOWN, 10.0, 76),
        Group('unknown-among-known', AMONG_KNOWN, 10.0, 76),
        Group('other-simulator', OTHER, None, 200),
        Group('demo', DEMO, None, 1),
    )
}

NOISE_LEVELS = (0.3, 3.0)


@dataclass(frozen=True)
class Case:
    """
    What is hidden (`effect:axis`, up to three), and the number of the case among its like.

    What is hidden in a case of several effects is drawn later (`draw`): not every machine runs with all
    of them.
    """

    group: str
    hidden: tuple[str, ...]
    number: int
    seed: int

    @property
    def key(self) -> str:
        """One line that no other case has."""
        return ' '.join(
            (self.group, '+'.join(self.hidden) or '-', str(self.number), str(self.seed))
        )

    @property
    def random(self) -> np.random.Generator:
        """The generator that everything else is drawn from; the same for all sizes."""
        kind = GROUPS[self.group].kind
        text = ' '.join((kind, *self.hidden))
        return np.random.default_rng([self.seed, zlib.crc32(text.encode()), self.number])


@dataclass(frozen=True)
class Drawn:
    """
    A case in full but for the sizes.

    Experiments and seeds of the logs for finding and for judging; level of the noise; what is hidden
    (`effect:axis`), and for each of it the direction in which its parameters go, and its shape; what is
    a little off.
    """

    finding: tuple[tuple[str, int], ...]
    judging: tuple[tuple[str, int], ...]
    noise: float
    hidden: tuple[str, ...]
    directions: tuple[Direction, ...]
    deviations: tuple[Deviation, ...] = ()


@dataclass(frozen=True)
class Direction:
    """
    Where the parameters of an effect go as it grows: neutral + scale * width; shapes stay.

    `widths` are in the parameters' order, with sign.
    """

    parameters: tuple[Parameter, ...]
    widths: tuple[float, ...]
    shapes: Values

    def values(self, scale: float) -> Values:
        """Return the values at a scale: within the bounds, in whole steps where there are steps."""
        found = {}
        for item, width in zip(self.parameters, self.widths, strict=True):
            value = self.shapes.get(item.name, item.neutral + scale * width)
            if item.resolution > 0.0 and not item.shape:
                steps = round((value - item.neutral) / item.resolution)
                value = item.neutral + steps * item.resolution
            found[item.name] = min(max(value, item.low), item.high)
        return found

    @property
    def largest_scale(self) -> float:
        """The scale at which the first parameter comes to a bound."""
        limits = [
            ((item.high if width > 0.0 else item.low) - item.neutral) / width
            for item, width in zip(self.parameters, self.widths, strict=True)
            if width != 0.0
        ]
        return min(limits)


def pairs(variant: Variant, effects: Sequence[str] = ()) -> list[str]:
    """Return `effect:axis` for every effect (or those named) on every axis where it is distinct."""
    return [
        f'{name}:{axis}'
        for name, effect in library().items()
        if not effects or name in effects
        for axis in effect.distinct_axes(variant)
    ]


def cases(group: Group, names: Sequence[str], seed: int) -> Iterator[Case]:
    """Return the cases of a group, without end: all effects once in an order drawn, then again."""
    for number in itertools.count():
        if group.kind in (NOTHING, OTHER, DEMO, *COUNTS):
            yield Case(group.name, (), number, seed)
            continue
        random = np.random.default_rng([seed, zlib.crc32(group.kind.encode()), number])
        if group.kind == TWO:
            first, second = random.choice(len(names), 2, replace=len(names) < 2)
            yield Case(group.name, (names[first], names[second]), number, seed)
            continue
        if group.kind == AMONG_KNOWN:
            # What is taken out of the library must not take out what is known.
            order = [names[place] for place in random.permutation(len(names))]
            different = {name.split(':')[0]: name for name in reversed(order)}
            three = sorted(different.values(), key=order.index)[:3]
            yield Case(group.name, tuple(three), number, seed)
            continue
        for place in random.permutation(len(names)):
            yield Case(group.name, (names[place],), number, seed)


def draw(case: Case, variant: Variant, attempt: int = 0) -> Drawn:
    """
    Return everything that is drawn for a case: two motions, now and then three.

    Each attempt has the same motions and noise. Of several effects at once it has others, so that one
    can be had with which the machine runs.
    """
    random = case.random
    logs = [
        (draw_experiment(variant, random), int(random.integers(2**31)))
        for _ in range(3 if random.random() < 0.25 else 2)
    ]
    low, high = np.log(NOISE_LEVELS)
    noise = float(np.exp(random.uniform(low, high)))
    kind = GROUPS[case.group].kind
    hidden, deviations = case.hidden, ()
    if kind == OFF:
        deviations = draw_deviations(variant, random)
    if kind in COUNTS:
        random = np.random.default_rng([int(random.integers(2**31)), attempt])
        left_out = (*CORRECTED, *BESIDE_THEM) if kind == OFF else ()
        hidden = draw_several(variant, *COUNTS[kind], left_out, random)
    directions = tuple(draw_direction(name, variant, random) for name in hidden)
    return Drawn(tuple(logs[:-1]), tuple(logs[-1:]), noise, hidden, directions, deviations)


def draw_several(
    variant: Variant,
    fewest: int,
    most: int,
    left_out: Sequence[str],
    random: np.random.Generator,
) -> tuple[str, ...]:
    """
    Return some different effects at once: each on an axis drawn first, in a block drawn next.

    So that all axes and blocks come alike often, however many effects the library has for them.
    """
    cells: dict[str, dict[str, list[str]]] = {}
    for name in pairs(variant):
        effect, axis = name.split(':')
        if effect not in left_out:
            cells.setdefault(axis, {}).setdefault(find(effect).block.value, []).append(name)
    count = int(random.integers(fewest, most + 1))
    found: list[str] = []
    while len(found) < count:
        blocks = cells[sorted(cells)[int(random.integers(len(cells)))]]
        names = blocks[sorted(blocks)[int(random.integers(len(blocks)))]]
        name = names[int(random.integers(len(names)))]
        if name not in found:
            found.append(name)
    return tuple(found)


def draw_direction(name: str, variant: Variant, random: np.random.Generator) -> Direction:
    """
    Return the direction of `effect:axis`.

    Parameters go by 0.5 to 1.5 of their typical size, either way where both make sense. A shape
    is that of one of the effect's trials, within a quarter where nothing fixes it.
    """
    effect_name, axis = name.split(':')
    effect = find(effect_name)
    parameters = effect.parameters(variant, axis)
    trials = effect.trials(variant, axis)
    trial = trials[int(random.integers(len(trials)))]
    widths, shapes = [], {}
    for item in parameters:
        if item.shape:
            value = trial.get(item.name, item.typical)
            if not item.fixed:
                value *= float(np.exp(random.uniform(-0.22, 0.22)))
            shapes[item.name] = min(max(value, item.low), item.high)
            widths.append(0.0)
            continue
        width = (item.typical - item.neutral) * float(random.uniform(0.5, 1.5))
        flips = random.random() < 0.5
        if flips and item.low < item.neutral < item.high:
            width = -width
        widths.append(width)
    return Direction(parameters, tuple(widths), shapes)
