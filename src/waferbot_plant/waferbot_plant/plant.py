# SPDX-License-Identifier: Apache-2.0
"""
The plant as the rest of the twin sees it: load a machine, measure it, advance it by a tick.

    machine = load_machine('rigid')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    measure(state, parameters, tick, counts, line_currents)
    advance(state, parameters, voltage)

State and parameters are structured arrays of one element; `measure` and `advance` are compiled for
their dtypes at the first call and kept on disk. Arrays in them are longer than what a machine has
(see `room`): the first so many entries are in use.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.marked_yaml import Document, read
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.timing import Timing
from waferbot_plant import (
    bearing_loads,
    current_sensors,
    disturbances,
    elements,
    encoders,
    friction_laws,
    integrator,
    motors,
    multibody,
    payload,
    room,
    spring_laws,
)
from waferbot_plant.assembly import Assembly, Element, assemble
from waferbot_plant.description import LAGRANGE, Description
from waferbot_plant.description_file import load_description
from waferbot_plant.lagrange.closed_loop import advance_lagrange
from waferbot_plant.lagrange.from_description import check_lagrange, mathematical_parameters
from waferbot_plant.lagrange.parameters import PARAMETERS as LAGRANGE_PARAMETERS

ABSURD = 1e5
"""A position (m, rad) or speed (m/s, rad/s) above this is a simulation that blew up."""

_LOOK_AGAIN = 64


@compiled
def measure(state, parameters, tick, counts, line_currents):
    """
    Measure the machine at tick `tick`.

    `counts` int64 (encoders,) is written on encoder ticks only, with the counts of `delay_cycles`
    encoder ticks ago; call it for every tick, in order. `line_currents` float64 (2 axes,): lines 1 and 2
    of each motor as its sensors show them, A, positive into the motor. Places of axes that the machine
    does not have are zero.
    """
    s = state[0]
    p = parameters[0]
    encoders.measure_counts(s, p, tick, counts)
    current_sensors.measure_currents(s, p, tick, line_currents)


@compiled
def find_imperfections(s, p):
    """
    Find which parts of the model the parameters ask for: laws of friction and of springs.

    `advance` does so at the start of a run and then at least every 64 ticks, which is when a change
    of these parameters in a running machine is noticed; a plain machine does not pay for looking.
    """
    friction_laws.find_friction_laws(s, p)
    spring_laws.find_spring_laws(s, p)


@compiled
def advance(state, parameters, voltage):
    """
    Advance the machine by one tick.

    `voltage` float64 (3 axes,): terminals 1, 2, 3 of each motor against the middle of the bus, V, held
    over the tick. Any common reference will do: only differences within a motor matter.
    """
    s = state[0]
    p = parameters[0]
    if s['steps'] & (_LOOK_AGAIN - 1) == 0:
        find_imperfections(s, p)
    if p['disturbances'] > 0:
        disturbances.draw_noise(s, p)
    if p['lagrangian']:
        for _ in range(p['substeps']):
            advance_lagrange(s, p, voltage, p['step'])
        return
    for _ in range(p['substeps']):
        integrator.advance_step(s, p, voltage, p['step'])


@compiled
def joint_positions(state, parameters, position, velocity):
    """Fill `position` and `velocity` (axes,) of the axes, m or rad, and per s; zero if missing."""
    s = state[0]
    p = parameters[0]
    for axis in range(len(position)):
        coordinate = p['axis_coordinate'][axis]
        position[axis] = p['axis_ratio'][axis] * s['position'][coordinate]
        velocity[axis] = p['axis_ratio'][axis] * s['velocity'][coordinate]


@compiled
def runaway(state):
    """
    Return the coordinate (place in z) whose position or speed no machine can have, -1 if all are
    sound.

    That is a value that is not finite, or above `ABSURD` (m, rad, m/s, rad/s); the largest one
    where there are several. Meant to be asked every few milliseconds: it says that the simulation
    blew up, so that nothing made of such values is taken for a result.
    """
    s = state[0]
    found = -1
    largest = ABSURD
    for row in range(len(s['position'])):
        value = max(abs(s['position'][row]), abs(s['velocity'][row]))
        if not np.isfinite(s['position'][row] + s['velocity'][row]):
            return row
        if value > largest:
            found, largest = row, value
    return found


@compiled
def mass_matrix(state, parameters, matrix):
    """Fill the symmetric `matrix` (n, n) with M at the present pose, kg, kg m, kg m2."""
    s = state[0]
    multibody.mass_matrix_and_bias(s, parameters[0], s['position'], s['velocity'])
    for row in range(len(matrix)):
        for column in range(row + 1):
            matrix[row, column] = matrix[column, row] = s['mass_matrix'][row, column]


@compiled
def generalised_forces(state, parameters, result):
    """
    Fill `result` (n,) with the forces on z at the present state, N or Nm.

    Of springs, dampers, cables, gravity, Coriolis and centrifugal effects, and disturbances; not of
    dry friction, motors, a vibrating floor and `external_force`.
    """
    s = state[0]
    p = parameters[0]
    multibody.mass_matrix_and_bias(s, p, s['position'], s['velocity'])
    for row in range(len(result)):
        result[row] = -s['bias'][row]
    spring_laws.find_spring_laws(s, p)
    elements.subtract_instant_forces(s, p, s['position'], s['velocity'], result)
    disturbances.add_instant_disturbances(s, p, s['position'], s['velocity'], result)


@compiled
def acceleration(state, parameters, force, result):
    """
    Fill `result` (n,) with z'' at the present state under `force` (n,), N or Nm, and the forces
    above.

    This is the instant's equation of motion, for comparison with other engines; `advance` does not
    use it.
    """
    s = state[0]
    p = parameters[0]
    generalised_forces(state, parameters, result)
    size = p['coordinates']
    for row in range(size):
        result[row] += force[row]
        for column in range(row + 1):
            s['factors'][row, column] = s['mass_matrix'][row, column]
    multibody.factorise(s['factors'], size)
    multibody.solve(s['factors'], result, size)


@compiled
def energy(state, parameters, result):
    """
    Fill `result` (4,) with the stored energies, J: kinetic, gravity, elastic, magnetic.

    Gravity is zero with every body at the base origin, springs and cables where they are unloaded.
    Elastic includes the potential of periodic disturbances and the bristles of friction.
    """
    s = state[0]
    p = parameters[0]
    multibody.mass_matrix_and_bias(s, p, s['position'], s['velocity'])
    result[0] = multibody.kinetic_energy(s, p, s['velocity'])
    result[1] = multibody.gravity_energy(s, p)
    spring_laws.find_spring_laws(s, p)
    result[2] = elements.elastic_energy(s, p, s['position'])
    result[2] += disturbances.stored_in_periodic(p, s['position'])
    result[2] += friction_laws.stored_in_bristles(s, p)
    result[3] = motors.magnetic_energy(s, p)


@dataclass(frozen=True)
class Machine:
    """A machine that was loaded: its description, its assembly, and how it lies in memory."""

    description: Description
    assembly: Assembly
    timing: Timing

    @property
    def layout(self) -> Layout:
        """The axes and encoders, in the order of their places."""
        return self.description.layout

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the minimal coordinates, in order."""
        return self.assembly.coordinates

    @cached_property
    def in_use(self) -> dict[str, int]:
        """Numbers of the machine's parts."""
        return {
            'links': len(self.assembly.links),
            'coordinates': len(self.coordinates),
            'springs': len(self.assembly.springs),
            'cables': len(self.assembly.cables),
            'frictions': len(self.description.frictions),
        }

    @cached_property
    def parameter_dtype(self) -> np.dtype:
        """Dtype of the parameters."""
        return _parameter_dtype(self.layout, **room.lengths(self.in_use))

    @cached_property
    def state_dtype(self) -> np.dtype:
        """Dtype of the state, which includes the ledgers of energy and the step's workings."""
        return _state_dtype(self.layout, **room.lengths(self.in_use))

    def parameters(self) -> NDArray[np.void]:
        """Return the parameters, a structured array of one element that is the caller's to change."""
        return self._parameters.copy()

    @cached_property
    def _parameters(self) -> NDArray[np.void]:
        parameters = np.zeros(1, self.parameter_dtype)
        p = parameters[0]
        description = self.description
        p['substeps'] = description.substeps
        p['step'] = self.timing.tick_s / description.substeps
        for part, number in self.in_use.items():
            p[part] = number
        if description.formulation == LAGRANGE:
            check_lagrange(description, self.coordinates)
            p['lagrangian'] = 1
            p['lagrange'] = mathematical_parameters(description)
        self._fill_mechanism(p)
        self._fill_payload(p)
        self._fill_elements(p)
        self._fill_disturbances(p)
        for place, axis in enumerate(self.layout.axes):
            if axis in description.axes:
                row, ratio = self._placing(description.axes[axis])
                p['axis_coordinate'][place], p['axis_ratio'][place] = row, ratio
            if axis in description.motors:
                motor = description.motors[axis]
                row, ratio = self._placing(motor.coordinate)
                p['motor_coordinate'][place], p['motor_ratio'][place] = row, ratio
                fill_place(p, place, motors.motor_data(motor))
            if axis in description.current_sensors:
                sensors = description.current_sensors[axis]
                fill_place(p, place, current_sensors.sensor_data(sensors))
        for place, place_name in enumerate(self.layout.encoders):
            if place_name in description.encoders:
                encoder = description.encoders[place_name]
                row, ratio = self._placing(encoder.coordinate)
                p['encoder_coordinate'][place] = row
                data = encoders.encoder_data(
                    encoder, ratio, description.encoder_delay, self.timing.encoder_hz
                )
                fill_place(p, place, data)
        p['encoder_divider'] = self.timing.encoder_divider
        return parameters

    def _placing(self, coordinate: str) -> tuple[int, float]:
        """Return where a coordinate of the description is in z, and its ratio."""
        return self.assembly.placing[coordinate]

    def _fill_mechanism(self, p: np.void) -> None:
        """Write the links."""
        assembly = self.assembly
        p['gravity'] = self.description.gravity
        p['rotor_inertia'][: len(self.coordinates)] = assembly.rotor_inertia
        for place, link in enumerate(assembly.links):
            parent_point = assembly.links[link.parent].point if link.parent >= 0 else np.zeros(3)
            inertia = link.inertia
            p['parent'][place] = link.parent + 1
            p['revolute'][place] = link.freedom.revolute
            p['axis'][place] = link.freedom.axis
            p['offset'][place] = link.point - parent_point
            p['mass'][place] = link.mass
            p['first_moment'][place] = link.first_moment
            p['inertia'][place] = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            p['coordinate'][place], p['ratio'][place] = self._placing(link.freedom.name)

    def _fill_payload(self, p: np.void) -> None:
        """Write where the payload frame is; a body that stands still has none."""
        description, links = self.description, self.assembly.links
        p['payload_axes'] = -1
        for place, axis in enumerate(self.layout.axes):
            if axis in description.axes:
                p['payload_axes'][place] = self._placing(description.axes[axis])[0]
        if description.payload is None:
            return
        link = self.assembly.link_of[description.payload.body]
        if link >= 0:
            p['payload_link'] = link + 1
            p['payload_offset'] = description.payload.at - links[link].point

    def _fill_elements(self, p: np.void) -> None:
        """Write springs, cables and frictions."""
        _fill_two_sided(p, 'spring', self.assembly.springs)
        _fill_two_sided(p, 'cable', self.assembly.cables)
        p['spring_slack_force'] = p['spring_slip'] = np.inf
        p['spring_slack_slope'] = 1.0
        for place, spring in enumerate(self.assembly.springs):
            for name, value in spring.law.items():
                p[f'spring_{name}'][place] = value
            if spring.curve is not None:
                points = len(spring.curve.forces)
                p['spring_curve_points'][place] = points
                p['spring_curve_deflection'][place, :points] = spring.curve.deflections
                p['spring_curve_force'][place, :points] = spring.curve.forces
                p['spring_curve_slope'][place, :points] = spring.curve.slopes
        p['friction_points'] = p['friction_loads'] = 1
        for place, friction in enumerate(self.description.frictions.values()):
            points, loads = len(friction.speeds), len(friction.loads)
            coordinate, ratio = self._placing(friction.coordinate)
            p['friction_coordinate'][place], p['friction_ratio'][place] = coordinate, ratio
            p['friction_points'][place] = points
            p['friction_speed'][place, :points] = friction.speeds
            p['friction_loads'][place] = loads
            p['friction_load'][place, :loads] = friction.loads
            p['friction_resistance'][place, :loads, :points] = friction.resistances
            p['friction_breakaway'][place] = friction.breakaway
            for name, value in friction.law.items():
                p[f'friction_{name}'][place] = value
            if friction.bearing is not None:
                springs = {
                    spring.name: row
                    for row, spring in enumerate(self.assembly.springs)
                    if spring.connections
                }
                p['friction_bearing'][place] = friction.bearing.together
                for slot, amount in enumerate(friction.bearing.amounts):
                    p['friction_bearing_spring'][place, slot] = springs.get(amount.freedom, -1)
                    p['friction_bearing_share'][place, slot] = amount.share
                    p['friction_bearing_static'][place, slot] = amount.static

    def _fill_disturbances(self, p: np.void) -> None:
        """Write the forces from outside and the floor."""
        description = self.description
        p['disturbances'] = len(description.disturbances)
        p['disturbance_points'] = 1
        for slot, force in enumerate(description.disturbances.values()):
            row, ratio = self._placing(force.coordinate)
            points = len(force.at)
            values = {
                'kind': disturbances.KINDS.index(force.kind),
                'coordinate': row,
                'ratio': ratio,
                'constant': force.constant,
                'cosine': force.cosine,
                'sine': force.sine,
                'wave': force.wave_number,
                'rms': force.rms,
                'pole': np.exp(-2.0 * np.pi * force.bandwidth * self.timing.tick_s),
                'seed': force.seed,
                'points': points,
            }
            for name, value in values.items():
                p[f'disturbance_{name}'][slot] = value
            p['disturbance_at'][slot, :points] = force.at
            p['disturbance_value'][slot, :points] = force.values
        p['vibration_acceleration'] = description.vibration.acceleration
        p['vibration_frequency'] = description.vibration.frequency
        p['vibration_phase'] = description.vibration.phase

    def initial_state(
        self,
        parameters: NDArray[np.void],
        positions: Mapping[str, float] | None = None,
        holding: bool = False,
    ) -> NDArray[np.void]:
        """
        Return a state at rest, with the encoders' history filled with it.

        At home, or with the axes at `positions` (axis name to m or rad) and everything that gives
        in static equilibrium. Without `holding` no current flows, and the machine begins to fall
        where gravity moves an axis; with it the windings carry the currents that hold the axes.
        """
        state = np.zeros(1, self.state_dtype)
        state['winding_temperature'] = parameters['start_temperature']
        if positions or holding:
            from waferbot_plant.statics import settle

            settle(self, state, parameters, positions or {}, holding)
        fill_readings(state, parameters)
        return state

    def runaway_message(self, coordinate: int, tick: int) -> str:
        """Return the error for the user when `runaway` found a coordinate, naming axis and tick."""
        name = self.coordinates[coordinate]
        axes = [
            axis
            for axis, own in self.description.axes.items()
            if self._placing(own)[0] == coordinate
        ]
        what = f'axis {axes[0]}' if axes else f'coordinate {name}'
        return (
            f'the plant blew up by tick {tick} ({self.timing.seconds(tick):.4f} s): {what} has a '
            f'position or speed that is not finite or above {ABSURD:g}; the closed loop is '
            'unstable (gains, damping), or the description needs more substeps'
        )

    def at_rest(self) -> tuple[NDArray[np.void], NDArray[np.void]]:
        """Return `resting_state` and the parameters, the caller's to change; found once."""
        return self._resting_state.copy(), self.parameters()

    @cached_property
    def _resting_state(self) -> NDArray[np.void]:
        return self.resting_state(self._parameters)

    def resting_state(self, parameters: NDArray[np.void]) -> NDArray[np.void]:
        """
        Return the state in which a run begins: at rest at home, held by the motors' currents.

        A machine that its motors cannot hold (one with a free joint) begins at home without
        currents.
        """
        from waferbot_plant.statics import NoEquilibrium

        try:
            return self.initial_state(parameters, holding=True)
        except NoEquilibrium:
            return self.initial_state(parameters)


