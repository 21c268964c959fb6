# SPDX-License-Identifier: Apache-2.0
"""Plant, PMAC and Copley share the contract and nothing else."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCKS = ('waferbot_plant', 'waferbot_pmac', 'waferbot_copley')
ROS = {'rclpy', 'waferbot_msgs', 'std_msgs', 'sensor_msgs', 'std_srvs', 'rosgraph_msgs',
       'diagnostic_msgs', 'rcl_interfaces'}  # fmt: skip
MACHINE_PATH = re.compile(rb'(?<![\w.])/(?:home|Users|root|work)/[\w.-]+')


def sources(package):
    folder = ROOT / 'src' / package / package
    found = sorted(folder.rglob('*.py'))
    assert found
    return found


def imported(path):
    """Return the top packages that a file imports anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text('utf-8'))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add((node.module or '').split('.')[0])
        elif isinstance(node, ast.Call) and getattr(node.func, 'attr', '') == 'import_module':
            names |= {str(a.value).split('.')[0] for a in node.args if isinstance(a, ast.Constant)}
    return names


@pytest.mark.parametrize('package', BLOCKS)
def test_blocks_never_import_one_another_or_the_twin(package):
    others = ({*BLOCKS} - {package}) | {'waferbot_twin'}
    for path in sources(package):
        assert not imported(path) & others, path


@pytest.mark.parametrize('package', BLOCKS)
def test_model_files_import_no_ros(package):
    for path in sources(package):
        if path.name != 'node.py':
            assert not imported(path) & ROS, path


@pytest.mark.parametrize('package', BLOCKS)
def test_the_node_is_the_only_door_to_ros(package):
    assert 'rclpy' in imported(ROOT / 'src' / package / package / 'node.py') | imported(
        ROOT / 'src' / 'waferbot_lockstep' / 'waferbot_lockstep' / 'node.py'
    )


def test_lockstep_imports_no_block():
    for path in sources('waferbot_lockstep'):
        assert not imported(path) & {*BLOCKS, 'waferbot_twin'}, path


@pytest.mark.parametrize('package', BLOCKS)
def test_package_manifest_depends_on_no_other_block(package):
    manifest = (ROOT / 'src' / package / 'package.xml').read_text('utf-8')
    for other in {*BLOCKS} - {package}:
        assert f'>{other}<' not in manifest


def of_the_tree():
    """Return the files of the tree: what git tracks, or in a source archive all that is not made."""
    listed = subprocess.run(
        ['git', '-C', str(ROOT), 'ls-files', '-z'], capture_output=True, check=False
    )
    if listed.returncode == 0:
        return [ROOT / name for name in listed.stdout.decode().split('\0') if name]
    archived = [path for path in ROOT.iterdir() if path.is_file()]
    for folder in ('src', 'tests', 'docs', 'requirements', '.ci'):
        archived += [
            path for path in (ROOT / folder).rglob('*') if '__pycache__' not in path.parts
        ]
    return archived


def test_nothing_in_the_tree_names_a_path_of_one_machine():
    files = [path for path in of_the_tree() if path.is_file()]
    assert len(files) > 300
    for path in files:
        if path != Path(__file__):
            found = MACHINE_PATH.findall(path.read_bytes())
            assert not found, f'{path.relative_to(ROOT)}: {found}'
