# SPDX-License-Identifier: Apache-2.0
"""
The machine as data: what a description file says, checked, in SI units.

A description is a YAML file of bodies, joints, rotors, transmissions, connections, friction,
motors and encoders; `description.schema.json` is its grammar, and units are in the keys.
Positions, axes and inertia tensors are given in the base frame (y up) at the **home pose**, in
which every coordinate is zero; so no chain of frames has to be worked out by hand.

- A **joint** lets a child body move against its parent, through freedoms one after another. A
  freedom `held_by` connections is no axis of the machine but the give of a part.
- A **transmission** ties two coordinates together by a ratio: gear, belt, cable over a pulley.
- A **connection** is the elastic part in a joint or in a stage of a transmission. Where its state
  is `rigid` it does not give; a freedom all of whose connections are rigid does not exist. `held`
  is as stiff as that, but the freedom stays in the model and stands still (see `constraints`).
- A **rotor** is an inertia that spins about its own axis, driven through a transmission. As in the
  thesis (2.21) and in one-dimensional drive-train models it carries only the energy
  J * speed^2 / 2 of its own coordinate: the turning of the body that it is mounted on is not felt
  by it. Model it as a body on a revolute joint where that matters.

A file may say `extends: other.yaml` and then gives only what differs; a value of `null` takes away
what the other file has (`frictions: null` makes a machine frictionless), and it is an error to
take away what is not there.

A quantity may carry where it comes from, `{value: 3.1, from: ...}`, and may have two values,
`{calculated: 0.008, improved: 0.02, from: ...}`: the damping that follows from part data, and the
one that makes the machine behave as measured (thesis, chapter 6).
"""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import yaml
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Document, Key, key_text, merge, parse, read
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant import imperfections, part_library
from waferbot_plant.imperfections import Disturbance, TransmissionError, Vibration
from waferbot_plant.part_library import Carried

Vector = NDArray[np.float64]

LONGEST_DELAY = 15
"""Longest delay of an encoder that the plant's history of readings can hold, in phase cycles."""

BASE = 'base'
"""Name of the body that does not move."""

DAMPING = ('calculated', 'improved')
"""The two sets of loss factors and friction; see the thesis, chapter 6."""

STATES = ('held', 'rigid', 'flexible')
"""What a connection can be."""

_SCHEMA = json.loads(Path(__file__).with_name('description.schema.json').read_text('utf-8'))
_SECTION_SCHEMA = {
    name: jsonschema.Draft202012Validator({'$defs': _SCHEMA['$defs'], **schema})
    for name, schema in _SCHEMA['properties'].items()
}
_BY_ENTRY = frozenset(
    name
    for name, schema in _SCHEMA['properties'].items()
    if set(_SCHEMA['$defs'].get(schema.get('$ref', '').rpartition('/')[2], schema))
    <= {'type', 'propertyNames', 'additionalProperties', 'minProperties', 'description'}
)
"""Sections that are valid if there are entries and each of them is."""

_UNITS = {False: ('m', 'n', 'n_m', 'n_s_m'), True: ('rad', 'nm', 'nm_rad', 'nm_s_rad')}


