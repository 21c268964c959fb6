# SPDX-License-Identifier: Apache-2.0
"""A twin in which only those take part who have a key: policy, keystore, an intruder."""

from __future__ import annotations

import importlib.util
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from harness import (
    ROS2,
    Client,
    Program,
    parameter_files,
    start_node,
    user_environment,
    waferbot,
)

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.node import lockstep_qos
from waferbot_msgs.msg import Encoders, Stop
from waferbot_twin.security import (
    ENCLAVES,
    ROLES,
    SIMULATOR,
    enclave_of,
    environment_of,
    make_keystore,
    policy,
)

NODES = ('plant', 'pmac', 'copley')
ASKED_OF_AN_ACTION = ('cancel_goal', 'get_result', 'send_goal')
NO_SECURITY = "doesn't have the security libraries"
"""What the middleware says that was built without."""


def allowed(name, namespace='/'):
    """Return what a policy allows an enclave, by element and attribute: full names."""
    root = ElementTree.fromstring(policy(namespace))
    (profile,) = root.iterfind(f"./enclaves/enclave[@path='{ENCLAVES}/{name}']/profiles/profile")
    base = profile.get('ns').rstrip('/')
    found = {}
    for group in profile:
        ((leave, rule),) = group.attrib.items()
        assert rule == 'ALLOW'
        names = [one.text for one in group]
        assert len(names) == len(set(names)), f'{name} may {leave} something twice'
        found[group.tag, leave] = {
            one if one.startswith('/') else f'{base}/{one}' for one in names
        }
    return found


@pytest.mark.slow
def test_every_node_may_do_what_it_does_and_no_more(start, domain, connect):
    """The graph of a running twin against the policy."""
    client = connect(domain)
    for node in NODES:
        start_node(start, node, domain, 'timekeeping:=realtime', 'startup_timeout_s:=600.0')
    # where one records, of a machine with axes of its own, and where ROS has simulation_interfaces
    may_be_there = {'/recorded', '/machine_axes', *(f'/plant/{name}' for name in SIMULATOR)}
    may = {node: names_of(node) for node in NODES}

    def done():
        """Return what each node does by now, as far as it has been discovered."""
        there = set(client.node.get_node_names()) & may.keys()
        return {
            (node, what): {
                name
                for name, _ in getattr(client.node, f'get_{what}_names_and_types_by_node')(
                    node, '/'
                )
            }
            for node in there
            for what in may[node]
        }

    def all_discovered():
        seen = done()
        return all(
            names - may_be_there <= seen.get((node, what), set())
            for node in NODES
            for what, names in may[node].items()
        )

    client.spin_until(all_discovered, 'all that the policy allows')
    for (node, what), names in done().items():
        assert names - may[node][what] == set(), node


def names_of(node):
    """Return what the policy allows a node of ours, by what ROS calls its parts: full names."""
    may = allowed(node)
    says, gives = set(may['topics', 'publish']), set(may['services', 'reply'])
    for action in may.get(('actions', 'execute'), ()):
        says |= {f'{action}/_action/{part}' for part in ('feedback', 'status')}
        gives |= {f'{action}/_action/{part}' for part in ASKED_OF_AN_ACTION}
    return {
        'publisher': says,
        'subscriber': may['topics', 'subscribe'],
        'service': {name for name in gives if not name.startswith('/copley_')},
    }


def test_only_the_plant_gives_counts_and_only_a_controller_commands():
    says = {name: allowed(name)['topics', 'publish'] for name in ROLES}
    for topic, who in (
        ('/encoders', 'plant'),
        ('/phase_currents', 'plant'),
        ('/current_command', 'pmac'),
        ('/phase_voltages', 'copley'),
        ('/clock', 'plant'),
    ):
        assert [name for name in ROLES if topic in says[name]] == [who]
    assert '/stop' not in says['observer'] | says['operator']
    assert '/plant/pause' not in allowed('observer')['services', 'request']
    assert ('actions', 'call') not in allowed('observer')


def test_a_twin_in_a_namespace_has_its_names_there():
    may = allowed('copley', '/left')
    assert '/left/phase_voltages' in may['topics', 'publish']
    assert '/left/copley_x_rotate/reset_faults' in may['services', 'reply']
    assert {'/rosout', '/diagnostics'} <= may['topics', 'publish']


