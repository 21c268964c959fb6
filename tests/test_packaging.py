# SPDX-License-Identifier: Apache-2.0
"""What the packages say of themselves: versions, licence, dependencies; the same everywhere."""

from __future__ import annotations

import ast
import itertools
import re
import sys
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from waferbot_twin.version import VERSION

ROOT = Path(__file__).parent.parent
PACKAGES = sorted(path.parent for path in ROOT.glob('src/*/package.xml'))
PYTHON_PACKAGES = [package for package in PACKAGES if (package / 'setup.py').exists()]

KEYS = {
    name: f'python3-{name}'
    for name in (
        *(
            'hypothesis',
            'jinja2',
            'joblib',
            'jsonschema',
            'matplotlib',
            'numba',
            'numpy',
            'pandas',
        ),
        *('pytest', 'rich', 'scipy', 'sympy'),
    )
} | {
    'yaml': 'python3-yaml',
    'markupsafe': 'python3-jinja2',  # what jinja2 itself stands on
    'waferbot': 'waferbot_twin',
}
"""Keys of rosdep for what is imported; a ROS package is its own key."""

WITHOUT_KEY = {'mcap', 'rosbags', 'zstandard'}
"""pip installs them beside rosdep, as README says; zstandard comes with mcap."""

NOT_INSTALLED = {'SALib', 'distributed', 'fmpy', 'pyarrow', 'pymoo'}
"""
Imported where they are there; who uses `sweep`, `optimise` with several measures, `--cluster`, `--plant`
or has logs in Parquet installs them.
"""

NOT_IMPORTED = {'robot_state_publisher', 'sros2'}
"""Started by the launch file, and by `waferbot secure`."""

DISTRIBUTIONS = {'yaml': 'pyyaml'}


