# SPDX-License-Identifier: Apache-2.0
"""
The closed loop in one process, compiled, without ROS.

The functions, and the order in which they are called, are those of the nodes; only the messages are
left out. Signals are therefore bit-identical to those of a run over ROS.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_copley import amplifier
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CONTRACT_TOPICS,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    PLANT_STATE,
    SERVO_STATE,
    SLOW_DIVIDER,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.standard_messages import (
    CLOCK,
    FIXED_TRANSFORMS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TRANSFORMS,
    clock_message,
    joint_state_message,
    string_message,
)
from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND, Timing
from waferbot_lockstep.wire import wire_of
from waferbot_plant import loads, plant
from waferbot_plant.frames import Frames
from waferbot_plant.motors import check_windings
from waferbot_plant.urdf import urdf
from waferbot_pmac import compensation, servo
from waferbot_pmac.experiments import Experiment, commanded_positions
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.failures import Failures
from waferbot_twin.models import Model
from waferbot_twin.plan import Outcome, Plan
from waferbot_twin.recording.completeness import Account, close_complete
from waferbot_twin.recording.writer import RecordingWriter, Table
from waferbot_twin.validity import Validity

CHUNK_TICKS = 9000
"""Ticks between two looks at the clock and at Ctrl-C (0.5 s of sim time)."""

Progress = Callable[[int, int], None]
"""Called with the ticks done and the ticks to do."""


@dataclass
class Signals:
    """
    The signals of a stretch of ticks, one row per message of each topic, SI units or counts.

    With n ticks, a axes and e encoders: counts int64 (n_encoder, e), line_current (n, 2 a),
    current_command (n_servo, a), voltage (n, 3 a), open_bridges (n,), servo_state (n_servo, 5 a) in the
    order of the message's fields; amplifier_* have one row per amplifier message; joint_* (n_slow, a);
    loads (n_slow, loads.width(a)), NaN of a plant that tells none. All begin at tick `first`.
    """

    first: int
    ticks: int
    timing: Timing
    layout: Layout = SHIPPED
    counts: np.ndarray = field(init=False)
    line_current: np.ndarray = field(init=False)
    current_command: np.ndarray = field(init=False)
    voltage: np.ndarray = field(init=False)
    open_bridges: np.ndarray = field(init=False)
    servo_state: np.ndarray = field(init=False)
    amplifier_tick: np.ndarray = field(init=False)
    amplifier_axes: np.ndarray = field(init=False)
    amplifier_i2t: np.ndarray = field(init=False)
    amplifier_bits: np.ndarray = field(init=False)
    amplifier_messages: np.ndarray = field(init=False)
    joint_position: np.ndarray = field(init=False)
    joint_velocity: np.ndarray = field(init=False)
    loads: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Reserve the arrays."""
        axes = len(self.layout.axes)
        encoder_rows = len(self.encoder_ticks)
        servo_rows = len(self.servo_ticks)
        slow_rows = len(self.slow_ticks)
        self.counts = np.zeros((encoder_rows, len(self.layout.encoders)), np.int64)
        self.line_current = np.zeros((self.ticks, 2 * axes))
        self.current_command = np.zeros((servo_rows, axes))
        self.voltage = np.zeros((self.ticks, 3 * axes))
        self.open_bridges = np.zeros(self.ticks, np.uint8)
        self.servo_state = np.zeros((servo_rows, 5 * axes))
        self.amplifier_tick = np.zeros(self.ticks, np.int64)
        self.amplifier_axes = np.zeros(self.ticks, np.int64)
        self.amplifier_i2t = np.zeros((self.ticks, 2, axes))
        self.amplifier_bits = np.zeros((self.ticks, 2, axes), np.uint32)
        self.amplifier_messages = np.zeros(1, np.int64)
        self.joint_position = np.zeros((slow_rows, axes))
        self.joint_velocity = np.zeros((slow_rows, axes))
        self.loads = np.full((slow_rows, loads.width(axes)), np.nan)

    def until(self, tick: int) -> Signals:
        """Return the part of these signals before `tick`."""
        part = Signals(self.first, tick - self.first, self.timing, self.layout)
        messages = int(np.searchsorted(self.amplifier_tick[: self.amplifier_messages[0]], tick))
        for name, array in vars(part).items():
            if isinstance(array, np.ndarray):
                array[:] = getattr(self, name)[: len(array)]
        part.amplifier_messages[0] = messages
        return part

    def note_failures(self, failures: Failures) -> None:
        """Look for axes that are not driven any more."""
        flags = self.servo_state[:, -len(self.layout.axes) :]
        failures.killed.note_all(np.array(self.servo_ticks), flags)
        for row in range(self.amplifier_messages[0]):
            failures.note_faults(
                int(self.amplifier_tick[row]),
                int(self.amplifier_axes[row]),
                self.amplifier_bits[row, 1],
            )

    def note_validity(self, validity: Validity) -> None:
        """Have what the plant's parts bear, and the currents, watched."""
        validity.note_loads(loads.Loads.of_rows(np.array(self.slow_ticks), self.loads))
        validity.note_commands(np.array(self.servo_ticks), self.current_command)
        rows = slice(int(self.amplifier_messages[0]))
        validity.note_amplifiers(
            self.amplifier_tick[rows],
            self.amplifier_axes[rows],
            self.amplifier_i2t[rows, 0],
            self.amplifier_i2t[rows, 1],
        )

    def _ticks_of(self, divider: int) -> range:
        start = -(-self.first // divider) * divider
        return range(start, self.first + self.ticks, divider)

    @property
    def encoder_ticks(self) -> range:
        """Ticks of the rows of `counts`."""
        return self._ticks_of(self.timing.encoder_divider)

    @property
    def servo_ticks(self) -> range:
        """Ticks of the rows of `current_command` and `servo_state`."""
        return self._ticks_of(self.timing.servo_divider)

    @property
    def slow_ticks(self) -> range:
        """Ticks of the rows of `joint_position`."""
        return self._ticks_of(SLOW_DIVIDER)


class Runaway(UserError):
    """The plant blew up; `signals` are those of the stretch in which it did, up to that tick."""

    def __init__(self, message: str, signals: Signals) -> None:
        """Keep the signals beside the message."""
        super().__init__(message)
        self.signals = signals


class Twin:
    """
    The closed loop of plant, PMAC and Copley, ready to run.

    Its states are structured arrays of one element and belong to the caller as much as to the twin;
    `advance` goes on from wherever it stands.
    """

    def __init__(
        self,
        machine: plant.Machine,
        pmac: Mapping[str, Mapping[str, Any]],
        copley: Mapping[str, Mapping[str, Any]],
        timing: Timing,
        source: str,
    ) -> None:
        """
        Build parameters and initial states of a machine and of its axes' settings.

        It is commanded to stay where it is; `source` is for messages. Raises `UserError`.
        """
        self.timing = timing
        self.machine = machine
        self.layout = machine.layout
        axes = len(self.layout.axes)
        self.plant_parameters = self.machine.parameters()
        self.plant_state = self.machine.resting_state(self.plant_parameters)
        self.servo_parameters = servo_parameters(pmac, source, self.layout)
        self.servo_state = servo.initial_state(self.servo_parameters)
        self.amplifier_parameters = amplifier_parameters(copley, timing, source, self.layout)
        self.amplifier_state = amplifier.initial_state(self.amplifier_parameters)
        self.commanded = np.zeros((1, axes))
        self.offsets: np.ndarray = np.zeros((1, axes))
        self.tick = 0
        self._start = np.zeros(axes)
        self._counts = np.zeros(len(self.layout.encoders), np.int64)
        self._current = np.zeros(axes)
        self._loads = loads.begin(axes)

    @classmethod
    def of(cls, model: Model, timing: Timing, experiment: Experiment) -> Twin:
        """Return the twin of a model, commanded by an experiment; raises `UserError`."""
        machine = plant.load_machine(
            model.parameters['plant'].get('description', 'rigid'),
            damping=model.parameters['plant'].get('damping', 'improved'),
            timing=timing,
        )
        check_windings(machine.description)
        twin = cls(
            machine, model.of_axes('pmac'), model.of_axes('copley'), timing, str(model.path)
        )
        commanded = commanded_positions(
            experiment, twin.servo_parameters, timing.servo_hz, machine.description.axis_units
        )
        twin.command(commanded, model.compensation, experiment.name)
        return twin

    def command(
        self,
        commanded: np.ndarray,
        tables: Sequence[compensation.Table] = (),
        experiment: str = '',
    ) -> None:
        """
        Command positions (cycles, axes), counts from where the axes are; with compensation tables.

        Tables over time are those of `experiment`.
        """
        self.commanded = commanded
        self.offsets = compensation.offsets(
            tables,
            experiment,
            self._first_positions() + commanded,
            self.servo_parameters,
            self.timing.servo_hz,
            self.layout,
        )

    def _first_positions(self) -> np.ndarray:
        """Return the counts (axes,) of the position encoders at tick 0, from which motions begin."""
        counts = np.zeros_like(self._counts)
        state, line_current = self.plant_state.copy(), np.zeros(2 * len(self.layout.axes))
        plant.measure(state, self.plant_parameters, 0, counts, line_current)
        return counts[self.servo_parameters['Ixx03'][0]].astype(np.float64)

    def advance(self, ticks: int) -> Signals:
        """
        Run the next `ticks` ticks and return their signals.

        Raises `Runaway` if the plant blows up, with the signals up to there.
        """
        signals = Signals(self.tick, ticks, self.timing, self.layout)
        stopped, coordinate = _advance(
            self.tick,
            ticks,
            self.timing.encoder_divider,
            self.timing.servo_divider,
            self.plant_state,
            self.plant_parameters,
            self.servo_state,
            self.servo_parameters,
            self.amplifier_state,
            self.amplifier_parameters,
            self.commanded,
            self.offsets,
            self._start,
            self._counts,
            self._current,
            signals.counts,
            signals.line_current,
            signals.current_command,
            signals.voltage,
            signals.open_bridges,
            signals.servo_state,
            signals.amplifier_tick,
            signals.amplifier_axes,
            signals.amplifier_i2t,
            signals.amplifier_bits,
            signals.amplifier_messages,
            signals.joint_position,
            signals.joint_velocity,
            self._loads,
            signals.loads,
        )
        if coordinate >= 0:
            self.tick = stopped
            message = self.machine.runaway_message(coordinate, stopped)
            raise Runaway(message, signals.until(stopped))
        self.tick += ticks
        return signals


Advance = Callable[[int], Signals]
"""Runs the next ticks and returns their signals."""


def run(
    plan: Plan,
    out: Path | None,
    force: bool,
    progress: Progress,
    advance_with: Callable[[Twin], Advance] | None = None,
) -> Outcome:
    """
    Run a plan to its end, recording to `out` if given.

    `advance_with` gives what advances the twin in place of its own loop: something else is its plant.
    Raises `UserError` if the folder exists (unless `force`), the plan is impossible, or an axis is not
    driven any more at its end (after closing the recording).
    """
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    _compile(plan)
    begun_s = time.perf_counter()
    failures = Failures.of(plan.timing, twin.layout)
    validity = Validity(plan.model, plan.timing, twin.machine)
    with contextlib.ExitStack() as stack:
        recorder = None
        if out is not None:
            writer = stack.enter_context(
                RecordingWriter(out, plan.attachments('inprocess'), force, live=True)
            )
            recorder = SignalRecorder(writer, plan.timing, layout=twin.layout)
            recorder.describe(urdf(twin.machine.description))
        try:
            advance = twin.advance if advance_with is None else advance_with(twin)
            for signals in _chunks(twin, advance, plan.ticks, progress):
                signals.note_failures(failures)
                signals.note_validity(validity)
                if recorder:
                    recorder.write(signals)
        except Runaway as error:
            error.signals.note_failures(failures)
            error.signals.note_validity(validity)
            if recorder:
                recorder.write(error.signals)
                with contextlib.suppress(UserError):  # of what is missing behind that tick
                    recorder.close(plan.ticks, validity.after(failures.reason()), validity.told())
            raise failures.with_this(error) from None
        loop_s = time.perf_counter() - begun_s
        failure = validity.after(failures.reason())
        if recorder:
            line = recorder.close(plan.ticks, failure, validity.told())
        else:
            line = close_complete(
                None, Account(plan.timing, layout=twin.layout), plan.ticks, failure
            )
        return Outcome(line, loop_s, validity.departures())


def _compile(plan: Plan) -> None:
    """Compile the loop, or load it from disk, on a twin of its own."""
    Twin.of(plan.model, plan.timing, plan.experiment).advance(1)


def _chunks(twin: Twin, advance: Advance, ticks: int, progress: Progress) -> Iterator[Signals]:
    with Interrupt() as interrupt:
        while twin.tick < ticks:
            yield advance(min(CHUNK_TICKS, ticks - twin.tick))
            progress(twin.tick, ticks)
            if interrupt.raised:
                raise KeyboardInterrupt


class SignalRecorder:
    """Writes signals as the messages that the nodes would have sent."""

    def __init__(
        self,
        writer: RecordingWriter,
        timing: Timing,
        topics: Sequence[Topic] = CONTRACT_TOPICS,
        standard_topics: bool = True,
        layout: Layout = SHIPPED,
    ) -> None:
        """Declare the topics of a machine: all of the contract and the standard ones, or only some."""
        self._layout = layout
        self._writer = writer
        self._timing = timing
        self._account = Account(
            timing, {topic: 0 for topic in CONTRACT_TOPICS if topic not in topics}, layout
        )
        self._wire = {}
        for topic in topics:
            writer.add_topic(f'/{topic.name}', topic.type_for(layout))
            self._wire[topic] = wire_of(topic, layout)
        self._standard_topics = standard_topics
        if standard_topics:
            for name, type_name in (CLOCK, JOINT_STATES, TRANSFORMS):
                writer.add_topic(f'/{name}', type_name)
            writer.add_topic(f'/{PLANT_STATE.name}', PLANT_STATE.type_for(layout))
            self._plant_state = wire_of(PLANT_STATE, layout)
        self._frames: Frames | None = None

    def describe(self, robot: str) -> None:
        """Write what is said before tick 0: the URDF of the machine, and its fixed transforms."""
        self._frames = Frames.of(robot)
        for (name, type_name), message in (
            (ROBOT_DESCRIPTION, string_message(robot)),
            (FIXED_TRANSFORMS, self._frames.fixed_message()),
        ):
            self._writer.add_topic(f'/{name}', type_name, latched=True)
            self._writer.write(f'/{name}', 0, message)

    def write(self, signals: Signals) -> None:
        """Write a stretch of signals, in the order of time."""
        all_axes, all_encoders = self._layout.all_axes, self._layout.all_encoders
        every = range(signals.first, signals.first + signals.ticks)
        amplifier_rows = int(signals.amplifier_messages[0])
        servo_values = np.split(signals.servo_state, 5, axis=1)
        tables: tuple[tuple[Topic, Sequence[int] | np.ndarray, Any, Sequence[np.ndarray]], ...] = (
            (ENCODERS_TOPIC, signals.encoder_ticks, all_encoders, (signals.counts,)),
            (PHASE_CURRENTS, every, all_axes, (signals.line_current,)),
            (CURRENT_COMMAND, signals.servo_ticks, all_axes, (signals.current_command,)),
            (SERVO_STATE, signals.servo_ticks, all_axes, servo_values),
            (PHASE_VOLTAGES, every, all_axes, (signals.voltage, signals.open_bridges)),
            (
                AMPLIFIER_STATE,
                signals.amplifier_tick[:amplifier_rows],
                signals.amplifier_axes[:amplifier_rows],
                (
                    signals.amplifier_i2t[:amplifier_rows, 0],
                    signals.amplifier_i2t[:amplifier_rows, 1],
                    signals.amplifier_bits[:amplifier_rows, 0],
                    signals.amplifier_bits[:amplifier_rows, 1],
                ),
            ),
        )
        written = self._standard(signals) if self._standard_topics else []
        for topic, ticks, valid, values in tables:
            if topic not in self._wire:
                continue
            records = self._wire[topic].blank(len(ticks))
            records['tick'] = ticks
            stamps_ns = self._timing.stamps_ns(np.asarray(ticks, np.int64))
            records['stamp_sec'], records['stamp_nanosec'] = np.divmod(
                stamps_ns, NANOSECONDS_PER_SECOND
            )
            records['valid'] = valid
            names = self._wire[topic].value_fields
            for name, column in zip(names, values, strict=True):
                records[name] = column
            self._account.topics[topic].note_all(records['tick'], records['valid'])
            written.append(Table.of(f'/{topic.name}', stamps_ns, records))
        self._writer.write_tables(written)

    def _standard(self, signals: Signals) -> list[Table]:
        """Return the messages of the standard topics, which come first at their ticks."""
        stamps_ns = self._timing.stamps_ns(np.asarray(signals.slow_ticks, np.int64))
        clocks = [clock_message(stamp) for stamp in stamps_ns.tolist()]
        joints = [
            joint_state_message(
                stamp,
                self._layout.axes,
                signals.joint_position[row].tolist(),
                signals.joint_velocity[row].tolist(),
            )
            for row, stamp in enumerate(stamps_ns.tolist())
        ]
        tables = [
            Table.of_messages(f'/{topic[0]}', stamps_ns, messages)
            for topic, messages in ((CLOCK, clocks), (JOINT_STATES, joints))
            if messages
        ]
        if self._frames is not None and len(stamps_ns):
            transforms = [
                self._frames.message(stamp, dict(zip(self._layout.axes, position, strict=True)))
                for stamp, position in zip(
                    stamps_ns.tolist(), signals.joint_position.tolist(), strict=False
                )
            ]
            tables.append(Table.of_messages(f'/{TRANSFORMS[0]}', stamps_ns, transforms))
        told = np.isfinite(signals.loads).all(axis=1)
        if told.any():
            records = self._plant_state.blank(int(told.sum()))
            records['tick'] = np.asarray(signals.slow_ticks, np.int64)[told]
            records['stamp_sec'], records['stamp_nanosec'] = np.divmod(
                stamps_ns[told], NANOSECONDS_PER_SECOND
            )
            records['valid'] = self._layout.all_axes
            names = self._plant_state.value_fields
            values = loads.fields(signals.loads[told])
            for name, column in zip(names, values, strict=True):
                records[name] = column
            tables.append(Table.of(f'/{PLANT_STATE.name}', stamps_ns[told], records))
        return tables

    def close(self, ticks: int, failure: str = '', told: Mapping[str, str] | None = None) -> str:
        """
        Close the recording; return the line that says whether it is complete, or raise `failure`.

        `told` goes into its metadata.
        """
        return close_complete(self._writer, self._account, ticks, failure, told)


@compiled
def open_terminals(plant_state, mask):
    """Open the terminals of the motors whose bit is set in `mask`, connect the others."""
    terminals = plant_state[0]['terminals_open']
    for axis in range(terminals.shape[0]):
        terminals[axis] = mask >> axis & 1


@compiled
def _advance(
    first,
    ticks,
    encoder_divider,
    servo_divider,
    plant_state,
    plant_parameters,
    servo_state,
    servo_parameters,
    amplifier_state,
    amplifier_parameters,
    commanded,
    offsets,
    start,
    counts,
    current,
    counts_out,
    line_current_out,
    command_out,
    voltage_out,
    open_out,
    servo_out,
    amplifier_tick,
    amplifier_axes,
    amplifier_i2t,
    amplifier_bits,
    amplifier_messages,
    joint_position,
    joint_velocity,
    borne,
    loads_out,
):
    """
    Run the closed loop from tick `first` on, for `ticks` ticks, in the order of the contract.

    Within a tick: plant measures; PMAC, on a servo tick; Copley; plant integrates. `start`, `counts`,
    `current` and `borne` (see `loads`) carry over to the next call; the *_out and amplifier_* arrays are
    filled from row 0.
    Returns the tick that comes next, and -1, or the coordinate for which it stopped at that tick
    because the plant blew up.
    """
    position_encoder = servo_parameters[0]['Ixx03']
    motors = len(position_encoder)
    all_axes = (1 << motors) - 1
    target = np.empty(motors)
    i2t = np.zeros((2, motors))
    limits = np.zeros(motors, np.uint8)
    faults = np.zeros(motors, np.uint32)
    encoder_row = 0
    servo_row = 0
    amplifier_row = 0
    slow_row = 0
    for row in range(ticks):
        tick = first + row
        line_current = line_current_out[row]
        voltage = voltage_out[row]
        if tick % SLOW_DIVIDER == 0:
            coordinate = plant.runaway(plant_state)
            if coordinate >= 0:
                amplifier_messages[0] = amplifier_row
                return tick, coordinate
        plant.measure(plant_state, plant_parameters, tick, counts, line_current)
        if tick % SLOW_DIVIDER == 0:
            plant.joint_positions(
                plant_state,
                plant_parameters,
                joint_position[slow_row],
                joint_velocity[slow_row],
            )
            loads.take(plant_state, plant_parameters, borne, loads_out[slow_row])
            slow_row += 1
        if tick % encoder_divider == 0:
            counts_out[encoder_row] = counts
            encoder_row += 1
        if tick % servo_divider == 0:
            loads.note(plant_state, plant_parameters, borne)
            cycle = tick // servo_divider
            if cycle == 0:
                for axis in range(motors):
                    start[axis] = counts[position_encoder[axis]]
                servo.prime(servo_state, servo_parameters, counts, start)
            place = min(cycle, commanded.shape[0] - 1)
            for axis in range(motors):
                target[axis] = start[axis] + commanded[place, axis]
            place = min(cycle, offsets.shape[0] - 1)
            for axis in range(motors):
                servo_state[0]['offset'][axis] = offsets[place, axis]
            servo.step(servo_state, servo_parameters, counts, target, current)
            s = servo_state[0]
            for axis in range(motors):
                command_out[servo_row, axis] = current[axis]
                servo_out[servo_row, axis] = s['commanded_position'][axis]
                servo_out[servo_row, motors + axis] = s['following_error'][axis]
                servo_out[servo_row, 2 * motors + axis] = s['output'][axis]
                servo_out[servo_row, 3 * motors + axis] = s['integrator'][axis]
                servo_out[servo_row, 4 * motors + axis] = s['flags'][axis]
            servo_row += 1
        amplifier.step(
            amplifier_state,
            amplifier_parameters,
            all_axes,
            current,
            line_current,
            counts,
            voltage,
        )
        open_out[row] = amplifier.open_bridges(amplifier_state)
        axes = all_axes if tick % SLOW_DIVIDER == 0 else amplifier.changed(amplifier_state)
        if axes:
            amplifier.report(
                amplifier_state,
                amplifier_parameters,
                axes,
                i2t[0],
                i2t[1],
                limits,
                faults,
            )
            # As from the node, a message about some axes repeats what was last said of the others.
            for axis in range(motors):
                amplifier_i2t[amplifier_row, 0, axis] = i2t[0, axis]
                amplifier_i2t[amplifier_row, 1, axis] = i2t[1, axis]
                amplifier_bits[amplifier_row, 0, axis] = limits[axis]
                amplifier_bits[amplifier_row, 1, axis] = faults[axis]
            amplifier_tick[amplifier_row] = tick
            amplifier_axes[amplifier_row] = axes
            amplifier_row += 1
        open_terminals(plant_state, open_out[row])
        plant.advance(plant_state, plant_parameters, voltage)
    amplifier_messages[0] = amplifier_row
    return first + ticks, -1
