# SPDX-License-Identifier: Apache-2.0
"""Residuals of all blocks and logs for any variant of the model, and how likely they are."""

from __future__ import annotations

import copy
import functools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.layout import Layout
from waferbot_twin.effects.effect import Effect, Values
from waferbot_twin.effects.variant import Itself, Variant
from waferbot_twin.noise_model.misfit import InLog, StateFunctions
from waferbot_twin.noise_model.prediction_error import Colour, Fit, Noise, likelihood
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.controller_block import controller_block
from waferbot_twin.residuals.drive_block import AmplifierBlock, CurrentLoopBlock, WindingsBlock
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.prior_block import PriorBlock
from waferbot_twin.residuals.record import Array, Record

PLANT, CONTROLLER = 'plant', 'controller'
AMPLIFIER, WINDINGS, CURRENT_LOOP = 'amplifier', 'windings', 'current loop'

UNITS = {PLANT: 'counts', CONTROLLER: 'A', AMPLIFIER: 'V', WINDINGS: 'A', CURRENT_LOOP: 'A'}
"""The blocks that can be replayed alone, and the unit of their residuals."""

PRIOR = 'prior'
"""What is known of parameters before any log, as one block more (`prior_block`)."""

PLAIN = 30.0
"""Difference in 2 ln L from which on an exact block plainly does something else than its model."""

ELECTRICAL = frozenset({'motors', 'current_sensors', 'encoders', 'feedback'})
"""The sections of a description that the windings depend on: the motion is measured, by encoders."""

DESCRIBED = 'controllers'
"""The section of a description that has controllers: no part of the plant."""


class BlockOfLog(Protocol):
    """One block with the signals of one log."""

    record: Record
    noises: list[Noise]
    channels: list[str]

    def residuals(self, variant: Variant) -> list[Array]:
        """Return the residual of every channel."""

    def times_s(self, channel: str) -> Array:
        """Return the time of every sample of a channel's residual, s from the log's beginning."""


@dataclass(frozen=True)
class Channel:
    """One channel of a block in one log, and what is known of its noise."""

    log: BlockOfLog
    name: str
    noise: Noise

    @property
    def axis(self) -> str:
        """The axis that it tells of."""
        return Layout.axis_of(self.name.partition(' ')[0])


FINER = 4
"""Steps of the plant for each one of before in a fine problem: what they make wrong is a sixteenth."""