def imports(folders: Iterable[Path]) -> set[str]:
    """Return what is imported from outside the standard library, by its first name."""
    found: set[str] = set()
    for folder in folders:
        for file in folder.rglob('*.py'):
            for node in ast.walk(ast.parse(file.read_text('utf-8'))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.split('.')[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and not node.level:
                    found.add(node.module.split('.')[0])
    return {name for name in found if name not in sys.stdlib_module_names}


def sources(package: Path) -> list[Path]:
    return [path for path in package.iterdir() if path.name.startswith('waferbot')] + [
        package / 'launch'
    ]


def of_package_xml(package: Path, tag: str) -> list[str]:
    return [element.text for element in ElementTree.parse(package / 'package.xml').iter(tag)]


def of_setup(package: Path, keyword: str) -> object:
    """Return a keyword of the call of `setup` in setup.py, where it is written out."""
    (call,) = [
        node
        for node in ast.walk(ast.parse((package / 'setup.py').read_text('utf-8')))
        if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'setup'
    ]
    (value,) = [word.value for word in call.keywords if word.arg == keyword]
    return ast.literal_eval(value)


@pytest.mark.parametrize('package', PYTHON_PACKAGES, ids=lambda path: path.name)
def test_every_import_has_its_key_and_every_key_is_needed(package):
    imported = imports(sources(package)) - {package.name, 'waferbot'} - NOT_INSTALLED
    needed = {KEYS.get(name, name) for name in imported - WITHOUT_KEY}
    declared = set(of_package_xml(package, 'exec_depend'))
    assert needed <= declared, needed - declared
    assert declared - needed <= NOT_IMPORTED, declared - needed


@pytest.mark.parametrize('package', PYTHON_PACKAGES, ids=lambda path: path.name)
def test_every_import_of_a_test_has_its_key(package):
    own = {file.stem for file in (package / 'test').rglob('*.py')}
    imported = imports([package / 'test']) - {package.name, 'waferbot'} - own
    of_pip = {'control', 'fmpy', 'mcap_ros2', 'mujoco', 'nbclient', 'nbformat', 'pinocchio'}
    without = WITHOUT_KEY | NOT_INSTALLED | of_pip
    needed = {KEYS.get(name, name) for name in imported - without}
    declared = {*of_package_xml(package, 'exec_depend'), *of_package_xml(package, 'test_depend')}
    assert needed <= declared, needed - declared


@pytest.mark.slow
def test_the_wheel_requires_what_is_imported_and_no_more():
    lines = (ROOT / 'requirements' / 'runtime.txt').read_text('utf-8').splitlines()
    required = {re.split(r'[<>=~]', line)[0].lower() for line in lines if line[:1].isalpha()}
    imported = imports(folder for package in PYTHON_PACKAGES for folder in sources(package))
    distributions = metadata.packages_distributions()
    from_ros = {
        name
        for name in imported
        if name.startswith('waferbot')
        or any(one.startswith('ros-') for one in distributions.get(name, ()))
    }
    ours = {name for name in imported if name.endswith(('_msgs', '_interfaces'))}
    ours |= {name for name in imported if name.startswith('launch')}
    outside = imported - from_ros - ours - NOT_INSTALLED
    assert {DISTRIBUTIONS.get(name, name) for name in outside} == required


PYTHONS = re.findall(
    r'"Programming Language :: Python :: (3\.\d+)"', (ROOT / 'pyproject.toml').read_text('utf-8')
)
"""Those that the metadata promise, and the workflow of CI tries."""


def required_lines(file: Path) -> list[Requirement]:
    """Return the requirements of a file in the format of pip, without comments."""
    lines = (line.partition('#')[0].strip() for line in file.read_text('utf-8').splitlines())
    return [Requirement(line) for line in lines if line]


@pytest.mark.parametrize('python', PYTHONS)
def test_the_lock_of_every_python_pins_what_is_required_within_its_bounds(python):
    locked = {}
    for pin in required_lines(ROOT / 'requirements' / f'lock-python{python}.txt'):
        (exact,) = pin.specifier
        assert exact.operator == '=='
        locked[canonicalize_name(pin.name)] = exact.version
    for name in ('ros-jazzy', 'runtime', 'development'):
        for needed in required_lines(ROOT / 'requirements' / f'{name}.txt'):
            version = locked[canonicalize_name(needed.name)]
            assert needed.specifier.contains(version), f'{needed}: {version}'


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_versions_licence_and_addresses_agree(package):
    assert of_package_xml(package, 'name') == [package.name]
    assert of_package_xml(package, 'version') == [VERSION]
    assert of_package_xml(package, 'license') == ['Apache-2.0']
    first = ElementTree.parse(PACKAGES[0] / 'package.xml').getroot()
    root = ElementTree.parse(package / 'package.xml').getroot()
    assert [(url.get('type'), url.text) for url in root.iter('url')] == [
        (url.get('type'), url.text) for url in first.iter('url')
    ]
    assert {url.get('type') for url in root.iter('url')} == {'website', 'repository', 'bugtracker'}
    address = root.find('maintainer').get('email')
    assert address == first.find('maintainer').get('email')
    assert f'email = "{address}"' in (ROOT / 'pyproject.toml').read_text('utf-8')
    if package in PYTHON_PACKAGES:
        assert of_setup(package, 'version') == VERSION
        assert of_setup(package, 'maintainer_email') == address
        assert of_setup(package, 'description') == root.find('description').text
        assert of_setup(package, 'url') == root.find("url[@type='website']").text


@pytest.mark.parametrize('package', PACKAGES, ids=lambda path: path.name)
def test_the_changelog_is_one_that_bloom_reads(package):
    """Title, then a section for each version, newest first, with its date, or Forthcoming."""
    lines = (package / 'CHANGELOG.rst').read_text('utf-8').splitlines()
    title = f'Changelog for package {package.name}'
    assert lines[:3] == ['^' * len(title), title, '^' * len(title)]
    sections = [
        (line, under) for line, under in itertools.pairwise(lines) if under and set(under) == {'-'}
    ]
    assert all(len(line) == len(under) for line, under in sections)
    assert all(
        re.fullmatch(r'Forthcoming|\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)', s) for s, _ in sections
    )
    assert sections


def test_the_citation_is_of_this_version():
    text = (ROOT / 'CITATION.cff').read_text('utf-8')
    assert re.search(r'^version: (.*)$', text, re.MULTILINE).group(1) == VERSION
    assert re.search(r'^license: (.*)$', text, re.MULTILINE).group(1) == 'Apache-2.0'
