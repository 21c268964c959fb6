# SPDX-License-Identifier: Apache-2.0
"""
An FMU in the place of the plant, tick by tick.

It has the inputs and outputs of `signals` by name, or by a mapping of these names to its own:

    y_linear_voltage_1: drive1.u_a     # that input of the FMU
    x_rotate_voltage_1: null           # the FMU has none: what the amplifier puts out goes nowhere
    x_rotate_counts: 0                 # the FMU has none: always this value

Voltages, counts and line currents of all axes must be there or be mapped; open terminals, positions and
speeds may be missing (then zeros are shown for the latter). FMI 2.0 and 3.0, co-simulation; variables
are float64 (Real), outputs also whole numbers of any kind, as counts are; arrays (FMI 3.0) are none of
these. Counts that are no whole numbers are rounded by whoever sends them.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.marked_yaml import read
from waferbot_lockstep.timing import Timing
from waferbot_plant.signals import (
    Variable,
    counts,
    lines,
    per_axis,
    terminals,
    voltages,
)


def shown(layout: Layout) -> tuple[Variable, ...]:
    """Return what `ForeignPlant.values` returns, in this order; units of motions are the machine's."""
    motion = (*per_axis('position', '', '', layout), *per_axis('velocity', '', '', layout))
    return (*counts(layout), *lines(layout), *motion)


def needed(layout: Layout) -> tuple[Variable, ...]:
    """Return what an FMU must have, or be given by a mapping."""
    return (*voltages(layout), *counts(layout), *lines(layout))


Names = Mapping[str, str | float | None]
"""Our name to that of the FMU, to a value (outputs), or to None (inputs)."""


def read_mapping(file: Path | None, layout: Layout = SHIPPED) -> Names:
    """Return a mapping from its YAML file, an empty one without a file; raises `UserError`."""
    if file is None:
        return {}
    found = read(file).data
    if not isinstance(found, dict):
        raise UserError(f'--plant-map {file}: it must map our names to those of the FMU')
    inputs = {variable.name for variable in (*voltages(layout), *terminals(layout))}
    known = inputs | {variable.name for variable in shown(layout)}
    for name, theirs in found.items():
        if name not in known:
            raise UserError(
                f'--plant-map {file}: a plant has no {name!r}; docs/fmi.md has the names'
            )
        number = isinstance(theirs, int | float) and not isinstance(theirs, bool)
        if not isinstance(theirs, str) and not (theirs is None if name in inputs else number):
            what = 'null, for one that it does not have' if name in inputs else 'a number, held'
            raise UserError(f'--plant-map {file}: {name} must be a name of the FMU, or {what}')
    return dict(found)


def identity(file: Path) -> dict[str, str]:
    """Return what a recording says of an FMU: its name, version, token and SHA-256."""
    description = _described(file)
    return {
        'fmu': file.name,
        'fmi': str(description.fmiVersion),
        'token': str(description.guid),
        'sha256': hashlib.sha256(file.read_bytes()).hexdigest(),
    }


def _described(file: Path) -> Any:
    """Return the model description of an FMU for co-simulation; raises `UserError`."""
    try:
        import fmpy
    except ImportError as error:
        raise UserError('--plant needs FMPy: python -m pip install fmpy') from error
    if not file.is_file():
        raise UserError(f'--plant {file}: no such file')
    try:
        description = fmpy.read_model_description(str(file), validate=False)
    except Exception as error:  # FMPy raises whatever it meets in a file that is none
        raise UserError(f'--plant {file}: {str(error).splitlines()[0]}') from error
    if description.coSimulation is None:
        raise UserError(f'--plant {file}: it is no FMU for co-simulation')
    return description


INTEGERS = ('Integer', *(f'{sign}Int{bits}' for sign in ('', 'U') for bits in (8, 16, 32, 64)))
REALS = ('Real', 'Float64')


