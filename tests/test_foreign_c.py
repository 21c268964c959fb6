# SPDX-License-Identifier: Apache-2.0
"""
A PMAC and amplifiers in C and in C++, from docs/contract.md, that share nothing but the messages.

Those in C++ need rclcpp, which comes with a ROS 2 installation; PyPI has none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest
from foreign_peers import (
    PASSED_OVER,
    check_conformance,
    check_real_time,
    check_same_bits,
    copley_arguments,
    pmac_arguments,
)

HERE = Path(__file__).parent
LIBRARIES = ('rcl', 'rcutils', 'rosidl_runtime_c')
MESSAGES = 'waferbot_msgs__rosidl_typesupport_c', 'waferbot_msgs__rosidl_generator_c'
DURATION_S, LONG_S = 0.5, 2.0

pytestmark = [pytest.mark.slow, pytest.mark.long(90)]


@pytest.fixture(scope='module', params=['c', 'cpp'])
def build(request, tmp_path_factory):
    """Give a function that builds a program against whatever ROS 2 is there, once, in C or C++."""
    prefixes = [Path(one) for one in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if one]
    folder = tmp_path_factory.mktemp(f'foreign_{request.param}')
    return (in_c if request.param == 'c' else in_cpp)(prefixes, folder)


def in_cpp(prefixes, folder):
    if not shutil.which('cmake') or not any((one / 'share/rclcpp').is_dir() for one in prefixes):
        pytest.skip('no cmake, or a ROS 2 without rclcpp')
    where = f'-DCMAKE_PREFIX_PATH={";".join(map(str, prefixes))}'
    for step in (['-S', HERE / 'foreign_cpp', '-B', folder, where], ['--build', folder]):
        built = subprocess.run(['cmake', *map(str, step)], capture_output=True, text=True)
        assert built.returncode == 0, built.stdout + built.stderr
    return lambda name: str(folder / name)


def in_c(prefixes, folder):
    compiler = shutil.which('cc')
    if compiler is None or not any((one / 'include/rcl/rcl/rcl.h').is_file() for one in prefixes):
        pytest.skip('no C compiler, or a ROS 2 without headers')
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
                '-D_POSIX_C_SOURCE=200809L', *includes, str(HERE / 'foreign_c' / f'{name}.c'),
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
def test_a_pmac_gives_the_same_bits_as_ours(build, tmp_path, start, layout):
    peers = {'pmac': [build('pmac'), *pmac_arguments()]}
    check_same_bits(start, tmp_path, peers, DURATION_S, layout)


@pytest.mark.parametrize(
    'layout', [(), ('--compose', 'plant,pmac')], ids=['four processes', 'composed']
)
def test_amplifiers_give_the_same_bits_as_ours(build, tmp_path, start, layout):
    peers = {'copley': [build('copley'), *copley_arguments()]}
    check_same_bits(start, tmp_path, peers, DURATION_S, layout)


def test_with_both_of_them_only_the_plant_is_ours(build, tmp_path, start):
    peers = {
        'pmac': [build('pmac'), *pmac_arguments()],
        'copley': [build('copley'), *copley_arguments()],
    }
    check_same_bits(start, tmp_path, peers, LONG_S)


@pytest.mark.alone  # asks for the wall clock
def test_in_real_time_the_pmac_moves_the_axes_also_after_a_pause(
    build, start, domain, connect, tmp_path
):
    command = [build('pmac'), *pmac_arguments()]
    log = tmp_path / 'pmac.log'
    check_real_time(
        start, connect(domain), domain, log, 'pmac', command, patience_s=0.1, stands_still=True
    )


@pytest.mark.alone  # asks for the wall clock
def test_in_real_time_amplifiers_move_the_axes(build, start, domain, connect, tmp_path):
    command = [build('copley'), *copley_arguments()]
    log = tmp_path / 'copley.log'
    check_real_time(start, connect(domain), domain, log, 'copley', command, patience_s=1.0)


def test_the_conformance_kit_finds_nothing_wrong_with_the_pmac(build):
    check_conformance('pmac', [build('pmac'), *pmac_arguments()], PASSED_OVER)


def test_the_conformance_kit_finds_nothing_wrong_with_the_amplifiers(build):
    check_conformance('copley', [build('copley'), *copley_arguments()], PASSED_OVER)