@pytest.mark.parametrize(
    ('script', 'said'),
    [(None, 'no ros2 command'), ('echo "no such verb: security" >&2; exit 2', 'no such verb')],
)
def test_without_sros2_nothing_is_left_and_the_user_is_told(tmp_path, monkeypatch, script, said):
    programs = tmp_path / 'bin'
    programs.mkdir()
    if script:
        (programs / 'ros2').write_text(f'#!/bin/sh\n{script}\n')
        (programs / 'ros2').chmod(0o755)
    monkeypatch.setenv('PATH', str(programs))
    with pytest.raises(UserError, match=said):
        make_keystore(tmp_path / 'made' / 'keystore', 7)
    assert not list(tmp_path.glob('made/*'))
    assert not list(tmp_path.glob('made/.*'))


def test_a_keystore_is_not_replaced(tmp_path):
    (tmp_path / 'precious').write_text('key')
    with pytest.raises(UserError, match='exists already'):
        make_keystore(tmp_path, 7)
    assert (tmp_path / 'precious').read_text() == 'key'


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (('--domain', '233'), 'must be 0 to 232'),
        (('--namespace', 'left hand'), 'no name of a ROS namespace'),
    ],
)
def test_a_wrong_option_is_said(tmp_path, words, said):
    done = waferbot('secure', '--out', str(tmp_path / 'keystore'), *words)
    assert done.returncode == 1
    assert said in done.stderr


@pytest.fixture
def bare(tmp_path):
    """A folder with the files of a keystore by which it is looked at."""
    for name in ROLES:
        folder = tmp_path / 'enclaves' / 'waferbot' / name
        folder.mkdir(parents=True)
        (folder / 'permissions.p7s').write_text('')
    (tmp_path / 'enclaves' / 'governance.xml').write_text(
        '<dds><domains><id>7</id></domains></dds>'
    )
    return tmp_path


def test_the_environment_of_a_keystore_admits_nobody_else(bare):
    found = environment_of(bare, 7)
    assert found['ROS_SECURITY_ENABLE'] == 'true'
    assert found['ROS_SECURITY_STRATEGY'] == 'Enforce'
    assert Path(found['ROS_SECURITY_KEYSTORE']) == bare


def test_a_keystore_for_another_domain_or_another_robot_is_refused(bare):
    with pytest.raises(UserError, match='is for ROS domain 7, and ROS_DOMAIN_ID is 8'):
        environment_of(bare, 8)
    (bare / 'enclaves' / 'governance.xml').write_text('<dds><domains>')
    with pytest.raises(UserError, match='cannot be read'):
        environment_of(bare, 7)
    shutil.rmtree(bare / 'enclaves' / 'waferbot' / 'copley')
    with pytest.raises(UserError, match='no enclave /waferbot/copley'):
        environment_of(bare, 7)


@pytest.mark.parametrize(
    'program',
    [
        ('waferbot_plant.node', '--ros-args'),
        ('waferbot_twin.record', 'run', '--model=rigid', '--experiment=step', '--ros-args'),
    ],
    ids=['plant', 'recorder'],
)
def test_a_node_without_an_enclave_says_so_in_a_line(start, bare, tmp_path, program):
    one = start(
        *program, '--enclave', '/waferbot/nobody', ROS_DOMAIN_ID='7', **environment_of(bare, 7)
    )
    assert one.wait() == 1
    assert 'with ROS_SECURITY_ENABLE=true ROS refuses this process' in one.output
    assert 'nobody' in one.output
    assert 'Traceback' not in one.output


# ---- with sros2 ------------------------------------------------------------------------------------


@pytest.fixture
def keystore_at(domain):
    """Give a function that makes a keystore for the test's domain."""
    probe = ['ros2', 'security', '--help']
    if shutil.which('ros2') is None or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip('there is no `ros2 security` (sros2)')

    def make(path):
        done = waferbot('secure', '--out', str(path), '--domain', str(domain))
        assert done.returncode == 0, done.stderr
        return path

    return make


