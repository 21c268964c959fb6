# SPDX-License-Identifier: Apache-2.0
"""
Logs as a real machine would give them: the twin with hidden effects, noise and quantisation.

The log holds what a machine's logger sees, and nothing that tells the truth: no model, no effects, no
seed, no noise-free positions. What was hidden is returned beside it.

Noise, at level 1: coloured forces on every axis (a first-order low-pass at 3 to 60 Hz, drawn), 0.3 %
of the rated force; a third of a count on every encoder; 3 mA on every measured line current.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CONTRACT_TOPICS,
    CURRENT_COMMAND,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    SERVO_STATE,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.effect import Values
from waferbot_twin.effects.places import coordinate, motor_axes, rated_force, rotary
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import CHUNK_TICKS, Progress, SignalRecorder, Twin
from waferbot_twin.models import load_model
from waferbot_twin.recording.writer import RecordingWriter, as_json

FORCE_NOISE = 0.003
"""RMS of the coloured force at noise level 1, in rated forces of the axis."""

ENCODER_NOISE_COUNTS = 1.0 / 3.0
CURRENT_NOISE_A = 0.003
FORCE_BANDWIDTH_HZ = (3.0, 60.0)

LEFT_OUT = {
    'commanded': (SERVO_STATE,),
    'currents': (PHASE_CURRENTS, PHASE_VOLTAGES),
    'command': (CURRENT_COMMAND,),
    'voltages': (PHASE_VOLTAGES,),
    'amplifier': (AMPLIFIER_STATE,),
}
"""What `--without` can leave out of a log, and the topics that it means."""


@dataclass(frozen=True)
class Hidden:
    """An effect that is in a log: name, axis, all its parameters."""

    effect: str
    axis: str
    values: Values


def parse_effect(text: str, variant: Variant, random: np.random.Generator) -> Hidden:
    """
    Read `NAME[:axis][,key=value...]`; an axis that is not given is drawn.

    Raises `UserError` for an unknown effect, axis or key, and for a value that is no number or out of
    range.
    """
    head, *pairs = text.split(',')
    name, _, axis = head.partition(':')
    effect = find(name.strip())
    axes = effect.axes(variant)
    if not axes:
        raise UserError(f'effect {effect.name} is on no axis of model {variant.name}')
    axis = axis.strip() or axes[int(random.integers(len(axes)))]
    values = {}
    for pair in pairs:
        key, equals, value = pair.partition('=')
        try:
            values[key.strip()] = float(value)
        except ValueError:
            equals = ''
        if not equals:
            raise UserError(f'--effect {text}: {pair!r} is not key=number')
    return Hidden(effect.name, axis, effect.complete(variant, axis, values))


def noise(variant: Variant, level: float, seed: int, random: np.random.Generator) -> Overlay:
    """Return noise of a level as an overlay; forces that differ in colour from axis to axis."""
    if level == 0.0:
        return Overlay()
    low, high = np.log(FORCE_BANDWIDTH_HZ)
    forces = {
        f'{axis}_noise': {
            'kind': 'noise',
            'coordinate': coordinate(variant, axis),
            'rms_nm' if rotary(variant, axis) else 'rms_n': (
                level * FORCE_NOISE * rated_force(variant, axis)
            ),
            'bandwidth_hz': float(np.exp(random.uniform(low, high))),
            'seed': seed,
        }
        for axis in motor_axes(variant)
    }
    encoders = {
        place: {'noise_counts': level * ENCODER_NOISE_COUNTS, 'noise_seed': seed}
        for place in variant.layout.encoders
        if place in variant.description.encoders
    }
    sensors = {
        axis: {'noise_a': level * CURRENT_NOISE_A, 'noise_seed': seed}
        for axis in motor_axes(variant)
    }
    return Overlay({'disturbances': forces, 'encoders': encoders, 'current_sensors': sensors})


def with_noise(
    variant: Variant, nominal: Variant, level: float, random: np.random.Generator
) -> Variant:
    """Return a variant of `nominal` with noise of a level, sized by the nominal machine."""
    noise_seed = int(random.integers(2**31))
    return variant.with_overlay(noise(nominal, level, noise_seed, random))


def synthesize(
    model: str | Variant,
    effects: Sequence[str],
    experiment: str,
    noise_level: float,
    seed: int,
    without: Sequence[str],
    out: Path,
    force: bool,
    progress: Progress,
) -> tuple[str, dict[str, Any]]:
    """
    Write a log to `out`; return the recorder's closing line and the truth.

    `model` is a name, a file, or a model as data.
    Raises `UserError` if an effect, the model or the experiment is wrong, or the loop is unstable.
    """
    if not 0.0 <= noise_level <= 100.0:
        raise UserError(f'--noise is {noise_level:g}; it must be between 0 and 100')
    random = np.random.default_rng(seed)
    nominal = model if isinstance(model, Variant) else Variant.of(load_model(model))
    variant = nominal
    hidden = []
    for text in effects:
        one = parse_effect(text, variant, random)
        hidden.append(one)
        variant = find(one.effect).apply(variant, one.axis, one.values)
    variant = with_noise(variant, nominal, noise_level, random)
    loaded = load_experiment(experiment)
    timing = Timing()
    ticks = timing.ticks(loaded.duration_s)
    left_out = [topic for name in without for topic in LEFT_OUT[name]]
    topics = [topic for topic in CONTRACT_TOPICS if topic not in left_out]
    twin = Twin.of(variant.model(), timing, loaded)
    layout = twin.layout
    run = {
        'engine': 'machine',
        'ticks': ticks,
        'timing': dataclasses.asdict(timing),
        'axes': list(layout.axes),
        'encoders': list(layout.encoders),
    }
    with RecordingWriter(out, {'run.json': as_json(run)}, force) as writer:
        recorder = SignalRecorder(writer, timing, topics, standard_topics=False, layout=layout)
        while twin.tick < ticks:
            recorder.write(twin.advance(min(CHUNK_TICKS, ticks - twin.tick)))
            progress(twin.tick, ticks)
        line = recorder.close(ticks)
    truth = {
        'model': model if isinstance(model, str) else nominal.name,
        'experiment': experiment,
        'seed': seed,
        'noise': noise_level,
        'effects': [dataclasses.asdict(one) for one in hidden],
    }
    return line, truth