@dataclass(frozen=True)
class Body:
    """A rigid body: mass in kg, centre of gravity in m, tensor about it in kg m2 (base frame)."""

    name: str
    mass: float
    centre_of_gravity: Vector
    inertia: Vector

    def equivalent_box(self) -> tuple[Vector, Vector]:
        """
        Return the box that has this mass and these moments of inertia: sides (m), axes (columns).

        A box of sides a, b, c has the moments m (b^2 + c^2) / 12, and so on. The axes are
        right-handed principal axes.
        """
        moments, axes = np.linalg.eigh(self.inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        squares = 6.0 * (moments.sum() - 2.0 * moments) / self.mass
        return np.sqrt(np.maximum(squares, 1e-6)), axes


@dataclass(frozen=True)
class Freedom:
    """One freedom of a joint: slide (m) along, or turn (rad) about, the unit vector `axis`."""

    name: str
    revolute: bool
    axis: Vector
    connections: tuple[str, ...]


@dataclass(frozen=True)
class Joint:
    """The freedoms between two bodies; all of them act at the point `at`, m, base frame."""

    name: str
    parent: str
    child: str
    at: Vector
    freedoms: tuple[Freedom, ...]


@dataclass(frozen=True)
class Rotor:
    """
    An inertia in kg m2 that spins about its own axis.

    Its angle is the coordinate `coordinate`: one of its own name, or one that it shares.
    """

    name: str
    inertia: float
    coordinate: str


@dataclass(frozen=True)
class Stage:
    """
    One stage of a transmission.

    `ratio` is motion out over motion in. `lever` turns a unit of the stage's motion out into the
    deflection in which its connection states its stiffness: 1, or for a belt the radius (m) of the
    driven pulley, because a belt is stretched in metres.
    """

    kind: str
    ratio: float
    lever: float
    connection: str | None


@dataclass(frozen=True)
class Transmission:
    """The coordinate `driven` follows `driving` times the product of the stages' ratios."""

    name: str
    driving: str
    driven: str
    stages: tuple[Stage, ...]
    error: TransmissionError | None = None

    @property
    def ratio(self) -> float:
        """Motion of the driven coordinate over motion of the driving one."""
        return math.prod(stage.ratio for stage in self.stages)

    @property
    def pulls_only(self) -> bool:
        """Whether it can pull only: a cable does not push."""
        return any(stage.kind == 'cable' for stage in self.stages)


@dataclass(frozen=True)
class Connection:
    """
    An elastic part: stiffness in N/m or Nm/rad, and its damping.

    Damping is either viscous (`damping`, N s/m or Nm s/rad) or structural (`loss_factor`), which
    becomes an equivalent viscous one at the part's first natural frequency, eq. (5.5). In that,
    the coordinates `free` may follow; in a joint, all others are held.

    One that is neither `flexible` nor `held` is rigid. The rest is what makes it more than a
    linear spring, in its own unit (see `spring_laws`): whole `gap` in m or rad, `hardening` in 1/m2
    or 1/rad2, `slip` in N or Nm, a belt's `slack_preload` per strand in N; of a cable, `slack` in m
    beyond home, and `rope_mass` in kg. None: never.
    """

    name: str
    flexible: bool
    rotary: bool
    stiffness: float
    damping: float | None
    loss_factor: float | None
    free: tuple[str, ...]
    held: bool = False
    gap: float = 0.0
    hardening: float = 0.0
    slip: float | None = None
    slack_preload: float | None = None
    slack: float = 0.0
    rope_mass: float = 0.0


@dataclass(frozen=True)
class Friction:
    """
    Dry friction on a coordinate: resistance (N or Nm) over speed (m/s or rad/s), both from zero
    up.

    Between the points it is interpolated, outside them held constant. `breakaway` multiplies the
    resistance at speed zero to give the peak of static friction. `law` has the parameters of
    `friction_laws` by name; those not in it are zero.
    """

    name: str
    coordinate: str
    speeds: Vector
    resistances: Vector
    breakaway: float
    law: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Damper:
    """Viscous damping of a coordinate, N s/m or Nm s/rad, eq. (5.4)."""

    name: str
    coordinate: str
    damping: float


@dataclass(frozen=True)
class Motor:
    """
    A three-phase motor as its data sheet gives it: values from lead to lead.

    Resistance in ohm, inductance in H, `back_emf` the amplitude in V per m/s or rad/s,
    `electrical_gain` the electrical angle (rad) per m or rad of the coordinate. Imperfections, see
    `waferbot_plant.motors`: `saturation_current` in A, 0 for none; relative `phase_imbalance` of
    the windings 1 and 2.
    """

    axis: str
    coordinate: str
    winding: str
    resistance: float
    inductance: float
    back_emf: float
    electrical_gain: float
    heating: Heating | None
    saturation_current: float
    ripple: tuple[Ripple, ...]
    phase_imbalance: tuple[float, float]


@dataclass(frozen=True)
class Ripple:
    """Force and back-EMF times 1 + cosine cos(order theta) + sine sin(order theta), relative."""

    order: float
    cosine: float
    sine: float


@dataclass(frozen=True)
class Heating:
    """
    How a motor's windings warm up: one heat capacity on one resistance to the air about it.

    `to_air` in K/W, `capacity` in J/K, `air` and, of the windings, `start` in degC; the data sheet's
    winding resistance holds at `resistance_at` (degC) and rises by `coefficient` (1/K) of it. Copper
    has 0.00393 at 20 degC.
    """

    to_air: float
    capacity: float
    air: float
    resistance_at: float
    coefficient: float
    start: float


@dataclass(frozen=True)
class CyclicError:
    """An error of `amplitude` cos(2 pi x / `period` - `phase`); amplitude and period in one unit."""

    amplitude: float = 0.0
    period: float = 1.0
    phase: float = 0.0


@dataclass(frozen=True)
class EncoderErrors:
    """
    What is wrong with an encoder, none by default; see `waferbot_plant.encoders`.

    `scale` is relative; `eccentricity` in m or rad; `interpolation`, `coarseness`, `noise` (rms) and
    `lost_counts` in counts; `extra_delay` and `delay_fraction` in phase cycles; `lost_every` in m or
    rad, 0 where nothing is lost.
    """

    scale: float = 0.0
    eccentricity: CyclicError = CyclicError()
    interpolation: CyclicError = CyclicError()
    coarseness: float = 1.0
    extra_delay: int = 0
    delay_fraction: float = 0.0
    noise: float = 0.0
    noise_seed: int = 0
    lost_counts: float = 0.0
    lost_every: float = 0.0


@dataclass(frozen=True)
class Encoder:
    """An encoder at a place of the contract, in counts per m or per rad of a coordinate."""

    place: str
    coordinate: str
    counts_per_unit: float
    errors: EncoderErrors


@dataclass(frozen=True)
class CurrentSensors:
    """
    The errors of the current sensors of a motor, lines 1 and 2: relative gains; A; A rms.

    See `waferbot_plant.current_sensors`.
    """

    axis: str
    gains: tuple[float, float]
    offsets: tuple[float, float]
    noise: float
    noise_seed: int


@dataclass(frozen=True)
class Description:
    """A whole machine, checked. `revolute` tells for every coordinate whether it is an angle."""

    name: str
    gravity: Vector
    substeps: int
    encoder_delay: int
    bodies: Mapping[str, Body]
    joints: Mapping[str, Joint]
    rotors: Mapping[str, Rotor]
    transmissions: Mapping[str, Transmission]
    connections: Mapping[str, Connection]
    frictions: Mapping[str, Friction]
    dampers: Mapping[str, Damper]
    disturbances: Mapping[str, Disturbance]
    vibration: Vibration
    axes: Mapping[str, str]
    motors: Mapping[str, Motor]
    encoders: Mapping[str, Encoder]
    current_sensors: Mapping[str, CurrentSensors]
    parts: Mapping[str, Any]
    revolute: Mapping[str, bool]
    provenance: Mapping[str, str]


def whole_text(source: Path | str) -> str:
    """Return a description, given as for `load_description`, as the text of one YAML file."""
    return yaml.safe_dump(_read_whole(source).data, sort_keys=False)


def _read_whole(source: Path | str) -> Document:
    """Read a file with all that it extends, or the text of one that extends nothing."""
    if isinstance(source, Path):
        return _read_chain(source, ())
    document = parse(source, 'description')
    if not isinstance(document.data, dict):
        raise UserError('description: must be a mapping')
    if 'extends' in document.data:
        raise document.error(('extends',), 'a description given as text must be whole')
    return document


def load_description(
    source: Path | str,
    switches: Mapping[str, str] | str | None = None,
    damping: str = 'improved',
    overlays: tuple[Document, ...] = (),
) -> Description:
    """
    Read and check a description: a file, or the text of one.

    `switches` sets the state of connections, by name or for all at once; `damping` picks between
    two-valued quantities; `overlays` are laid over the file in turn. Raises `UserError` naming file,
    line and key.
    """
    document = _read_whole(source)
    for overlay in overlays:
        merge(document, overlay)
    _switch(document, switches)
    return check(document, damping)


def _read_chain(path: Path, seen: tuple[Path, ...]) -> Document:
    """Read a file over the one that it extends."""
    document = read(path)
    base_name = document.data.pop('extends', None)
    if base_name is None:
        return document
    if not isinstance(base_name, str):
        raise document.error(('extends',), 'must be the name of a description file')
    base_path = (path.parent / base_name).resolve()
    if base_path in seen or base_path == path.resolve():
        raise document.error(('extends',), f'{base_name} extends this file in turn')
    base = _read_chain(base_path, (*seen, path.resolve()))
    merge(base, document)
    return base


def _switch(document: Document, switches: Mapping[str, str] | str | None) -> None:
    """Set the states of connections."""
    connections = document.data.get('connections', {})
    if isinstance(switches, str):
        switches = dict.fromkeys(connections, switches)
    for name, state in (switches or {}).items():
        if name not in connections:
            raise UserError(f'no connection {name!r} to switch{did_you_mean(name, connections)}')
        if state not in STATES:
            raise UserError(
                f'connection {name}: state is {state!r}; it is held, rigid or flexible'
            )
        connections[name]['state'] = state


def check(document: Document, damping: str = 'improved') -> Description:
    """Check a document that was read, and return the description in it."""
    if damping not in DAMPING:
        raise UserError(f'damping is {damping!r}; it is one of {", ".join(DAMPING)}')
    provenance: dict[str, str] = {}
    data = {}
    for name, section in document.data.items():
        try:
            data[name], origins = _unwrapped(name, pickle.dumps(section), damping)
        except UserError:
            # said again, with the place in this document
            _unwrap(document, section, (name,), damping, {})
            raise
        provenance |= origins
    _check_grammar(document, data)
    return _Reader(document, data).description(provenance)


@lru_cache(maxsize=1024)
def _unwrapped(name: str, pickled: bytes, damping: str) -> tuple[Any, dict[str, str]]:
    """
    Return a section with plain values, not to be changed, and where they are from.

    A diagnosis checks thousands of descriptions that differ in a single section; what is the same
    is remembered.
    """
    provenance: dict[str, str] = {}
    nowhere = Document({})
    return _unwrap(nowhere, pickle.loads(pickled), (name,), damping, provenance), provenance


def _unwrap(
    document: Document, value: Any, key: Key, damping: str, provenance: dict[str, str]
) -> Any:
    """Replace every {value, from} and {calculated, improved, from} by its value; note `from`."""
    if isinstance(value, list):
        return [
            _unwrap(document, item, (*key, place), damping, provenance)
            for place, item in enumerate(value)
        ]
    if not isinstance(value, dict):
        if isinstance(value, float) and not math.isfinite(value):
            raise document.error(key, f'is {value}; it must be a finite number')
        return value
    keys = set(value)
    if 'value' in keys or keys & set(DAMPING):
        wanted = {'value'} if 'value' in keys else set(DAMPING)
        if keys - {'from'} != wanted:
            raise document.error(
                key, 'takes {value, from} or {calculated, improved, from}, not ' + ', '.join(keys)
            )
        if 'from' in keys:
            provenance[key_text(key)] = str(value['from'])
        part = 'value' if 'value' in keys else damping
        return _unwrap(document, value[part], (*key, part), damping, {})
    return {
        part: _unwrap(document, item, (*key, part), damping, provenance)
        for part, item in value.items()
    }


def _check_grammar(document: Document, data: dict[str, Any]) -> None:
    """Apply the JSON Schema and turn its first complaint into one line for the user."""
    if set(_SCHEMA['required']) <= set(data) <= set(_SECTION_SCHEMA) and all(
        _section_is_valid(name, pickle.dumps(section)) for name, section in data.items()
    ):
        return
    errors = jsonschema.Draft202012Validator(_SCHEMA).iter_errors(data)
    error = min(
        errors, key=lambda found: (len(found.absolute_path), str(found.path)), default=None
    )
    if error is None:
        return
    key = tuple(error.absolute_path)
    if error.validator == 'additionalProperties' and error.schema.get('properties'):
        known = error.schema['properties']
        unknown = sorted(set(error.instance) - set(known))[0]
        raise document.error((*key, unknown), f'unknown key{did_you_mean(unknown, known)}')
    if error.validator == 'required':
        missing = [name for name in error.validator_value if name not in error.instance]
        raise document.error(key, f'{" and ".join(missing)} missing')
    if error.parent is None and 'propertyNames' in error.absolute_schema_path:
        known = error.validator_value if error.validator == 'enum' else ()
        hint = f'; names here are {", ".join(known)}' if known else ''
        raise document.error((*key, error.instance), f'not a valid name{hint}')
    texts = {
        'exclusiveMinimum': 'must be greater than {}',
        'minimum': 'must be at least {}',
        'maximum': 'must be at most {}',
        'type': 'must be of type {}',
        'enum': 'must be one of {}',
        'minItems': 'must have at least {} entries',
        'maxItems': 'must have at most {} entries',
        'minProperties': 'must have at least {} entry',
    }
    rule = error.validator_value
    rule = ', '.join(map(str, rule)) if isinstance(rule, list) else rule
    text = texts.get(error.validator, error.message).format(rule)
    raise document.error(key, f'is {error.instance!r}; it {text}')


@lru_cache(maxsize=1024)
def _section_is_valid(name: str, pickled: bytes) -> bool:
    """Apply the part of the schema for one section; answers are remembered as above."""
    section = pickle.loads(pickled)
    if name in _BY_ENTRY and isinstance(section, dict) and section:
        return all(
            _entry_is_valid(name, pickle.dumps({key: entry})) for key, entry in section.items()
        )
    return bool(_SECTION_SCHEMA[name].is_valid(section))


@lru_cache(maxsize=4096)
def _entry_is_valid(name: str, pickled: bytes) -> bool:
    """Apply the part of the schema for one section to one with a single entry."""
    return bool(_SECTION_SCHEMA[name].is_valid(pickle.loads(pickled)))


class _Reader:
    """Turns checked data into the dataclasses and makes the checks that need physics."""

    def __init__(self, document: Document, data: dict[str, Any]) -> None:
        self.document = document
        self.data = data
        self.revolute: dict[str, bool] = {}
        self.held: set[str] = set()
        self.bodies: dict[str, Body] = {}
        self.joints: dict[str, Joint] = {}
        self.parts: dict[str, Any] = {}

    def section(self, name: str) -> dict[str, Any]:
        """Return a section of the file, empty if it is not there."""
        return self.data.get(name, {})

    def reference(self, key: Key, name: str, known: Mapping[str, Any], what: str) -> str:
        """Return `name` if it is among `known`."""
        if name not in known:
            hint = did_you_mean(name, known)
            raise self.document.error(key, f'there is no {what} {name!r}{hint}')
        return name

    def quantity(self, key: Key, revolute: bool, linear_name: str, rotary_name: str) -> Any:
        """Return the value under the one of two keys that has the unit of the coordinate."""
        values: Any = self.data
        for part in key:
            values = values[part]
        wanted, other = (rotary_name, linear_name) if revolute else (linear_name, rotary_name)
        if other in values:
            kind = 'an angle' if revolute else 'a length'
            raise self.document.error(
                (*key, other), f'wrong unit: the coordinate is {kind}; give {wanted}'
            )
        if wanted not in values:
            raise self.document.error(key, f'{wanted} missing')
        return values[wanted]

    def description(self, provenance: dict[str, str]) -> Description:
        """Read all sections, each after those that it refers to."""
        feedback = self.section('feedback')
        self.bodies = {name: self.body(name) for name in self.section('bodies')}
        self.joints = {name: self.joint(name) for name in self.section('joints')}
        self.check_tree()
        rotors = {name: self.rotor(name) for name in self.section('rotors')}
        self.parts = {
            name: part_library.read_part(self.document, ('parts', name), part)
            for name, part in self.section('parts').items()
        }
        transmissions = {name: self.transmission(name) for name in self.section('transmissions')}
        self.check_drives(transmissions)
        connections = {
            name: self.connection(name, transmissions) for name in self.section('connections')
        }
        axes = {axis: self.axis(axis) for axis in self.section('axes')}
        frictions, dampers = self.resistances()
        return Description(
            name=self.data['name'],
            gravity=np.array(self.data.get('gravity_m_s2', [0.0, -9.81, 0.0]), float),
            substeps=int(self.data.get('substeps', 1)),
            encoder_delay=int(feedback.get('delay_cycles', 1)),
            bodies=self.bodies,
            joints=self.joints,
            rotors=rotors,
            transmissions=transmissions,
            connections=connections,
            frictions=frictions,
            dampers=dampers,
            disturbances=imperfections.read_disturbances(self),
            vibration=imperfections.read_vibration(self),
            axes=axes,
            motors={axis: self.motor(axis) for axis in self.section('motors')},
            encoders={place: self.encoder(place) for place in self.section('encoders')},
            current_sensors={
                axis: self.current_sensors_of(axis) for axis in self.section('current_sensors')
            },
            parts=self.parts,
            revolute=self.revolute,
            provenance=provenance,
        )

    def axis(self, axis: str) -> str:
        """Return the coordinate of an axis of the contract."""
        coordinate = self.section('axes')[axis]
        return self.moving(('axes', axis), coordinate)

    def rotor(self, name: str) -> Rotor:
        """Read a rotor: one that is a coordinate, or one that goes with another coordinate."""
        value = self.data['rotors'][name]
        inertia = float(value['inertia_kg_m2'])
        if 'turns_with' not in value:
            if name in self.revolute:
                raise self.document.error(('rotors', name), 'a freedom has this name already')
            self.revolute[name] = True
            return Rotor(name, inertia, name)
        key = ('rotors', name, 'turns_with')
        coordinate = self.moving(key, value['turns_with'])
        if not self.revolute[coordinate]:
            raise self.document.error(
                key, f'{coordinate} is a length; a rotor turns with an angle'
            )
        return Rotor(name, inertia, coordinate)

    def body(self, name: str) -> Body:
        """Read a body; its tensor must be one that a distribution of mass can have."""
        if name == BASE:
            raise self.document.error(('bodies', name), 'base is the body that does not move')
        value = self.data['bodies'][name]
        tensor = value['inertia_kg_m2']
        xy, xz, yz = (tensor.get(part, 0.0) for part in ('xy', 'xz', 'yz'))
        inertia = np.array(
            [[tensor['xx'], xy, xz], [xy, tensor['yy'], yz], [xz, yz, tensor['zz']]], float
        )
        moments = np.linalg.eigvalsh(inertia)
        shown = ', '.join(f'{moment:.6g}' for moment in moments)
        key = ('bodies', name, 'inertia_kg_m2')
        if moments[0] <= 0.0:
            raise self.document.error(
                key, f'not positive definite: its principal moments are {shown} kg m2'
            )
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise self.document.error(
                key,
                f'no body has these principal moments, {shown} kg m2: '
                'each is at most the sum of the other two',
            )
        return Body(
            name, float(value['mass_kg']), np.array(value['centre_of_gravity_m'], float), inertia
        )

    def joint(self, name: str) -> Joint:
        """Read a joint with its freedoms."""
        value = self.data['joints'][name]
        key: Key = ('joints', name)
        self.reference((*key, 'parent'), value['parent'], {BASE: None, **self.bodies}, 'body')
        self.reference((*key, 'child'), value['child'], self.bodies, 'body')
        freedoms = []
        for freedom_name, freedom in value['freedoms'].items():
            freedom_key = (*key, 'freedoms', freedom_name)
            if freedom_name in self.revolute:
                raise self.document.error(freedom_key, 'another freedom has this name already')
            axis = np.array(freedom['axis'], float)
            length = math.sqrt(float(axis @ axis))
            if length == 0.0:
                raise self.document.error((*freedom_key, 'axis'), 'has no direction')
            self.revolute[freedom_name] = freedom['type'] == 'revolute'
            if 'held_by' in freedom:
                self.held.add(freedom_name)
            for place, connection in enumerate(freedom.get('held_by', ())):
                self.reference(
                    (*freedom_key, 'held_by', place),
                    connection,
                    self.section('connections'),
                    'connection',
                )
            freedoms.append(
                Freedom(
                    freedom_name,
                    freedom['type'] == 'revolute',
                    axis / length,
                    tuple(freedom.get('held_by', ())),
                )
            )
        return Joint(
            name, value['parent'], value['child'], np.array(value['at_m'], float), tuple(freedoms)
        )

    def check_tree(self) -> None:
        """Every body hangs on exactly one joint, and by joints on the base."""
        parents: dict[str, Joint] = {}
        for joint in self.joints.values():
            if joint.child in parents:
                raise self.document.error(
                    ('joints', joint.name, 'child'),
                    f'body {joint.child!r} is the child of joint {parents[joint.child].name!r} '
                    'already; close a loop by a transmission, not by a second joint',
                )
            parents[joint.child] = joint
        for body in self.bodies:
            if body not in parents:
                raise self.document.error(('bodies', body), 'no joint has this body as its child')
            seen = [body]
            while (above := parents[seen[-1]].parent) != BASE:
                if above in seen:
                    raise self.document.error(
                        ('joints', parents[above].name),
                        'joints run in a circle: ' + ' - '.join([*seen, above]),
                    )
                seen.append(above)

    def transmission(self, name: str) -> Transmission:
        """Read a transmission and its stages."""
        key: Key = ('transmissions', name)
        value = self.data['transmissions'][name]
        for end in ('driving', 'driven'):
            self.moving((*key, end), value[end])
        revolute = self.revolute[value['driving']]
        stages = []
        for place, stage in enumerate(value['stages']):
            stage_key = (*key, 'stages', place)
            kind = stage['kind']
            if (kind in ('gear', 'belt', 'rack')) != revolute and kind != 'coupling':
                raise self.document.error(
                    stage_key, f'a {kind} is driven by {"a length" if revolute else "an angle"}'
                )
            ratio, lever = 1.0, 1.0
            if kind == 'gear':
                ratio = 1.0 / (
                    self.part(stage_key, stage, part_library.Gearbox).ratio
                    if 'part' in stage
                    else stage['ratio']
                )
            elif kind == 'belt' and 'part' in stage:
                belt = self.part(stage_key, stage, part_library.Belt)
                ratio, lever = 1.0 / belt.ratio, belt.driven_pulley_radius_m
            elif kind == 'belt':
                lever = float(stage['driven_pulley_radius_m'])
                ratio = stage['driving_pulley_radius_m'] / lever
            elif kind == 'rack':
                ratio, revolute = float(stage['pinion_radius_m']), False
            elif kind == 'cable':
                ratio = -1.0
            connection = stage.get('connection')
            if connection is not None:
                known = self.section('connections')
                self.reference((*stage_key, 'connection'), connection, known, 'connection')
            stages.append(Stage(kind, ratio, lever, connection))
        if revolute != self.revolute[value['driven']]:
            kind = 'an angle' if revolute else 'a length'
            raise self.document.error(
                (*key, 'driven'), f'the last stage moves by {kind}, this coordinate does not'
            )
        transmission = Transmission(
            name,
            value['driving'],
            value['driven'],
            tuple(stages),
            imperfections.read_transmission_error(self, key, value),
        )
        if transmission.pulls_only and len(stages) > 1:
            raise self.document.error((*key, 'stages'), 'a cable must be a transmission by itself')
        return transmission

    def check_drives(self, transmissions: Mapping[str, Transmission]) -> None:
        """No coordinate is driven twice, none drives itself."""
        driver: dict[str, Transmission] = {}
        for transmission in transmissions.values():
            key = ('transmissions', transmission.name, 'driven')
            if transmission.driven in driver:
                other = driver[transmission.driven].name
                raise self.document.error(key, f'{other!r} drives this coordinate already')
            driver[transmission.driven] = transmission
            above = transmission.driving
            while above in driver and above != transmission.driven:
                above = driver[above].driving
            if above == transmission.driven:
                raise self.document.error(key, 'transmissions run in a circle')

    def part(self, key: Key, value: dict[str, Any], kind: type = object) -> Any:
        """Return the part that a value names, of the kind that is wanted there."""
        name = self.reference((*key, 'part'), value['part'], self.parts, 'part')
        if not isinstance(self.parts[name], kind):
            raise self.document.error((*key, 'part'), f'part {name} is of another kind')
        return self.parts[name]

    def carried_by(self, joint: Joint) -> Carried:
        """Return what hangs on a joint at home."""
        beyond = {joint.child}
        for _ in self.joints:
            beyond |= {other.child for other in self.joints.values() if other.parent in beyond}
        # In the order of the description: the order of a sum decides its last bit.
        bodies = [body for name, body in self.bodies.items() if name in beyond]
        mass = sum(body.mass for body in bodies)
        moment = np.zeros(3)
        for body in bodies:
            moment += body.mass * (body.centre_of_gravity - joint.at)
        return Carried(mass, float(moment[0] / mass), float(moment[2] / mass))

    def joint_with(self, key: Key, part_name: str) -> Joint:
        """Return the joint whose freedoms the connections of a part hold."""
        connections = {
            name
            for name, value in self.section('connections').items()
            if value.get('part') == part_name
        }
        for joint in self.joints.values():
            for freedom in joint.freedoms:
                if connections.intersection(freedom.connections):
                    return joint
        raise self.document.error(
            key, f'no connection puts part {part_name!r} in a joint, so its load is unknown'
        )

    def connection(self, name: str, transmissions: Mapping[str, Transmission]) -> Connection:
        """Read a connection; its unit follows from where it is used, which is in one place."""
        key: Key = ('connections', name)
        uses = [
            freedom.revolute
            for joint in self.joints.values()
            for freedom in joint.freedoms
            for held_by in freedom.connections
            if held_by == name
        ]
        stage_kind = None
        for transmission in transmissions.values():
            revolute = self.revolute[transmission.driving]
            for stage in transmission.stages:
                revolute = revolute and stage.kind != 'rack'
                if stage.connection == name:
                    uses.append(revolute and stage.kind != 'belt')
                    stage_kind = stage.kind
        if len(uses) != 1:
            raise self.document.error(
                key, f'is used in {len(uses)} places; a connection is one part in one place'
            )
        rotary = uses[0]
        value = self.data['connections'][name]
        free = tuple(
            self.moving((*key, 'first_frequency_with', place), coordinate)
            for place, coordinate in enumerate(value.get('first_frequency_with', ()))
        )
        flexible, held = value['state'] == 'flexible', value['state'] == 'held'
        law = imperfections.read_spring_law(self, key, rotary, stage_kind)
        if 'part' in value:
            stiffness, loss = self.stiffness_of_part(key, value, rotary)
            return Connection(name, flexible, rotary, stiffness, None, loss, free, held, **law)
        stiffness = float(self.quantity(key, rotary, 'stiffness_n_m', 'stiffness_nm_rad'))
        names = ('damping_n_s_m', 'damping_nm_s_rad')
        if ('loss_factor' in value) == any(damping in value for damping in names):
            raise self.document.error(key, f'give either loss_factor or {names[rotary]}')
        if 'loss_factor' in value:
            loss = float(value['loss_factor'])
            return Connection(name, flexible, rotary, stiffness, None, loss, free, held, **law)
        damping = float(self.quantity(key, rotary, *names))
        return Connection(name, flexible, rotary, stiffness, damping, None, free, held, **law)

    def stiffness_of_part(
        self, key: Key, value: dict[str, Any], rotary: bool
    ) -> tuple[float, float]:
        """Return stiffness and loss factor of a connection from the data of its part."""
        part = self.part(key, value)
        known = part_library.directions(part)
        direction = value.get('direction', '')
        if direction not in known:
            choice = ', '.join(known) if any(known) else 'none'
            raise self.document.error(
                key, f'direction is {direction!r}; part {value["part"]} has: {choice}'
            )
        try:
            stiffness, is_rotary = part_library.stiffness(
                part, direction, lambda: self.carried_by(self.joint_with(key, value['part']))
            )
        except UserError as error:
            raise self.document.error(key, str(error)) from None
        if is_rotary != rotary:
            raise self.document.error(
                key,
                f'{direction or "this stiffness"} is {"rotary" if is_rotary else "linear"}; '
                'where the connection is used, it is not',
            )
        loss = value.get('loss_factor', getattr(part, 'loss_factor', None))
        if loss is None:
            raise self.document.error(
                key, f'part {value["part"]} states no loss; give loss_factor'
            )
        return stiffness, float(loss)

    def moving(self, key: Key, name: str) -> str:
        """Return the name of a coordinate that moves freely, not one that connections hold."""
        self.reference(key, name, self.revolute, 'coordinate')
        if name in self.held:
            raise self.document.error(
                key, f'{name} is held by connections; it is no coordinate when they are rigid'
            )
        return name

    def coordinate(self, key: Key, value: dict[str, Any]) -> tuple[str, bool]:
        """Return the coordinate that an element acts on, and whether it is an angle."""
        name = self.moving((*key, 'coordinate'), value['coordinate'])
        return name, self.revolute[name]

    def resistances(self) -> tuple[dict[str, Friction], dict[str, Damper]]:
        """Read frictions and dampers; what a part's friction gains with speed is a damper."""
        dampers = {name: self.damper(name) for name in self.section('dampers')}
        frictions = {}
        for name, value in self.section('frictions').items():
            if 'part' not in value:
                frictions[name] = self.friction(name)
                continue
            key: Key = ('frictions', name)
            if name in dampers:
                raise self.document.error(key, 'a damper has this name already')
            coordinate, _ = self.coordinate(key, value)
            found = self.friction_of_part(key, value)
            factor = value.get('factor', 1.0)
            frictions[name] = Friction(
                name,
                coordinate,
                np.zeros(1),
                np.array([factor * found.coulomb_nm]),
                float(value.get('breakaway', 1.0)),
                imperfections.read_friction_law(self, key, self.revolute[coordinate]),
            )
            if found.viscous_nm_s_per_rad > 0.0:
                dampers[name] = Damper(name, coordinate, factor * found.viscous_nm_s_per_rad)
        return frictions, dampers

    def friction_of_part(self, key: Key, value: dict[str, Any]) -> part_library.SpeedFriction:
        """Return the friction that a part makes."""
        part = self.part(key, value)
        other = None
        if 'with' in value:
            self.reference((*key, 'with'), value['with'], self.parts, 'part')
            other = self.parts[value['with']]

        def carried() -> Carried:
            if isinstance(part, part_library.YRotateBearings):
                return self.carried_by(self.joint_of(key, value['coordinate']))
            loaded = value['with'] if isinstance(part, part_library.FerrofluidSeal) else None
            return self.carried_by(self.joint_with(key, loaded or value['part']))

        try:
            return part_library.friction(part, other, carried)
        except UserError as error:
            raise self.document.error(key, str(error)) from None

    def joint_of(self, key: Key, coordinate: str) -> Joint:
        """Return the joint that a coordinate is a freedom of."""
        for joint in self.joints.values():
            if any(freedom.name == coordinate for freedom in joint.freedoms):
                return joint
        raise self.document.error(key, f'{coordinate} is a rotor, which no bearing load hangs on')

    def friction(self, name: str) -> Friction:
        """Read a table of friction over speed."""
        key: Key = ('frictions', name)
        value = self.data['frictions'][name]
        coordinate, revolute = self.coordinate(key, value)
        speeds = self.quantity(key, revolute, 'speed_m_s', 'speed_rad_s')
        resistances = self.quantity(key, revolute, 'force_n', 'torque_nm')
        if len(speeds) != len(resistances):
            raise self.document.error(
                key, f'{len(speeds)} speeds but {len(resistances)} values of friction'
            )
        if speeds[0] != 0.0 or any(a >= b for a, b in pairwise(speeds)):
            raise self.document.error(key, f'speeds must rise from 0; they are {speeds}')
        return Friction(
            name,
            coordinate,
            np.array(speeds, float),
            np.array(resistances, float) * value.get('factor', 1.0),
            float(value.get('breakaway', 1.0)),
            imperfections.read_friction_law(self, key, revolute),
        )

    def damper(self, name: str) -> Damper:
        """Read a viscous damper."""
        key: Key = ('dampers', name)
        coordinate, revolute = self.coordinate(key, self.data['dampers'][name])
        return Damper(
            name,
            coordinate,
            float(self.quantity(key, revolute, 'damping_n_s_m', 'damping_nm_s_rad')),
        )

    def motor(self, axis: str) -> Motor:
        """Read a motor's data sheet."""
        key: Key = ('motors', axis)
        value = self.data['motors'][axis]
        coordinate, revolute = self.coordinate(key, value)
        back_emf = self.quantity(
            key, revolute, 'back_emf_lead_to_lead_v_s_m', 'back_emf_lead_to_lead_v_s_rad'
        )
        cycle = self.quantity(key, revolute, 'electrical_cycle_m', 'pole_pairs')
        return Motor(
            axis,
            coordinate,
            value['winding'],
            float(value['resistance_lead_to_lead_ohm']),
            float(value['inductance_lead_to_lead_h']),
            float(back_emf),
            float(cycle) if revolute else 2.0 * math.pi / cycle,
            self.heating(axis),
            float(value.get('saturation_current_a', 0.0)),
            self.ripple(axis),
            _pair(value.get('phase_imbalance', (0.0, 0.0))),
        )

    def ripple(self, axis: str) -> tuple[Ripple, ...]:
        """Read the ripples of a motor's constant, which together must leave it its sign."""
        ripple = tuple(
            Ripple(float(one['order']), float(one.get('cosine', 0.0)), float(one.get('sine', 0.0)))
            for one in self.data['motors'][axis].get('ripple', ())
        )
        total = sum(math.hypot(one.cosine, one.sine) for one in ripple)
        if total >= 1.0:
            raise self.document.error(
                ('motors', axis, 'ripple'),
                f'amplitudes add up to {total:g}; they are relative and must stay below 1',
            )
        return ripple

    def heating(self, axis: str) -> Heating | None:
        """Read how a motor warms up; None for one that stays at the data sheet's temperature."""
        value = self.data['motors'][axis].get('heating')
        if value is None or value['state'] == 'cold':
            return None
        return Heating(
            to_air=float(value['winding_to_air_k_w']),
            capacity=float(value['winding_capacity_j_k']),
            air=float(value['air_degc']),
            resistance_at=float(value['resistance_at_degc']),
            coefficient=float(value['resistance_rise_1_k']),
            start=float(value.get('winding_start_degc', value['air_degc'])),
        )

    def encoder(self, place: str) -> Encoder:
        """Read an encoder's resolution."""
        key: Key = ('encoders', place)
        coordinate, revolute = self.coordinate(key, self.data['encoders'][place])
        counts = self.quantity(key, revolute, 'counts_per_m', 'counts_per_revolution')
        per_unit = counts / (2.0 * math.pi) if revolute else float(counts)
        return Encoder(place, coordinate, per_unit, self.encoder_errors(place, revolute))

    def encoder_errors(self, place: str, revolute: bool) -> EncoderErrors:
        """Read what is wrong with an encoder."""
        key: Key = ('encoders', place)
        value = self.data['encoders'][place]
        lost: dict[str, Any] = value.get('lost_counts', {})
        every = (
            self.quantity((*key, 'lost_counts'), revolute, 'every_m', 'every_rad') if lost else 0
        )
        errors = EncoderErrors(
            scale=float(value.get('scale_error', 0.0)),
            eccentricity=self.eccentricity((*key, 'eccentricity'), revolute),
            interpolation=_cyclic_error(value.get('interpolation'), 'counts'),
            coarseness=float(value.get('coarseness_counts', 1.0)),
            extra_delay=int(value.get('extra_delay_cycles', 0)),
            delay_fraction=float(value.get('delay_fraction', 0.0)),
            noise=float(value.get('noise_counts', 0.0)),
            noise_seed=int(value.get('noise_seed', 0)),
            lost_counts=float(lost.get('counts', 0.0)),
            lost_every=float(every),
        )
        common = int(self.section('feedback').get('delay_cycles', 1))
        if common + errors.extra_delay > LONGEST_DELAY:
            raise self.document.error(
                (*key, 'extra_delay_cycles'),
                f'is {errors.extra_delay}; with feedback.delay_cycles = {common} the count would be '
                f'{common + errors.extra_delay} cycles late, the longest delay is {LONGEST_DELAY}',
            )
        return errors

    def eccentricity(self, key: Key, revolute: bool) -> CyclicError:
        """Read the eccentricity of an encoder, in the unit of its coordinate."""
        value = self.data['encoders'][key[1]].get('eccentricity')
        if value is None:
            return CyclicError()
        self.quantity(key, revolute, 'amplitude_m', 'amplitude_rad')
        self.quantity(key, revolute, 'period_m', 'period_rad')
        unit = 'rad' if revolute else 'm'
        return _cyclic_error(value, unit)

    def current_sensors_of(self, axis: str) -> CurrentSensors:
        """Read the errors of a motor's current sensors."""
        self.reference(('current_sensors', axis), axis, self.section('motors'), 'motor')
        value = self.data['current_sensors'][axis]
        return CurrentSensors(
            axis,
            (float(value.get('gain_1', 0.0)), float(value.get('gain_2', 0.0))),
            (float(value.get('offset_1_a', 0.0)), float(value.get('offset_2_a', 0.0))),
            float(value.get('noise_a', 0.0)),
            int(value.get('noise_seed', 0)),
        )


def _pair(values: Sequence[float]) -> tuple[float, float]:
    """Return two numbers as a tuple."""
    return float(values[0]), float(values[1])


def _cyclic_error(value: Mapping[str, Any] | None, unit: str) -> CyclicError:
    """Return the cyclic error whose amplitude and period are given in `unit`; none for None."""
    if value is None:
        return CyclicError()
    return CyclicError(
        float(value[f'amplitude_{unit}']),
        float(value[f'period_{unit}']),
        float(value.get('phase_rad', 0.0)),
    )