@pytest.mark.slow
def test_the_authority_has_signed_what_each_may_do(keystore_at, domain, tmp_path):
    keystore = keystore_at(tmp_path / 'keystore')
    assert keystore.stat().st_mode & 0o777 == 0o700
    assert [one.name for one in tmp_path.iterdir()] == ['keystore']
    for name in ROLES:
        folder = keystore / 'enclaves' / 'waferbot' / name
        signed = subprocess.run(
            ['openssl', 'smime', '-verify', '-in', folder / 'permissions.p7s',
             '-CAfile', folder / 'permissions_ca.cert.pem'],
            capture_output=True, text=True,
        )  # fmt: skip
        assert signed.returncode == 0, signed.stderr
        root = ElementTree.fromstring(signed.stdout.partition('\n\n')[2])
        assert {one.text for one in root.iter('id')} == {str(domain)}
        said = {one.text for one in root.iterfind('.//allow_rule/publish/topics/topic')}
        assert ('rt/current_command' in said) == (name == 'pmac')
        assert root.findtext('.//default') == 'DENY'
    environment_of(keystore, domain)


@pytest.fixture
def join(domain, monkeypatch):
    """Give a function that joins the domain as a client with a key, or without one."""
    clients = []

    def enter(keystore=None, role=''):
        with monkeypatch.context() as own:
            if keystore is not None:
                for name, value in environment_of(keystore, domain).items():
                    own.setenv(name, value)
                own.setenv('ROS_SECURITY_ENCLAVE_OVERRIDE', enclave_of(role))
            clients.append(Client(domain, role or 'stranger'))
        return clients[-1]

    yield enter
    for client in clients:
        client.end()


@pytest.fixture(params=['by hand', 'launched'])
def run_secured(request, start, domain, tmp_path):
    """Give a function that starts a twin with a keystore, and returns its processes."""
    launched = []

    def run(keystore):
        if request.param == 'launched':
            if importlib.util.find_spec('ros2launch') is None:
                pytest.skip('this Python has no ros2launch')
            command = [*ROS2, 'launch', 'waferbot_twin', 'twin.launch.py', f'secure:={keystore}']
            log = tmp_path / 'launch.log'
            launched.append(Program(command, log, {'ROS_DOMAIN_ID': str(domain)}))
            return launched
        return [
            start(
                f'waferbot_{node}.node', '--ros-args', *parameter_files(node),
                '--enclave', enclave_of(node), '-p', 'startup_timeout_s:=600.0',
                ROS_DOMAIN_ID=str(domain), **environment_of(keystore, domain),
            )
            for node in NODES
        ]  # fmt: skip

    yield run
    for program in launched:
        program.signal(signal.SIGINT)
        program.wait()


@pytest.mark.slow
def test_who_has_no_key_of_this_keystore_sees_nothing_and_stops_nothing(
    keystore_at, run_secured, domain, join, tmp_path
):
    keystore, forged = keystore_at(tmp_path / 'keystore'), keystore_at(tmp_path / 'forged')
    probe = subprocess.run(
        [sys.executable, '-c', 'import rclpy; rclpy.init(); rclpy.create_node("probe")'],
        capture_output=True, text=True,
        env={
            **user_environment(), **environment_of(keystore, domain),
            'ROS_SECURITY_ENCLAVE_OVERRIDE': enclave_of('observer'),
        },
    )  # fmt: skip
    if NO_SECURITY in probe.stderr:
        pytest.skip('the middleware is built without security')
    programs = run_secured(keystore)
    observer = join(keystore, 'observer')
    newest = []
    observer.node.create_subscription(Encoders, 'encoders', newest.append, 1)
    observer.spin_until(lambda: newest and newest[-1].tick > 100, 'an observer hearing the twin')

    intruders = [join(), join(forged, 'pmac')]
    heard, seen = [], set()
    for intruder in intruders:
        intruder.node.create_subscription(Encoders, 'encoders', heard.append, lockstep_qos())
        stop = intruder.node.create_publisher(Stop, 'stop', lockstep_qos())
        reason = Stop(tick=10**6, node='/pmac', reason='the intruder says so')
        intruder.node.create_timer(0.1, lambda stop=stop, reason=reason: stop.publish(reason))
    until = newest[-1].tick + 2000

    def all_go_on():
        for intruder in intruders:
            intruder.executor.spin_once(timeout_sec=0.0)
            seen.update(name for name, _ in intruder.node.get_topic_names_and_types())
        return newest[-1].tick > until

    observer.spin_until(all_go_on, 'the twin going on')
    assert heard == []
    assert '/phase_currents' not in seen
    assert all(program.process.poll() is None for program in programs)
    with pytest.raises(Exception, match=r'(?i)publisher'):  # an observer has a key, and no say
        observer.node.create_publisher(Stop, 'stop', lockstep_qos())