@functools.cache
def _parameter_dtype(
    layout: Layout, links: int, coordinates: int, springs: int, cables: int, frictions: int
) -> np.dtype:
    """Return the dtype of the parameters of machines in a room."""
    return np.dtype(
        [
            ('step', 'f8'),
            ('substeps', 'i8'),
            *room.PARAMETER_FIELDS,
            *multibody.parameter_fields(links, coordinates),
            *elements.parameter_fields(springs, cables, frictions),
            *friction_laws.parameter_fields(frictions),
            *bearing_loads.parameter_fields(frictions),
            *spring_laws.parameter_fields(springs),
            *motors.parameter_fields(len(layout.axes)),
            *encoders.parameter_fields(len(layout.encoders)),
            *current_sensors.parameter_fields(len(layout.axes)),
            ('axis_coordinate', 'i8', (len(layout.axes),)),
            ('axis_ratio', 'f8', (len(layout.axes),)),
            *payload.parameter_fields(len(layout.axes)),
            ('lagrangian', 'i8'),
            ('lagrange', LAGRANGE_PARAMETERS, (1,)),
            *disturbances.PARAMETER_FIELDS,
        ],
        align=True,
    )


@functools.cache
def _state_dtype(
    layout: Layout, links: int, coordinates: int, springs: int, cables: int, frictions: int
) -> np.dtype:
    """Return the dtype of the state of machines in a room."""
    return np.dtype(
        [
            *integrator.state_fields(coordinates),
            *motors.state_fields(len(layout.axes)),
            *encoders.state_fields(len(layout.encoders)),
            *elements.state_fields(springs, cables, frictions, coordinates),
            *multibody.workspace_fields(links, coordinates),
            *disturbances.state_fields(coordinates),
            *friction_laws.state_fields(frictions, coordinates),
            *spring_laws.state_fields(springs),
        ],
        align=True,
    )


