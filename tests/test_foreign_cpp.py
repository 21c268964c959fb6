# SPDX-License-Identifier: Apache-2.0
"""
A PMAC and amplifiers in C++ on rclcpp, from docs/contract.md, that share nothing but the messages.

rclcpp comes with a ROS 2 installation; PyPI has none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
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

SOURCES = Path(__file__).parent / 'foreign_cpp'
LONG_S = 2.0

pytestmark = [pytest.mark.slow, pytest.mark.long(90)]


@pytest.fixture(scope='module')
def build(tmp_path_factory):
    """Give a function that returns a program, built against the rclcpp that is there, once."""
    prefixes = [Path(one) for one in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if one]
    if not shutil.which('cmake') or not any((one / 'share/rclcpp').is_dir() for one in prefixes):
        pytest.skip('no cmake, or a ROS 2 without rclcpp')
    folder = tmp_path_factory.mktemp('foreign_cpp')
    where = f'-DCMAKE_PREFIX_PATH={";".join(map(str, prefixes))}'
    for step in (['-S', SOURCES, '-B', folder, where], ['--build', folder]):
        built = subprocess.run(
            ['cmake', *map(str, step)], capture_output=True, text=True, timeout=600
        )
        assert built.returncode == 0, built.stdout + built.stderr
    return lambda name: str(folder / name)


@pytest.mark.parametrize(
    'layout', [(), ('--compose', 'plant,copley')], ids=['four processes', 'composed']
)
def test_a_pmac_in_cpp_gives_the_same_bits_as_ours(build, tmp_path, start, layout):
    peers = {'pmac': [build('pmac'), *pmac_arguments()]}
    check_same_bits(start, tmp_path, peers, LONG_S, layout)


def test_with_both_of_them_only_the_plant_is_ours(build, tmp_path, start):
    peers = {
        'pmac': [build('pmac'), *pmac_arguments()],
        'copley': [build('copley'), *copley_arguments()],
    }
    check_same_bits(start, tmp_path, peers, LONG_S)


@pytest.mark.alone  # asks for the wall clock
def test_in_real_time_the_pmac_in_cpp_moves_the_axes_also_after_a_pause(
    build, start, domain, connect, tmp_path
):
    command = [build('pmac'), *pmac_arguments()]
    log = tmp_path / 'pmac.log'
    check_real_time(
        start, connect(domain), domain, log, 'pmac', command, patience_s=0.1, stands_still=True
    )


@pytest.mark.alone  # asks for the wall clock
def test_in_real_time_amplifiers_in_cpp_move_the_axes(build, start, domain, connect, tmp_path):
    command = [build('copley'), *copley_arguments()]
    log = tmp_path / 'copley.log'
    check_real_time(start, connect(domain), domain, log, 'copley', command, patience_s=1.0)


@pytest.mark.parametrize('node', ['pmac', 'copley'])
def test_the_conformance_kit_finds_nothing_wrong(build, node):
    arguments = {'pmac': pmac_arguments, 'copley': copley_arguments}[node]()
    check_conformance(node, [build(node), *arguments], PASSED_OVER)