@dataclass(frozen=True)
class Cause:
    """
    An effect on an axis, with values of its parameters; those `held` are not fitted.

    Of those that are `narrow` logs tell the value to parts of a thousand, and beside that they show
    nothing of it: a frequency, or what gives so little that it rings.
    """

    effect: Effect
    axis: str
    values: Values
    held: tuple[str, ...] = ()
    narrow: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Effect and axis as one word."""
        return f'{self.effect.name}:{self.axis}'

    @property
    def free(self) -> int:
        """Number of parameters to be fitted."""
        return len(self.values) - len(self.held)

    def with_values(self, values: Mapping[str, float]) -> Cause:
        """Return the same cause with other values of some parameters."""
        return replace(self, values={**self.values, **values})


def apply_all(nominal: Variant, causes: Sequence[Cause]) -> Variant:
    """Return the nominal model with all causes, one after another."""
    variant = nominal
    for cause in causes:
        values = tuple(cause.values.items())
        variant = _laid_over(Itself(variant), cause.effect, cause.axis, values)
    return variant


@functools.lru_cache(maxsize=128)
def _laid_over(
    below: Itself, effect: Effect, axis: str, values: tuple[tuple[str, float], ...]
) -> Variant:
    """
    Return a variant with one effect more.

    A fit of thirty causes changes one of them at a time: those before it are the same as the last time,
    and to check a description, 4 ms, takes as long as to simulate the plant for a tenth of a second.
    """
    return effect.apply(below.variant, axis, dict(values))


class Problem:
    """What has to be explained: the logs, block by block, and the nominal model."""

    def __init__(self, nominal: Variant, records: Sequence[Record]) -> None:
        """Prepare every block that the logs have the signals for."""
        self.nominal = nominal
        self.records = tuple(records)
        self.size_scales: tuple[float, ...] = ()
        self.unrated_scales: tuple[float, ...] = ()
        self.known_noise: dict[str, tuple[Colour, ...]] = {}
        self._by_log: dict[tuple[str, str], bool] = {}
        usual = {axis: 2.0 * current for axis, current in nominal.usual_current.items()}
        self._twice = replace(nominal, usual_current=usual) if usual else nominal
        self.blocks: dict[str, list[BlockOfLog]] = {block: [] for block in UNITS}
        for record in records:
            self.blocks[PLANT].append(PlantBlock(record, nominal))
            if record.has_controller:
                controller = controller_block(record, nominal)
                if controller.channels:
                    self.blocks[CONTROLLER].append(controller)
            self._add_drive(record)
        self._tell_states()

    def _tell_states(self) -> None:
        """Tell the noise of each channel of the plant the functions of its axis' state in all logs."""
        of_channel: dict[str, list[tuple[PlantBlock, int]]] = {}
        for part in self.plants:
            for place, channel in enumerate(part.channels):
                of_channel.setdefault(channel, []).append((part, place))
        for channel, logs in of_channel.items():
            functions = StateFunctions(
                tuple(part.measured(channel) for part, _ in logs),
                tuple(part.rates_hz[place] for part, place in logs),
            )
            for number, (part, place) in enumerate(logs):
                noise = part.noises[place]
                part.noises[place] = replace(noise, state=InLog(functions, number))

    def _add_drive(self, record: Record) -> None:
        """Prepare amplifier and windings, or without voltages both as one."""
        if record.terminals is None:
            return
        found: dict[str, BlockOfLog] = {}
        if record.terminals.voltage is not None:
            found[WINDINGS] = WindingsBlock(record, self.nominal)
        if record.command is not None and record.terminals.voltage is not None:
            found[AMPLIFIER] = AmplifierBlock(record, self.nominal)
        elif record.command is not None:
            found[CURRENT_LOOP] = CurrentLoopBlock(record, self.nominal)
        for block, part in found.items():
            if part.channels:
                self.blocks[block].append(part)

    def touched(self, effect: Effect, axis: str) -> tuple[str, ...]:
        """Return the blocks that an effect can change: those that read what its overlay says."""
        overlay = effect.overlay(self.nominal, axis, effect.typical(self.nominal, axis))
        return self._reading(
            frozenset(overlay.machine),
            bool(overlay.pmac),
            bool(overlay.copley),
            bool(overlay.deviations),
            bool(overlay.skew_s or overlay.between_s),
        )

    def between(self, one: Variant, other: Variant) -> tuple[str, ...]:
        """Return the blocks in which two variants can differ: those that read where these do."""
        sections = one.machine.keys() | other.machine.keys()
        return self._reading(
            frozenset(key for key in sections if one.machine.get(key) != other.machine.get(key)),
            one.pmac != other.pmac,
            one.copley != other.copley,
            one.deviations != other.deviations,
            (one.skew_s, one.between_s) != (other.skew_s, other.between_s),
        )

    def _reading(
        self, sections: frozenset[str], pmac: bool, copley: bool, deviations: bool, skew: bool
    ) -> tuple[str, ...]:
        """Return the blocks that read some sections of a description, and what else is true."""
        found = []
        if sections - {DESCRIBED} or skew:
            found.append(PLANT)
        if pmac or DESCRIBED in sections:
            found.append(CONTROLLER)
        if copley:
            found.append(AMPLIFIER)
        if ELECTRICAL & sections:
            found.append(WINDINGS)
        if copley or ELECTRICAL & sections:
            found.append(CURRENT_LOOP)
        if deviations:
            found.append(PRIOR)
        return tuple(block for block in found if self.blocks.get(block))

    def is_exact_limit(self, cause: Cause) -> bool:
        """Return whether a cause is a limit in exact blocks alone: it acts from one tick to the next."""
        blocks = self.touched(cause.effect, cause.axis)
        return cause.effect.threshold and set(blocks) <= set(self.exact_blocks)

    @property
    def plants(self) -> list[PlantBlock]:
        """The plant of every log."""
        return cast('list[PlantBlock]', self.blocks[PLANT])

    def residuals(self, variant: Variant, block: str, workers: int = 1) -> list[Array]:
        """Return the residuals of a block, all channels of all logs, so many logs at a time."""
        parts = self.blocks[block]
        count = min(workers, len(parts))
        if count > 1:
            pool = Parallel(n_jobs=count, prefer='threads')
            every = pool(delayed(part.residuals)(variant) for part in parts)
        else:
            # Without joblib, which on a cluster sends away what is for one worker, too.
            every = [part.residuals(variant) for part in parts]
        return [channel for of_log in every for channel in of_log]

    def ideal(self, causes: Sequence[Cause]) -> Problem | None:
        """
        Return the same problem with the noise-free logs of the model with these causes.

        None if the loop of a log cannot be closed: what was commanded or the controller is unknown. None
        either where other channels are judged in them: an encoder with coarse steps moves no windings.
        """
        if not all(record.closes_loop for record in self.records):
            return None
        variant = apply_all(self.nominal, causes)
        found = Problem(self.nominal, [simulate(variant, record) for record in self.records])
        return found if found._channels() == self._channels() else None

    def _channels(self) -> dict[str, list[str]]:
        """Return the names of the channels of every block of the logs, log by log."""
        return {block: self.channel_names(block) for block in self.blocks if block != PRIOR}

    def with_coloured_forces(self) -> Problem:
        """Return the same problem with noise whose forces may have a colour: to refute causes."""
        other = copy.copy(self)
        other.known_noise = {}
        coloured: list[BlockOfLog] = [part.with_coloured_forces() for part in self.plants]
        other.blocks = {**self.blocks, PLANT: coloured}
        return other

    def with_noise_of(self, fits: Mapping[str, Fit]) -> Problem:
        """
        Return the same problem where residuals may have the noise of these, too.

        The spectrum of noise is found in what does not go with the motion, and that of a model which is
        wrong may be one that suits no residual.
        """
        other = copy.copy(self)
        other.known_noise = {block: one.colours for block, one in fits.items() if block != PRIOR}
        return other

    def with_prior(
        self,
        groups: Sequence[Sequence[str]],
        scales: Sequence[float] = (),
        unrated: Sequence[float] = (),
    ) -> Problem:
        """
        Return the same problem with the prior of groups of parameters that have a usual spread.

        And with that of the sizes of all effects, of so many `scales`, and `unrated` ones besides where
        a log has to tell what is usual (`estimation.size_prior`).
        """
        other = copy.copy(self)
        other.size_scales, other.unrated_scales = tuple(scales), tuple(unrated)
        if groups:
            priors: list[BlockOfLog] = [PriorBlock(self.records[0], names) for names in groups]
            other.blocks = {**self.blocks, PRIOR: priors}
        return other

    def only(self, blocks: Collection[str]) -> Problem:
        """Return the same problem with some of its blocks alone."""
        other = copy.copy(self)
        other.blocks = {
            block: parts if block in blocks else [] for block, parts in self.blocks.items()
        }
        return other

    def of_log(self, record: Record) -> Problem:
        """Return the same problem with the blocks of one of its logs alone, without any prior."""
        other = copy.copy(self)
        other.known_noise = {}
        other.blocks = {
            block: [part for part in parts if block != PRIOR and part.record is record]
            for block, parts in self.blocks.items()
        }
        return other

    def quick(self) -> Problem:
        """Return the same problem with longer steps of the plant: for what a cause changes in it."""
        other = copy.copy(self)
        other.blocks = {**self.blocks, PLANT: [part.in_encoder_ticks() for part in self.plants]}
        return other

    def fine(self) -> Problem:
        """
        Return the same problem with finer steps of the plant: for what the values of causes are.

        An oscillation of frequency f comes out low by (2 pi f h)^2 / 12 in steps h
        (`waferbot_plant.integrator`), so a compliance is found too small by twice as much; a log that
        rings knows it better than that.
        """
        other = copy.copy(self)
        other.nominal = self.nominal.in_finer_steps(FINER)
        return other

    def channels(self, block: str) -> list[Channel]:
        """Return every channel of a block, log by log."""
        return [
            Channel(log, name, noise)
            for log in self.blocks[block]
            for name, noise in zip(log.channels, log.noises, strict=True)
        ]

    def noises(self, block: str) -> list[Noise]:
        """Return what is known of the noise in every channel of a block."""
        return [channel.noise for channel in self.channels(block)]

    @property
    def exact_blocks(self) -> list[str]:
        """The blocks whose output follows from their input to the last bit: nothing to whiten."""
        return [
            block
            for block, parts in self.blocks.items()
            if parts and block != PRIOR and not any(noise.order for noise in self.noises(block))
        ]

    def less_likely_than_nothing(self, block: str, residuals: Sequence[Array]) -> dict[str, float]:
        """Return by how much, in 2 ln L, each axis is less likely than one with nothing left over."""
        found: dict[str, float] = {}
        for channel, residual in zip(self.channels(block), residuals, strict=True):
            there, none = (
                likelihood([one], [channel.noise.alone()]).log_likelihood
                for one in (residual, np.zeros_like(residual))
            )
            found[channel.axis] = found.get(channel.axis, 0.0) + 2.0 * (none - there)
        return found

    def plain_axes(self, block: str, residuals: Sequence[Array]) -> set[str]:
        """Return the axes on which an exact block plainly does something else than its model."""
        left = self.less_likely_than_nothing(block, residuals)
        return {axis for axis, value in left.items() if value > PLAIN}

    @property
    def plant_rates_hz(self) -> list[float]:
        """The rate of the plant's residual in every channel, log by log."""
        return [rate for part in self.plants for rate in part.rates_hz]

    def channel_names(self, block: str) -> list[str]:
        """Return the name of every channel of a block, log by log."""
        return [channel.name for channel in self.channels(block)]

    def sized_by_log(self, effect: Effect, axis: str) -> bool:
        """
        Return whether the typical sizes of an effect follow from the currents of the logs.

        As of a drive that nobody described: what it did says little of what it can do.
        """
        key = effect.name, axis
        if key not in self._by_log:
            before, after = (effect.typical(one, axis) for one in (self.nominal, self._twice))
            self._by_log[key] = before != after
        return self._by_log[key]

    def judge(self, residuals: Mapping[str, Sequence[Array]]) -> dict[str, Fit]:
        """Return how likely residuals are as they stand, block by block (`with_noise_of`)."""
        return {
            block: likelihood(channels, self.noises(block), self.known_noise.get(block, ()))
            for block, channels in residuals.items()
            if channels
        }