def fill_readings(state: NDArray[np.void], parameters: NDArray[np.void]) -> None:
    """Fill the encoders' history as if the machine had always stood where it is."""
    encoders.fill_readings(state[0], parameters[0])


def fill_place(p: np.void, place: int, values: Mapping[str, Any]) -> None:
    """Write the parameters of one axis or encoder, by name, into its place."""
    for name, value in values.items():
        p[name][place] = value


def _fill_two_sided(p: np.void, kind: str, two_sided: Sequence[Element]) -> None:
    """Write springs or cables; one that acts on a single coordinate has that one twice."""
    for place, element in enumerate(two_sided):
        (first, first_ratio), (second, second_ratio) = [
            *element.terms,
            (element.terms[0][0], 0.0),
        ][:2]
        values = {
            'first': first,
            'second': second,
            'first_ratio': first_ratio,
            'second_ratio': second_ratio,
            'stiffness': element.stiffness,
            'damping': element.damping,
            'rest': element.rest,
        }
        for name, value in values.items():
            p[f'{kind}_{name}'][place] = value


def config_folder() -> Path:
    """Return the folder of the descriptions that come with the package."""
    return package_data('waferbot_plant', 'config')


def find_description(name_or_path: str | Path) -> Path:
    """Return the file of a description, given by path or by the name of one in the package."""
    path = Path(name_or_path)
    if path.suffix in ('.yaml', '.yml') or path.parent != Path('.'):
        if not path.is_file():
            raise UserError(f'{path}: no such machine description')
        return path
    known = _shipped_descriptions()
    if str(name_or_path) not in known:
        hint = did_you_mean(str(name_or_path), known)
        raise UserError(
            f'no machine {str(name_or_path)!r}{hint} (there are: {", ".join(sorted(known))}; '
            'or give the path of a .yaml file)'
        )
    return known[str(name_or_path)]


