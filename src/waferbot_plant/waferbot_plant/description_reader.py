# SPDX-License-Identifier: Apache-2.0
"""From the checked text of a description to its data, with the checks that need physics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout, layout_of
from waferbot_lockstep.marked_yaml import Document, Key
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant import friction_tables, imperfections, part_library
from waferbot_plant.bearing_loads import BearingLoad
from waferbot_plant.description import (
    BASE,
    MULTIBODY,
    Body,
    Connection,
    Damper,
    Description,
    Freedom,
    Friction,
    Joint,
    Payload,
    Rotor,
    Stage,
    Transmission,
)
from waferbot_plant.description_controllers import read_controller
from waferbot_plant.description_drives import read_current_sensors, read_encoder, read_motor
from waferbot_plant.part_library import Carried
from waferbot_plant.spring_curves import SpringCurve


class Reader:
    """Turns checked data into the dataclasses and makes the checks that need physics."""

    def __init__(self, document: Document, data: dict[str, Any]) -> None:
        self.document = document
        self.data = data
        self.revolute: dict[str, bool] = {}
        self.held: set[str] = set()
        self.locked: set[str] = set()
        self.bodies: dict[str, Body] = {}
        self.joints: dict[str, Joint] = {}
        self.parts: dict[str, Any] = {}
        self._carried: dict[str, Carried] = {}

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
        layout = self.layout()
        frictions, dampers = self.resistances()
        return Description(
            name=self.data['name'],
            gravity=np.array(self.data.get('gravity_m_s2', [0.0, -9.81, 0.0]), float),
            substeps=int(self.data.get('substeps', 1)),
            formulation=str(self.data.get('formulation', MULTIBODY)),
            payload=self.payload(),
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
            motors={axis: read_motor(self, axis) for axis in self.section('motors')},
            encoders={place: read_encoder(self, place) for place in self.section('encoders')},
            current_sensors={
                axis: read_current_sensors(self, axis) for axis in self.section('current_sensors')
            },
            controllers={
                axis: read_controller(self, axis) for axis in self.section('controllers')
            },
            parts=self.parts,
            revolute=self.revolute,
            provenance=provenance,
            titles=self.titles(layout),
        )

    def axis(self, axis: str) -> str:
        """Return the coordinate of an axis of the contract."""
        coordinate = self.moving(('axes', axis), self.section('axes')[axis])
        if coordinate in self.locked:
            raise self.document.error(
                ('axes', axis), f'{coordinate} is locked; an axis is a coordinate that moves'
            )
        return coordinate

    def layout(self) -> Layout:
        """Return the places of axes and encoders; each motor, sensor and controller is of an axis."""
        axes, encoders = tuple(self.section('axes')), tuple(self.section('encoders'))
        try:
            layout = layout_of(axes, encoders)
        except UserError as error:
            what = str(error).partition(':')[0]
            key: Key = (what,) if what in self.data else ('axes',) if 'axes' in self.data else ()
            raise self.document.error(key, str(error)) from error
        for section in ('motors', 'current_sensors', 'controllers'):
            for axis in self.section(section):
                if axis not in layout.axes:
                    self.reference((section, axis), axis, self.section('axes'), 'axis')
        return layout

    def titles(self, layout: Layout) -> dict[str, str]:
        """Return what every axis is called: as the file says, as usual, or by its name."""
        usual = {axis: USUAL_TITLES[axis] for axis in layout.axes}
        return usual | {axis: self.title(axis) for axis in self.section('titles')}

    def title(self, axis: str) -> str:
        """Return what an axis is called, in one line: it stands in lines of tables and in comments."""
        key: Key = ('titles', axis)
        self.reference(key, axis, self.section('axes'), 'axis')
        title = ' '.join(self.data['titles'][axis].split())
        if not title:
            raise self.document.error(key, 'must not be empty')
        return title

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

    def payload(self) -> Payload | None:
        """Read where the payload frame is."""
        value = self.data.get('payload')
        if value is None:
            return None
        self.reference(('payload', 'body'), value['body'], self.bodies, 'body')
        return Payload(value['body'], np.array(value['at_m'], float))

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
            locked = bool(freedom.get('locked', False))
            if locked and 'held_by' in freedom:
                raise self.document.error(
                    (*freedom_key, 'locked'), 'what connections hold is not locked; leave out one'
                )
            if locked:
                self.locked.add(freedom_name)
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
                    locked,
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
        """Return what hangs on a joint at home; several connections of a part ask for the same."""
        if joint.name not in self._carried:
            self._carried[joint.name] = self._all_carried_by(joint)
        return self._carried[joint.name]

    def _all_carried_by(self, joint: Joint) -> Carried:
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
        flexible = value['state'] == 'flexible'
        law = imperfections.read_spring_law(self, key, rotary, stage_kind)
        more_damping = float(value.get('damping_factor', 1.0))
        if value.get('stiffness_by') == 'chart':
            self.check_chart(key, value, law, in_joint=stage_kind is None)
        if 'part' in value:
            stiffness, loss, curve = self.stiffness_of_part(key, value, rotary)
            return Connection(
                name,
                flexible,
                rotary,
                stiffness,
                None,
                loss * more_damping,
                free,
                **law,
                part=self.part(key, value),
                direction=value.get('direction', ''),
                curve=curve,
            )
        stiffness = float(self.quantity(key, rotary, 'stiffness_n_m', 'stiffness_nm_rad'))
        names = ('damping_n_s_m', 'damping_nm_s_rad')
        if ('loss_factor' in value) == any(damping in value for damping in names):
            raise self.document.error(key, f'give either loss_factor or {names[rotary]}')
        if 'loss_factor' in value:
            loss = float(value['loss_factor']) * more_damping
            return Connection(name, flexible, rotary, stiffness, None, loss, free, **law)
        damping = float(self.quantity(key, rotary, *names)) * more_damping
        return Connection(name, flexible, rotary, stiffness, damping, None, free, **law)

    def stiffness_of_part(
        self, key: Key, value: dict[str, Any], rotary: bool
    ) -> tuple[float, float, SpringCurve | None]:
        """
        Return stiffness and loss factor of a connection from the data of its part, and its curve.

        With a curve the stiffness is its slope at the static load; None where it is linear.
        """
        part = self.part(key, value)
        known = part_library.directions(part)
        direction = value.get('direction', '')
        if direction not in known:
            choice = ', '.join(known) if any(known) else 'none'
            raise self.document.error(
                key, f'direction is {direction!r}; part {value["part"]} has: {choice}'
            )

        def carried() -> Carried:
            return self.carried_by(self.joint_with(key, value['part']))

        curve = None
        try:
            if value.get('stiffness_by') == 'chart':
                curve, load, is_rotary = part_library.curve(part, direction, carried())
                stiffness = curve.slope(curve.deflection(load))
            else:
                stiffness, is_rotary = part_library.stiffness(part, direction, carried)
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
        return stiffness, float(loss), curve

    def check_chart(
        self, key: Key, value: dict[str, Any], law: Mapping[str, Any], in_joint: bool
    ) -> None:
        """Refuse a chart of what is no bearing in a joint, and one beside another law of force."""
        where = (*key, 'stiffness_by')
        if 'part' not in value:
            raise self.document.error(where, 'needs a part that has a chart, which bearings have')
        if not part_library.follows_chart(self.part(key, value)):
            raise self.document.error(where, f'part {value["part"]} has no chart; bearings have')
        if not in_joint:
            raise self.document.error(where, 'is for a connection that holds a freedom of a joint')
        if law:
            raise self.document.error(
                where, f'the chart is the whole law of force; {", ".join(law)} does not go with it'
            )

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
            friction_tables.refuse_loads(self, key, 'the friction of a part has no map')
            found = self.friction_of_part(key, value)
            factor = value.get('factor', 1.0)
            resistance, law = found.coulomb_nm, {}
            bearing = self.bearing_load(key, value)
            if bearing is not None:
                resistance, per_load = self.rolling_friction(key, value)
                law['per_load'] = factor * per_load
            frictions[name] = Friction(
                name,
                coordinate,
                np.zeros(1),
                np.array([factor * resistance]),
                float(value.get('breakaway', 1.0)),
                law | imperfections.read_friction_law(self, key, self.revolute[coordinate]),
                bearing=bearing,
            )
            if found.viscous_nm_s_per_rad > 0.0:
                dampers[name] = Damper(name, coordinate, factor * found.viscous_nm_s_per_rad)
        return frictions, {**dampers, **self.motor_dampers(dampers)}

    def motor_dampers(self, others: Mapping[str, Damper]) -> dict[str, Damper]:
        """Return the viscous damping of the motors' own bearings and iron, from their data sheets."""
        found = {}
        for axis, value in self.section('motors').items():
            key: Key = ('motors', axis)
            coordinate, revolute = self.coordinate(key, value)
            names = ('viscous_damping_n_s_m', 'viscous_damping_nm_s_rad')
            if not any(name in value for name in names):
                continue
            damping = float(self.quantity(key, revolute, *names))
            name = f'{axis}_motor_viscous'
            if name in others:
                raise self.document.error(key, f'a damper {name} is there already')
            if damping > 0.0:
                found[name] = Damper(name, coordinate, damping)
        return found

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

    def bearing_load(self, key: Key, value: dict[str, Any]) -> BearingLoad | None:
        """Return the load of the bearing that a friction follows, None where it follows none."""
        if 'load_of' not in value:
            return None
        where, name = (*key, 'load_of'), value['load_of']
        self.reference(where, name, self.parts, 'part')
        joint = self.joint_with(where, name)
        try:
            load = part_library.bearing_load(self.parts[name], self.carried_by(joint))
        except UserError as error:
            raise self.document.error(where, f'{name} {error}') from None
        held_by = {
            self.section('connections')[connection].get('direction'): freedom.name
            for freedom in joint.freedoms
            for connection in freedom.connections
            if self.section('connections')[connection].get('part') == name
        }
        first, second, third = (
            replace(amount, freedom=held_by.get(amount.direction, '')) for amount in load.amounts
        )
        return replace(load, amounts=(first, second, third))

    def rolling_friction(self, key: Key, value: dict[str, Any]) -> tuple[float, float]:
        """Return the friction of a part without load, and per load of the bearing that it follows."""
        other = self.parts[value['with']] if 'with' in value else None
        try:
            return part_library.rolling_friction(
                self.parts[value['part']], other, self.parts[value['load_of']]
            )
        except UserError as error:
            raise self.document.error((*key, 'load_of'), f'{value["load_of"]} {error}') from None

    def joint_of(self, key: Key, coordinate: str) -> Joint:
        """Return the joint that a coordinate is a freedom of."""
        for joint in self.joints.values():
            if any(freedom.name == coordinate for freedom in joint.freedoms):
                return joint
        raise self.document.error(key, f'{coordinate} is a rotor, which no bearing load hangs on')

    def friction(self, name: str) -> Friction:
        """Read a table of friction over speed, or a map over load and speed."""
        key: Key = ('frictions', name)
        value = self.data['frictions'][name]
        coordinate, revolute = self.coordinate(key, value)
        speeds, loads, resistances = friction_tables.read_table(self, key, revolute)
        return Friction(
            name,
            coordinate,
            speeds,
            resistances * value.get('factor', 1.0),
            float(value.get('breakaway', 1.0)),
            imperfections.read_friction_law(self, key, revolute),
            loads,
            self.bearing_load(key, value),
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
