# SPDX-License-Identifier: Apache-2.0
"""A PMAC and amplifiers in C, written from docs/contract.md, that share nothing but the messages."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from foreign_peers import (
    STEPS,
    check_conformance,
    check_same_bits,
    copley_arguments,
    pmac_arguments,
)
from harness import PATIENCE_S, Program, start_node

from waferbot_msgs.msg import Encoders

SOURCES = Path(__file__).parent / 'foreign_c'
LIBRARIES = ('rcl', 'rcutils', 'rosidl_runtime_c')
MESSAGES = 'waferbot_msgs__rosidl_typesupport_c', 'waferbot_msgs__rosidl_generator_c'
DURATION_S = 0.5
FORGIVEN = {'stale message', 'missing message', 'contradicting message', 'silence'}
"""Mistakes of peers that the programs pass over."""

pytestmark = [pytest.mark.slow, pytest.mark.long(90)]


@pytest.fixture(scope='module')
def build(tmp_path_factory):
    """Give a function that builds a program against whatever ROS 2 is there, once."""
    compiler = shutil.which('cc')
    prefixes = [Path(one) for one in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if one]
    if compiler is None or not any((one / 'include/rcl/rcl/rcl.h').is_file() for one in prefixes):
        pytest.skip('no C compiler, or a ROS 2 without headers')
    folder = tmp_path_factory.mktemp('foreign_c')
    includes = [f'-I{folder}' for one in prefixes for folder in (one / 'include').glob('*')]
    searched = [f'-L{one}/lib' for one in prefixes]
    found_at_run_time = [f'-Wl,-rpath,{one}/lib' for one in prefixes]
    linked = [f'-l{name}' for name in (*LIBRARIES, *MESSAGES)]
    if sysconfig.get_config_var('Py_ENABLE_SHARED'):  # the messages of PyPI's wheels look for it
        libraries, version = sysconfig.get_config_vars('LIBDIR', 'LDVERSION')
        linked += [
            '-Wl,--no-as-needed',
            f'-L{libraries}',
            f'-Wl,-rpath,{libraries}',
            f'-lpython{version}',
        ]

    def build_one(name):
        program = folder / name
        if program.exists():
            return str(program)
        built = subprocess.run(
            [
                compiler, '-std=c11', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off',
                '-D_POSIX_C_SOURCE=200809L', *includes, str(SOURCES / f'{name}.c'),
                '-o', str(program), *searched, *found_at_run_time, *linked, '-lm',
                '-Wl,--allow-shlib-undefined',
            ],
            capture_output=True,
            text=True,
        )  # fmt: skip
        assert built.returncode == 0, built.stderr
        return str(program)

    return build_one


@pytest.mark.parametrize(
    'layout', [(), ('--compose', 'plant,copley')], ids=['four processes', 'composed']
)
def test_a_pmac_in_c_gives_the_same_bits_as_ours(build, tmp_path, start, layout):
    peers = {'pmac': [build('pmac'), *pmac_arguments()]}
    check_same_bits(start, tmp_path, peers, DURATION_S, layout)


@pytest.mark.parametrize(
    'layout', [(), ('--compose', 'plant,pmac')], ids=['four processes', 'composed']
)
def test_amplifiers_in_c_give_the_same_bits_as_ours(build, tmp_path, start, layout):
    peers = {'copley': [build('copley'), *copley_arguments()]}
    check_same_bits(start, tmp_path, peers, DURATION_S, layout)


def test_with_both_of_them_only_the_plant_is_ours(build, tmp_path, start):
    peers = {
        'pmac': [build('pmac'), *pmac_arguments()],
        'copley': [build('copley'), *copley_arguments()],
    }
    check_same_bits(start, tmp_path, peers, DURATION_S)


def test_in_real_time_the_pmac_in_c_moves_the_axes_also_after_a_pause(
    build, start, domain, connect, tmp_path
):
    """At a tenth of the speed, so that load does not matter; it stands still for 0.2 s meanwhile."""
    real_time = 'timekeeping:=realtime'
    start_node(start, 'plant', domain, real_time, 'realtime_factor:=0.1')
    start_node(start, 'copley', domain, real_time)
    environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    command = [build('pmac'), '--realtime', *pmac_arguments()]
    pmac = Program(command, tmp_path / 'pmac.log', environment)
    client = connect(domain)
    newest = []
    client.node.create_subscription(Encoders, 'encoders', newest.append, 1)
    told = {}
    client.node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda array: told.update({one.name: one for one in array.status}),
        10,
    )

    def at(tick):
        return newest and newest[-1].tick > tick

    def arrived():
        return np.all(np.abs(np.array(newest[-1].counts[:3]) - STEPS) < 0.02 * np.array(STEPS))

    try:
        client.spin_until(lambda: at(3000), 'time going on')
        pmac.signal(signal.SIGSTOP)
        client.spin_until(lambda: at(newest[0].tick + 4000), 'time going on without it')
        pmac.signal(signal.SIGCONT)
        client.spin_until(lambda: at(9000) and arrived(), 'the axes moved by the step')
        before = len(newest)
        client.spin_until(
            lambda: len(newest) > before + 300 and '/copley: timekeeping' in told, 'held'
        )
        assert all(
            np.all(np.abs(np.array(one.counts[:3]) - STEPS) < 0.05 * np.array(STEPS))
            for one in newest[before:]
        )
        values = {one.key: one.value for one in told['/copley: timekeeping'].values}
        assert int(values['current_command received']) > 500
        assert int(values['current_command missed']) > 0, 'it was not missed while it stood'
        assert int(values['current_command contradicting']) == 0
        assert pmac.process.poll() is None, pmac.output
    finally:
        pmac.process.terminate()
        code = pmac.process.wait(PATIENCE_S)
    assert code == 0, pmac.output


def test_the_conformance_kit_finds_nothing_wrong_with_the_pmac(build):
    check_conformance('pmac', [build('pmac'), *pmac_arguments()], FORGIVEN)


def test_the_conformance_kit_finds_nothing_wrong_with_the_amplifiers(build):
    check_conformance('copley', [build('copley'), *copley_arguments()], FORGIVEN)
