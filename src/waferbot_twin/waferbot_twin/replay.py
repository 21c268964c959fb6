# SPDX-License-Identifier: Apache-2.0
"""
Replay: one block alone against the recorded signals of the others.

The block gets the inputs that it got in the recording, tick by tick, and its own output is compared
with the recorded one. For a run of the same model the difference is exactly zero; for a measured log
the block whose output disagrees is where the simulation is wrong.

    plant    voltages                        -> counts, line currents
    pmac     counts, commanded positions     -> current commands
    copley   commands, line currents, counts -> voltages
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from waferbot_copley import amplifier
from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    SERVO_STATE,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_plant import plant
from waferbot_pmac import compensation, servo
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.engines.inprocess import Twin, open_terminals
from waferbot_twin.metrics import rms
from waferbot_twin.models import Model
from waferbot_twin.recording.reader import Recording

INPUTS: dict[str, tuple[Topic, ...]] = {
    'plant': (PHASE_VOLTAGES,),
    'pmac': (ENCODERS_TOPIC, SERVO_STATE),
    'copley': (CURRENT_COMMAND, PHASE_CURRENTS, ENCODERS_TOPIC),
}
OUTPUTS: dict[str, tuple[Topic, ...]] = {
    'plant': (ENCODERS_TOPIC, PHASE_CURRENTS),
    'pmac': (CURRENT_COMMAND,),
    'copley': (PHASE_VOLTAGES,),
}
FIELDS = {
    ENCODERS_TOPIC: ('counts', 'counts'),
    PHASE_CURRENTS: ('current', 'A'),
    CURRENT_COMMAND: ('current', 'A'),
    PHASE_VOLTAGES: ('voltage', 'V'),
}
"""Field of each output topic, and its unit."""


@dataclass(frozen=True)
class Difference:
    """
    How far a replayed output is from the recorded one, for one place (axis or encoder).

    `rms` and `largest` are of replayed minus recorded, in `unit`; `rms_recorded` is that of the
    recorded signal itself; `first_tick` is where they first differ, None if nowhere.
    """

    topic: str
    place: str
    unit: str
    rms: float
    largest: float
    rms_recorded: float
    first_tick: int | None

    def as_dict(self) -> dict[str, Any]:
        """Return the difference as plain values."""
        return asdict(self)


def compare(
    topic: Topic, recorded: np.ndarray, replayed: np.ndarray, layout: Layout = SHIPPED
) -> list[Difference]:
    """
    Compare two structured arrays of one topic of a machine, tick by tick, place by place.

    Only ticks that both have are compared; raises `UserError` if there is none.
    """
    name, unit = FIELDS[topic]
    ticks, mine, theirs = np.intersect1d(
        replayed['tick'], recorded['tick'], return_indices=True, assume_unique=True
    )
    if len(ticks) == 0:
        raise UserError(f'topic {topic.name}: recorded and replayed ticks have nothing in common')
    differences = []
    for place, place_name in enumerate(topic.places(layout)):
        columns = slice(place * topic.width, (place + 1) * topic.width)
        one = replayed[name][mine][:, columns].astype(np.float64)
        other = recorded[name][theirs][:, columns].astype(np.float64)
        error = one - other
        wrong = np.flatnonzero(np.any(error != 0.0, axis=1))
        differences.append(
            Difference(
                topic.name,
                place_name,
                unit,
                rms(error.ravel()),
                float(np.max(np.abs(error))),
                rms(other.ravel()),
                int(ticks[wrong[0]]) if len(wrong) else None,
            )
        )
    return differences


def replay_in_process(recording: Recording, model: Model, node: str) -> list[Difference]:
    """Replay one block with compiled functions; raises `UserError` if an input was not recorded."""
    replayed = replayed_outputs(recording, model, node)
    return [
        difference
        for topic in OUTPUTS[node]
        for difference in compare(topic, recording[topic], replayed[topic], recording.layout)
    ]


def replayed_outputs(recording: Recording, model: Model, node: str) -> dict[Topic, np.ndarray]:
    """Return what the block puts out for the recorded inputs, as arrays like the recorded ones."""
    timing = recording.timing
    recording.check_machine(model.layout)
    check_inputs(recording, node)
    twin = Twin.of(model, timing, load_experiment('constant'))
    axes, encoders = len(twin.layout.axes), len(twin.layout.encoders)
    outputs = {}

    def put(topic: Topic, ticks: np.ndarray, values: np.ndarray) -> None:
        outputs[topic] = _at_recorded_ticks(recording[topic], ticks, FIELDS[topic][0], values)

    if node == 'plant':
        voltages = np.ascontiguousarray(recording[PHASE_VOLTAGES]['voltage'])
        ticks = len(voltages)
        counts = np.zeros((timing.messages(ticks, timing.encoder_divider), encoders), np.int64)
        currents = np.zeros((ticks, 2 * axes))
        _replay_plant(
            twin.plant_state,
            twin.plant_parameters,
            voltages,
            recording[PHASE_VOLTAGES]['open'].copy(),
            timing.encoder_divider,
            counts,
            currents,
        )
        every = np.arange(ticks)
        put(ENCODERS_TOPIC, every[:: timing.encoder_divider], counts)
        put(PHASE_CURRENTS, every, currents)
    elif node == 'pmac':
        read, state = recording[ENCODERS_TOPIC], recording[SERVO_STATE]
        rows = np.searchsorted(read['tick'], state['tick'])
        counts = np.ascontiguousarray(read['counts'][rows])
        commanded = np.ascontiguousarray(state['commanded_position'])
        currents = np.zeros((len(counts), axes))
        offsets = compensation.offsets(
            model.compensation,
            str(recording.run.get('experiment', '')),
            commanded,
            twin.servo_parameters,
            timing.servo_hz,
            twin.layout,
        )
        replay_servo(twin.servo_state, twin.servo_parameters, counts, commanded, offsets, currents)
        put(CURRENT_COMMAND, state['tick'], currents)
    else:
        measured = recording[PHASE_CURRENTS]
        voltages = np.zeros((len(measured), 3 * axes))
        _replay_amplifier(
            twin.amplifier_state,
            twin.amplifier_parameters,
            np.ascontiguousarray(_held(recording[CURRENT_COMMAND], 'current', measured['tick'])),
            np.ascontiguousarray(measured['current']),
            np.ascontiguousarray(_held(recording[ENCODERS_TOPIC], 'counts', measured['tick'])),
            voltages,
        )
        put(PHASE_VOLTAGES, measured['tick'], voltages)
    return outputs


def check_inputs(recording: Recording, node: str) -> None:
    """
    Make sure that all inputs of a node were recorded from tick 0 on, without a gap.

    A replay begins from rest, so a recording without a beginning cannot be replayed; raises
    `UserError` that names the topic.
    """
    for topic in INPUTS[node]:
        array = recording[topic]
        spacing = topic.ticks_between(recording.timing)
        if len(array) == 0 or array['tick'][0] != 0:
            raise UserError(f'{recording.path}: topic {topic.name} does not begin at tick 0')
        gaps = np.flatnonzero(np.diff(array['tick'].astype(np.int64)) != spacing)
        if len(gaps):
            raise UserError(
                f'{recording.path}: topic {topic.name} has a gap behind tick '
                f'{int(array["tick"][gaps[0]])}; a replay needs every tick'
            )


def _at_recorded_ticks(
    recorded: np.ndarray, ticks: np.ndarray, name: str, values: np.ndarray
) -> np.ndarray:
    """Return the recorded messages of `ticks` with the replayed values; one that was lost stays away."""
    _, rows, own = np.intersect1d(
        ticks.astype(np.int64), recorded['tick'].astype(np.int64), return_indices=True
    )
    replayed = recorded[own]
    replayed[name] = values[rows]
    return replayed


def _held(array: np.ndarray, name: str, ticks: np.ndarray) -> np.ndarray:
    """Return the newest values at each tick, held between messages."""
    rows = np.searchsorted(array['tick'], ticks, side='right') - 1
    return np.asarray(array[name][rows])


@compiled
def _replay_plant(
    state, parameters, voltages, open_bridges, encoder_divider, counts_out, current_out
):
    """Drive the plant by voltages (n, 3 axes); fill counts and line currents as measured."""
    counts = np.zeros(counts_out.shape[1], np.int64)
    for tick in range(voltages.shape[0]):
        plant.measure(state, parameters, tick, counts, current_out[tick])
        if tick % encoder_divider == 0:
            counts_out[tick // encoder_divider] = counts
        open_terminals(state, open_bridges[tick])
        plant.advance(state, parameters, voltages[tick])


@compiled
def replay_servo(state, parameters, counts, commanded, offsets, current_out):
    """
    Drive the servo by counts (n, encoders), commanded positions (n, axes); fill commands (n, axes).

    `offsets` (n, axes), DAC units, are what compensation tables add.
    """
    servo.prime(state, parameters, counts[0], commanded[0])
    for cycle in range(counts.shape[0]):
        for axis in range(offsets.shape[1]):
            state[0]['offset'][axis] = offsets[cycle, axis]
        servo.step(state, parameters, counts[cycle], commanded[cycle], current_out[cycle])


@compiled
def _replay_amplifier(state, parameters, command, line_current, counts, voltage_out):
    """Drive the amplifiers by commands (n, axes), line currents (n, 2 axes), counts (n, encoders)."""
    all_axes = (1 << command.shape[1]) - 1
    for tick in range(line_current.shape[0]):
        amplifier.step(
            state,
            parameters,
            all_axes,
            command[tick],
            line_current[tick],
            counts[tick],
            voltage_out[tick],
        )
