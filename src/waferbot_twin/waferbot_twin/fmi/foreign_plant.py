# SPDX-License-Identifier: Apache-2.0
"""
An FMU in the place of the plant, in lock-step with PMAC and Copley, in this process.

The FMU has the inputs and outputs of `blocks.PlantBlock` by name, or by a mapping of these names to
its own. Voltages, counts and line currents of all axes of the model it must have; open terminals,
positions and speeds are passed over if it has none (then the recording holds zeros for the latter).
FMI 2.0 and 3.0, co-simulation. Counts are rounded to whole ones.

Within a tick all is as in `engines.inprocess`: what the FMU shows at tick k, PMAC, Copley, and a step
of the FMU by one tick with the voltages held.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_copley import amplifier
from waferbot_lockstep.contract import SLOW_DIVIDER
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac import servo
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.fmi.blocks import COUNTS, LINES, OPEN, POSITIONS, SPEEDS, VOLTAGES

NEEDED = (*VOLTAGES, *COUNTS, *LINES)


class ForeignPlant:
    """An FMU that was instantiated; `values` reads outputs, `step` goes on."""

    def __init__(self, file: Path, mapping: Mapping[str, str], timing: Timing) -> None:
        """Instantiate and initialise; raises `UserError` for what is wrong with the FMU."""
        self.file, self._timing = file, timing
        try:
            import fmpy
        except ImportError as error:
            raise UserError('--plant needs FMPy: python -m pip install fmpy') from error
        if not file.is_file():
            raise UserError(f'--plant {file}: no such file')
        self._folder = ''
        try:
            description = fmpy.read_model_description(str(file), validate=False)
            if description.coSimulation is None:
                raise UserError(f'--plant {file}: it is no FMU for co-simulation')
            self._folder = fmpy.extract(str(file))
            self._read(description, mapping)
            self._fmu = _instantiated(description, self._folder, timing)
        except UserError:
            self.close()
            raise
        except Exception as error:  # FMPy raises whatever it meets in a file that is none
            self.close()
            raise UserError(f'--plant {file}: {str(error).splitlines()[0]}') from error

    def _read(self, description: Any, mapping: Mapping[str, str]) -> None:
        known = {variable.name: variable.valueReference for variable in description.modelVariables}
        roles = {variable.name: variable.causality for variable in description.modelVariables}
        missing = []
        for variable in NEEDED:
            name = mapping.get(variable.name, variable.name)
            role = 'input' if variable in VOLTAGES else 'output'
            if roles.get(name) != role:
                missing.append(f'{role} {name!r}')
        if missing:
            raise UserError(
                f'--plant {self.file}: it has no {missing[0]}'
                f'{f" ({len(missing) - 1} more are missing)" if len(missing) > 1 else ""}; '
                'say with --plant-map what it calls them'
            )
        inputs = (*VOLTAGES, *(v for v in OPEN if mapping.get(v.name, v.name) in known))
        self._inputs = [known[mapping.get(variable.name, variable.name)] for variable in inputs]
        self._opens = len(inputs) > len(VOLTAGES)
        shown = (*COUNTS, *LINES, *POSITIONS, *SPEEDS)
        present = [place for place, v in enumerate(shown) if mapping.get(v.name, v.name) in known]
        self._present = np.array(present)
        self._outputs = [
            known[mapping.get(shown[place].name, shown[place].name)] for place in present
        ]
        self._shown = np.zeros(len(shown))
        self._version = 3 if str(description.fmiVersion).startswith('3') else 2

    def values(self) -> np.ndarray:
        """Return counts (4), line currents (6), positions (3) and speeds (3)."""
        read = self._fmu.getFloat64 if self._version == 3 else self._fmu.getReal
        self._shown[self._present] = read(self._outputs)
        if not np.isfinite(self._shown).all():
            raise UserError(f'--plant {self.file}: it puts out a value that is not finite')
        return self._shown

    def step(self, tick: int, voltage: np.ndarray, mask: int) -> None:
        """Advance by a tick with voltages (9,) and the mask of open bridges."""
        values = voltage.tolist()
        if self._opens:
            values += [float(mask >> axis & 1) for axis in range(3)]
        write = self._fmu.setFloat64 if self._version == 3 else self._fmu.setReal
        write(self._inputs, values)
        time_s = self._timing.seconds(tick)
        try:
            self._fmu.doStep(
                currentCommunicationPoint=time_s, communicationStepSize=self._timing.tick_s
            )
        except Exception as error:
            raise UserError(f'--plant {self.file} failed at {time_s:.6g} s: {error}') from error

    def close(self) -> None:
        """End the FMU and remove what was unpacked of it."""
        fmu = self.__dict__.pop('_fmu', None)
        if fmu is not None:
            with contextlib.suppress(Exception):
                fmu.terminate()
                fmu.freeInstance()
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)


def _instantiated(description: Any, folder: str, timing: Timing) -> Any:
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    three = str(description.fmiVersion).startswith('3')
    identity = {
        'guid': description.guid,
        'unzipDirectory': folder,
        'modelIdentifier': description.coSimulation.modelIdentifier,
        'instanceName': 'plant',
    }
    fmu = FMU3Slave(**identity) if three else FMU2Slave(**identity)
    fmu.instantiate()
    if three:
        fmu.enterInitializationMode(startTime=0.0)
    else:
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu


def advance(twin: Twin, foreign: ForeignPlant, ticks: int) -> Signals:
    """Run the next `ticks` ticks of a twin with a foreign plant in the place of its own."""
    timing = twin.timing
    signals = Signals(twin.tick, ticks, timing)
    messages = 0
    rows = {'counts': 0, 'servo': 0, 'slow': 0}
    for row in range(ticks):
        tick = twin.tick + row
        shown = foreign.values()
        line_current = shown[4:10].copy()
        signals.line_current[row] = line_current
        if tick % timing.encoder_divider == 0:
            twin._counts[:] = np.rint(shown[:4])
            signals.counts[rows['counts']] = twin._counts
            rows['counts'] += 1
        if tick % SLOW_DIVIDER == 0:
            signals.joint_position[rows['slow']] = shown[10:13]
            signals.joint_velocity[rows['slow']] = shown[13:16]
            rows['slow'] += 1
        if tick % timing.servo_divider == 0:
            _servo_cycle(twin, tick // timing.servo_divider, signals, rows['servo'])
            rows['servo'] += 1
        amplifier.step(
            twin.amplifier_state, twin.amplifier_parameters, 7, twin._current, line_current,
            twin._counts, signals.voltage[row],
        )  # fmt: skip
        mask = amplifier.open_bridges(twin.amplifier_state)
        signals.open_bridges[row] = mask
        axes = 7 if tick % SLOW_DIVIDER == 0 else amplifier.changed(twin.amplifier_state)
        if axes:
            limits, faults = np.zeros(3, np.uint8), np.zeros(3, np.uint32)
            i2t = signals.amplifier_i2t[messages]
            if messages:
                i2t[:] = signals.amplifier_i2t[messages - 1]
                limits[:], faults[:] = signals.amplifier_bits[messages - 1]
            amplifier.report(
                twin.amplifier_state,
                twin.amplifier_parameters,
                axes,
                i2t[0],
                i2t[1],
                limits,
                faults,
            )
            signals.amplifier_bits[messages] = limits, faults
            signals.amplifier_tick[messages], signals.amplifier_axes[messages] = tick, axes
            messages += 1
        foreign.step(tick, signals.voltage[row], mask)
    signals.amplifier_messages[0] = messages
    twin.tick += ticks
    return signals


def _servo_cycle(twin: Twin, cycle: int, signals: Signals, row: int) -> None:
    """Run the PMAC on the counts that are there; fill a row of its signals."""
    if cycle == 0:
        twin._start[:] = twin._counts[twin.servo_parameters['Ixx03'][0]]
        servo.prime(twin.servo_state, twin.servo_parameters, twin._counts, twin._start)
    place = min(cycle, len(twin.commanded) - 1)
    twin.servo_state[0]['offset'] = twin.offsets[min(cycle, len(twin.offsets) - 1)]
    target = twin._start + twin.commanded[place]
    servo.step(twin.servo_state, twin.servo_parameters, twin._counts, target, twin._current)
    signals.current_command[row] = twin._current
    s = twin.servo_state[0]
    names = ('commanded_position', 'following_error', 'output', 'integrator', 'flags')
    signals.servo_state[row] = np.concatenate([s[name] for name in names])


@contextlib.contextmanager
def foreign_plant(
    file: Path, mapping: Mapping[str, str], timing: Timing
) -> Iterator[ForeignPlant]:
    """Give an FMU that is closed in the end; raises `UserError`."""
    plant = ForeignPlant(file, mapping, timing)
    try:
        yield plant
    finally:
        plant.close()
