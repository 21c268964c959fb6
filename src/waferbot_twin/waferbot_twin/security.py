# SPDX-License-Identifier: Apache-2.0
"""
A keystore of SROS2 for the twin: who may take part, and what each may say and hear.

Every process of a secured twin has an *enclave*: a key and a certificate that the keystore's authority
signed, and permissions (DDS Security 1.1; ROS 2 design: SROS2, policies). A process without one is
refused by all others, one with one says and hears what its permissions allow. Here they follow from the
contract (`waferbot_lockstep.contract`): the plant alone gives counts and currents, the PMAC alone
commands. Keys, certificates and signatures are made by `ros2 security`.

Permissions are for one ROS domain, and name topics in full: a keystore is for one domain and namespace.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from waferbot_lockstep.contract import (
    AXES,
    CONTRACT_TOPICS,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    MACHINE_AXES_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    PLANT_STATE,
    RECORDED_TOPIC,
    STOP_TOPIC,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.standard_messages import (
    CLOCK,
    FIXED_TRANSFORMS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TRANSFORMS,
)

ENCLAVES = '/waferbot'
"""Where the enclaves of the twin are in a keystore: `/waferbot/plant`, and so on."""

PARAMETERS = (
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
)
DESCRIBED = 'get_type_description'
"""Services that every node of rclpy has."""

COPLEYS = ('copley', *(f'copley_{axis}' for axis in AXES))
"""One node for all axes, or one for each."""

PAUSE = 'pause'
SIMULATOR = (
    'get_simulator_features',
    'get_simulation_state',
    'set_simulation_state',
    'step_simulation',
    'reset_simulation',
)
AMPLIFIER = ('reset_faults', 'safe_torque_off')
"""Services of the plant and the amplifiers, below their names."""

EXPERIMENT = 'run_experiment'
"""The action of the PMAC."""


@dataclass(frozen=True)
class Role:
    """
    What a process may do: topics to say and hear, services to give and ask for, actions likewise.

    `nodes` are the names of the nodes in it, whose parameters it has. Names are relative to the
    namespace, or absolute; `*` stands for any text.
    """

    what: str
    nodes: tuple[str, ...]
    says: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    gives: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    executes: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()


_EVERYBODY_SAYS = ('/rosout', '/parameter_events')
_DIAGNOSTICS = '/diagnostics'
_STANDARD = (CLOCK[0], JOINT_STATES[0], PLANT_STATE.name, ROBOT_DESCRIPTION[0])
_FRAMES = tuple(name for name, _ in (TRANSFORMS, FIXED_TRANSFORMS))
_TOLD = (
    *(topic.name for topic in CONTRACT_TOPICS),
    *_STANDARD,
    *_FRAMES,
    MACHINE_AXES_TOPIC,
    RECORDED_TOPIC,
    STOP_TOPIC,
    _DIAGNOSTICS,
    *_EVERYBODY_SAYS,
    f'{EXPERIMENT}/_action/feedback',
    f'{EXPERIMENT}/_action/status',
)


def _of(publisher: str) -> tuple[str, ...]:
    return tuple(topic.name for topic in CONTRACT_TOPICS if topic.publisher == publisher)


def _below(nodes: tuple[str, ...], services: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f'{node}/{service}' for node in nodes for service in services)


_LOOKED_AT = tuple(name for name in PARAMETERS if not name.startswith('set_'))
_NODES = ('plant', 'pmac', *COPLEYS)

ROLES: Mapping[str, Role] = {
    'plant': Role(
        'the machine: gives counts and currents',
        ('plant',),
        (*_of('plant'), *_STANDARD, MACHINE_AXES_TOPIC, _DIAGNOSTICS, STOP_TOPIC),
        (PHASE_VOLTAGES.name, RECORDED_TOPIC, STOP_TOPIC),
        _below(('plant',), (PAUSE, *SIMULATOR)),
    ),
    'pmac': Role(
        'the position controller, ours or yours: commands currents',
        ('pmac',),
        (*_of('pmac'), _DIAGNOSTICS, STOP_TOPIC),
        (ENCODERS_TOPIC.name, MACHINE_AXES_TOPIC, STOP_TOPIC),
        executes=(EXPERIMENT,),
    ),
    'copley': Role(
        'the amplifiers, ours or yours: give voltages',
        COPLEYS,
        (*_of('copley'), _DIAGNOSTICS, STOP_TOPIC),
        (
            *(PHASE_CURRENTS.name, ENCODERS_TOPIC.name, CURRENT_COMMAND.name),
            *(MACHINE_AXES_TOPIC, STOP_TOPIC),
        ),
        _below(COPLEYS, AMPLIFIER),
    ),
    'recorder': Role(
        'hears everything, lets time go',
        ('recorder',),
        (RECORDED_TOPIC, STOP_TOPIC),
        _TOLD,
        asks=_below(('plant',), (PAUSE,)),
    ),
    'robot_state_publisher': Role(
        'gives transforms',
        ('robot_state_publisher',),
        (*_FRAMES, ROBOT_DESCRIPTION[0]),
        (JOINT_STATES[0], CLOCK[0], '/parameter_events'),
    ),
    'observer': Role(
        'for ros2 topic, RViz, PlotJuggler: hears everything',
        ('*',),
        hears=_TOLD,
        asks=_below(_NODES, (DESCRIBED, *_LOOKED_AT)),
    ),
    'operator': Role(
        'an observer who also pauses, sets parameters, resets faults and runs experiments',
        ('*',),
        hears=_TOLD,
        asks=(
            *_below(_NODES, (DESCRIBED, *PARAMETERS)),
            *_below(('plant',), (PAUSE, *SIMULATOR)),
            *_below(COPLEYS, AMPLIFIER),
        ),
        calls=(EXPERIMENT,),
    ),
}
"""The enclaves of the twin by the last part of their names."""


def policy(namespace: str = '/') -> str:
    """Return the policy of all roles in a namespace, as `ros2 security create_permission` reads it."""
    root = ElementTree.Element('policy', version='0.2.0')
    enclaves = ElementTree.SubElement(root, 'enclaves')
    for name, role in ROLES.items():
        enclave = ElementTree.SubElement(enclaves, 'enclave', path=f'{ENCLAVES}/{name}')
        profiles = ElementTree.SubElement(enclave, 'profiles')
        profile = ElementTree.SubElement(profiles, 'profile', ns=namespace, node=name)
        own = _below(role.nodes, (DESCRIBED, *PARAMETERS))
        for kind, leave, names in (
            ('topic', 'publish', (*_EVERYBODY_SAYS, *role.says)),
            ('topic', 'subscribe', role.hears),
            ('service', 'reply', (*own, *role.gives)),
            ('service', 'request', role.asks),
            ('action', 'execute', role.executes),
            ('action', 'call', role.calls),
        ):
            if names:
                group = ElementTree.SubElement(profile, f'{kind}s', {leave: 'ALLOW'})
                for one in names:
                    ElementTree.SubElement(group, kind).text = one
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode', xml_declaration=True) + '\n'


def make_keystore(folder: Path, domain: int, namespace: str = '/') -> None:
    """
    Make a keystore with an enclave for every role; whole or not at all.

    Its owner alone can read it. Raises `UserError` if there is something at `folder`, or `ros2
    security` is not there or fails.
    """
    if os.path.lexists(folder):
        raise UserError(
            f'--out {folder} exists already; a keystore is not replaced: choose another folder'
        )
    if shutil.which('ros2') is None:
        raise UserError('there is no ros2 command; a keystore is made by `ros2 security` (sros2)')
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f'.{folder.name}.', dir=folder.parent) as made:
            keystore = Path(made) / folder.name  # a temporary directory is its owner's alone
            keystore.mkdir(mode=0o700)
            rules = Path(made) / 'policy.xml'
            rules.write_text(policy(namespace), 'utf-8')
            _security('create_keystore', str(keystore), domain=domain)
            for name in ROLES:
                words = (str(keystore), f'{ENCLAVES}/{name}')
                _security('create_enclave', *words, domain=domain)
                _security('create_permission', *words, str(rules), domain=domain)
            shutil.copy(rules, keystore / 'policy.xml')
            keystore.rename(folder)
    except OSError as error:
        raise UserError(f'--out {folder} cannot be written: {error.strerror}') from error


def _security(verb: str, *words: str, domain: int) -> None:
    """Run `ros2 security`; raises `UserError` with the last that it said if it fails."""
    done = subprocess.run(
        ['ros2', 'security', verb, *words],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
    )
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines() or ['nothing']
        raise UserError(
            f'`ros2 security {verb}` failed (exit code {done.returncode}) and said: {said[-1]}. '
            'Is sros2 installed (ros-jazzy-sros2)?'
        )


def environment_of(keystore: Path, domain: int) -> dict[str, str]:
    """
    Return the environment in which nodes take part by a keystore, and by nothing else.

    Raises `UserError` if that has no enclaves of the twin, or is for another domain.
    """
    enclaves = keystore / 'enclaves'
    lacking = [
        name
        for name in ROLES
        if not (enclaves / ENCLAVES[1:] / name / 'permissions.p7s').is_file()
    ]
    if lacking:
        raise UserError(
            f'{keystore} has no enclave {ENCLAVES}/{lacking[0]}; make a keystore by '
            f'`waferbot secure --out {keystore} --domain {domain}`'
        )
    try:
        text = (enclaves / 'governance.xml').read_text('utf-8')
        domains = [int(one.text or '') for one in ElementTree.fromstring(text).iter('id')]
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise UserError(f'{enclaves / "governance.xml"} cannot be read: {error}') from error
    if domain not in domains:
        raise UserError(
            f'{keystore} is for ROS domain {", ".join(map(str, domains))}, and ROS_DOMAIN_ID is '
            f'{domain}; set that, or make another keystore'
        )
    return {
        'ROS_SECURITY_ENABLE': 'true',
        'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(keystore.resolve()),
    }


def enclave_of(node: str) -> str:
    """Return the enclave of a node of the twin, by its kind: plant, pmac, copley, recorder, ..."""
    return f'{ENCLAVES}/{node}'