def description_names() -> list[str]:
    """Return the names of the descriptions in the package."""
    return sorted(_shipped_descriptions())


def _shipped_descriptions() -> dict[str, Path]:
    folder = config_folder()
    return {
        file.stem: file
        for file in [*folder.glob('examples/*.yaml'), *folder.glob('*.yaml')]
        if 'joints:' in file.read_text('utf-8') or 'extends:' in file.read_text('utf-8')
    }


def description_source(name_or_path: str | Path) -> Path | str:
    """Return the file of a description, or the description itself if it is given as text."""
    text = str(name_or_path)
    return text if '\n' in text else find_description(name_or_path)


def load_machine(
    name_or_path: str | Path = 'flexible',
    switches: Mapping[str, str] | str | None = None,
    damping: str = 'improved',
    overlays: Sequence[str | Path | Mapping] = (),
    timing: Timing | None = None,
) -> Machine:
    """
    Load a machine by the name of a description that comes with the package, or by its path.

    Text with line breaks is taken as the description itself, as a recording holds it.

    `timing` gives the length of a tick and how many lie between two readings of the encoders.
    `switches` makes connections `rigid` or `flexible`, all or by name; `damping` is `calculated`
    or `improved`; `overlays` are files or mappings laid over the description in turn. Raises
    `UserError`.
    """
    documents = tuple(
        Document(dict(overlay), {(): ('overlay', 1)})
        if isinstance(overlay, Mapping)
        else read(Path(overlay))
        for overlay in overlays
    )
    source = description_source(name_or_path)
    description = load_description(source, switches, damping, documents)
    return Machine(description, assemble(description), timing or Timing())
