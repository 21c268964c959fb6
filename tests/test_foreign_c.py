# SPDX-License-Identifier: Apache-2.0
"""A PMAC in C, written from docs/contract.md, that shares nothing with ours but the messages."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from harness import Program, domain_of, run_engine, waferbot

from waferbot_lockstep.contract import AXES, LOCKSTEP_TOPICS
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording

SOURCE = Path(__file__).parent / 'foreign_c' / 'pmac.c'
LIBRARIES = ('rcl', 'rcutils', 'rosidl_runtime_c')
MESSAGES = 'waferbot_msgs__rosidl_typesupport_c', 'waferbot_msgs__rosidl_generator_c'
GIVEN = ('Ixx08', 'Ixx09', 'Ixx29', 'Ixx30', 'Ixx31', 'Ixx32', 'Ixx33', 'amplifier_peak_current')
STEPS = (2500, 800, 1000)  # counts, as in the experiment `step`
STEP_TICK = 360
DURATION_S = 0.5


@pytest.fixture(scope='module')
def pmac(tmp_path_factory):
    """The program, built against whatever ROS 2 is there."""
    compiler = shutil.which('cc')
    prefixes = [Path(one) for one in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if one]
    if compiler is None or not any((one / 'include/rcl/rcl/rcl.h').is_file() for one in prefixes):
        pytest.skip('no C compiler, or a ROS 2 without headers')
    program = tmp_path_factory.mktemp('foreign_c') / 'pmac'
    includes = [f'-I{folder}' for one in prefixes for folder in (one / 'include').glob('*')]
    searched = [f'-L{one}/lib' for one in prefixes]
    found_at_run_time = [f'-Wl,-rpath,{one}/lib' for one in prefixes]
    linked = [f'-l{name}' for name in (*LIBRARIES, *MESSAGES)]
    if sysconfig.get_config_var('Py_ENABLE_SHARED'):  # the messages of PyPI's wheels look for it
        folder, version = sysconfig.get_config_vars('LIBDIR', 'LDVERSION')
        linked += [
            '-Wl,--no-as-needed',
            f'-L{folder}',
            f'-Wl,-rpath,{folder}',
            f'-lpython{version}',
        ]
    built = subprocess.run(
        [
            compiler, '-std=c11', '-O2', '-Wall', '-Wextra', '-Werror', '-ffp-contract=off',
            '-D_POSIX_C_SOURCE=200809L', *includes, str(SOURCE), '-o', str(program),
            *searched, *found_at_run_time, *linked, '-lm', '-Wl,--allow-shlib-undefined',
        ],
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return program


def arguments():
    """Return the numbers that the program takes: those of the rigid model."""
    plan = make_plan('rigid', 'step', DURATION_S)
    settings = {axis: plan.model.parameters['pmac'][axis] for axis in AXES}
    values = servo_parameters(settings)[0]
    numbers = [STEP_TICK]
    for place, counts in enumerate(STEPS):
        numbers += [counts, *(values[name][place] for name in GIVEN)]
    return [str(number) for number in numbers]


@pytest.mark.slow
@pytest.mark.parametrize(
    'layout', [(), ('--compose', 'plant,copley')], ids=['four processes', 'composed']
)
def test_a_pmac_in_c_gives_the_same_bits_as_ours(pmac, tmp_path, start, layout):
    out = tmp_path / 'run'
    twin = start(
        'waferbot_twin', 'run', '--without', 'pmac', '--duration', str(DURATION_S),
        '--out', str(out), *layout,
    )  # fmt: skip
    environment = {
        'ROS_DOMAIN_ID': str(domain_of(twin)),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    stranger = Program([str(pmac), *arguments()], tmp_path / 'pmac.log', environment)
    try:
        code = twin.wait()
    finally:
        stranger.process.terminate()
        stranger.process.wait(10)
    assert code == 0, twin.output + stranger.output
    assert stranger.process.returncode == 0, stranger.output
    one = read_recording(out)
    other = run_engine('inprocess', tmp_path / 'ours', duration_s=DURATION_S)
    for topic in LOCKSTEP_TOPICS:
        np.testing.assert_array_equal(one[topic], other[topic], err_msg=topic.name)
    assert len(one['current_command']) == 1125
    assert [name for name in differing_signals(one, other) if 'servo_state' not in name] == []


@pytest.mark.slow
def test_the_conformance_kit_finds_nothing_wrong_with_it(pmac):
    result = waferbot('conform', '--node', 'pmac', '--json', str(pmac), *arguments())
    assert result.returncode == 0, result.stdout + result.stderr
    grades = {one['check']: one['grade'] for one in json.loads(result.stdout)}
    forgiving = {'stale message', 'missing message', 'contradicting message', 'silence'}
    assert {check for check, grade in grades.items() if grade == 'tolerated'} == forgiving
    assert set(grades.values()) == {'right', 'tolerated'}