class ForeignPlant:
    """An FMU that was instantiated; `values` reads outputs, `step` goes on."""

    def __init__(
        self, file: Path, mapping: Names, timing: Timing, layout: Layout = SHIPPED
    ) -> None:
        """Instantiate and initialise; raises `UserError` for what is wrong with the FMU."""
        self.file, self._timing, self._layout = file, timing, layout
        self._variables = shown(layout)
        self._folder = ''
        self._description = _described(file)
        try:
            import fmpy

            self._folder = fmpy.extract(str(file))
            self._read(self._description, mapping)
            self._fmu = self._instantiated()
        except UserError:
            self.close()
            raise
        except Exception as error:  # as above
            self.close()
            raise UserError(f'--plant {file}: {str(error).splitlines()[0]}') from error

    def _read(self, description: Any, mapping: Names) -> None:
        known = {variable.name: variable.valueReference for variable in description.modelVariables}
        roles = {variable.name: variable.causality for variable in description.modelVariables}
        types = {variable.name: variable.type for variable in description.modelVariables}
        arrays = {variable.name for variable in description.modelVariables if variable.dimensions}
        missing = []
        inputs = (*voltages(self._layout), *terminals(self._layout))
        mapped = [one for one in (*inputs, *self._variables) if one.name in mapping]
        for variable in (*needed(self._layout), *mapped):
            name = mapping.get(variable.name, variable.name)
            if not isinstance(name, str):
                continue
            role = 'input' if variable in inputs else 'output'
            if roles.get(name) != role:
                missing.append(f'{role} {name!r}')
            elif types[name] not in (REALS if role == 'input' else (*REALS, *INTEGERS)):
                missing.append(f'real {role} {name!r} (it is of type {types[name]})')
            elif name in arrays:
                missing.append(f'single {role} {name!r} (it is an array)')
        if missing:
            raise UserError(
                f'--plant {self.file}: it has no {missing[0]}'
                f'{f" ({len(missing) - 1} more are missing)" if len(missing) > 1 else ""}; '
                'say with --plant-map what it calls them'
            )

        def placed(variables: Iterable[Variable]) -> tuple[np.ndarray, list[int]]:
            """Return the places of those that the FMU has, and their value references."""
            found = [
                (place, known[name])
                for place, variable in enumerate(variables)
                if (name := mapping.get(variable.name, variable.name)) in known
            ]
            return np.array([place for place, _ in found], int), [value for _, value in found]

        self._taken, self._inputs = placed(inputs)
        present, outputs = placed(self._variables)
        kinds = {variable.valueReference: variable.type for variable in description.modelVariables}
        self._outputs = [
            (f'get{kind}', present[of_kind], [outputs[place] for place in of_kind])
            for kind in dict.fromkeys(kinds[one] for one in outputs)
            for of_kind in [[row for row, one in enumerate(outputs) if kinds[one] == kind]]
        ]
        self._shown = np.array(
            [
                0.0 if value is None or isinstance(value, str) else float(value)
                for value in (mapping.get(variable.name) for variable in self._variables)
            ]
        )
        self._three = str(description.fmiVersion).startswith('3')

    def _instantiated(self) -> Any:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        description = self._description
        identity = {
            'guid': description.guid,
            'unzipDirectory': self._folder,
            'modelIdentifier': description.coSimulation.modelIdentifier,
            'instanceName': 'plant',
        }
        fmu = FMU3Slave(**identity) if self._three else FMU2Slave(**identity)
        fmu.instantiate()
        if self._three:
            fmu.enterInitializationMode(startTime=0.0)
        else:
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        return fmu

    def values(self) -> np.ndarray:
        """
        Return counts, two line currents an axis, positions and speeds; see `parts`.

        Raises `UserError` if the FMU does not give them, or not as finite numbers.
        """
        try:
            for getter, present, outputs in self._outputs:
                self._shown[present] = getattr(self._fmu, getter)(outputs)
        except Exception as error:
            raise UserError(f'--plant {self.file} gives no outputs: {error}') from error
        if not np.isfinite(self._shown).all():
            place = int(np.flatnonzero(~np.isfinite(self._shown))[0])
            raise UserError(
                f'--plant {self.file}: its {self._variables[place].name} is not finite'
            )
        return self._shown

    def parts(self, values: np.ndarray) -> list[np.ndarray]:
        """Return `values` as counts, line currents, positions and speeds."""
        axes, encoders = len(self._layout.axes), len(self._layout.encoders)
        return np.split(values, (encoders, encoders + 2 * axes, encoders + 3 * axes))

    def step(self, tick: int, voltage: np.ndarray, mask: int) -> None:
        """Advance by a tick with voltages (3 axes,) and the mask of open bridges; raises `UserError`."""
        time_s = self._timing.seconds(tick)
        opened = [float(mask >> axis & 1) for axis in range(len(self._layout.axes))]
        values = np.concatenate([voltage, opened])
        try:
            if self._inputs:
                write = self._fmu.setFloat64 if self._three else self._fmu.setReal
                write(self._inputs, values[self._taken].tolist())
            ended = self._fmu.doStep(
                currentCommunicationPoint=time_s, communicationStepSize=self._timing.tick_s
            )
        except Exception as error:
            raise UserError(f'--plant {self.file} failed at {time_s:.6g} s: {error}') from error
        if self._three and (ended[1] or ended[2]):
            how = (
                'asks to end the simulation' if ended[1] else 'returned before the end of the tick'
            )
            raise UserError(f'--plant {self.file} {how} at {time_s:.6g} s')

    def reset(self) -> None:
        """Begin anew at time 0."""
        self._end()
        self._fmu = self._instantiated()

    def _end(self) -> None:
        fmu = self.__dict__.pop('_fmu', None)
        if fmu is not None:
            with contextlib.suppress(Exception):
                fmu.terminate()
                fmu.freeInstance()

    def close(self) -> None:
        """End the FMU and remove what was unpacked of it."""
        self._end()
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)


@contextlib.contextmanager
def foreign_plant(
    file: Path, mapping: Names, timing: Timing, layout: Layout = SHIPPED
) -> Iterator[ForeignPlant]:
    """Give an FMU that is closed in the end; raises `UserError`."""
    plant = ForeignPlant(file, mapping, timing, layout)
    try:
        yield plant
    finally:
        plant.close()
