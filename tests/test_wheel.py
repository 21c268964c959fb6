# SPDX-License-Identifier: Apache-2.0
"""
The wheel, in an environment without ROS and without this checkout.

It is built from a copy of the sources and installed into an empty environment, into which only what
its metadata require, and what these require in turn, is linked from the environment of the tests.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PATIENCE_S = 800.0
"""Most of it is for compiling the model, once, at its new place."""

pytestmark = [pytest.mark.slow, pytest.mark.long(50), pytest.mark.timeout(900)]


def required(name: str, seen: set[str]) -> Iterator[metadata.Distribution]:
    """Yield a distribution and all that it requires here, without extras."""
    if name.lower().replace('_', '-') in seen:
        return
    seen.add(name.lower().replace('_', '-'))
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return  # for another platform or Python
    yield found
    for line in found.requires or ():
        if 'extra ==' not in line:
            yield from required(re.match(r'[\w.-]+', line).group(), seen)


def link(distribution: metadata.Distribution, site: Path) -> None:
    """Link what a distribution has at the top of site-packages."""
    for top in {file.parts[0] for file in distribution.files if file.parts[0] != '..'}:
        source = Path(distribution.locate_file(top))
        if top != '__pycache__' and source.exists() and not (site / top).exists():
            (site / top).symlink_to(source)


@pytest.fixture(scope='module')
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp('wheel')
    sources = folder / 'sources'
    sources.mkdir()
    for name in ('pyproject.toml', 'README.md', 'LICENSE', 'requirements', 'src'):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, sources / name)
    built = subprocess.run(
        [
            *(sys.executable, '-m', 'pip', 'wheel', '--quiet', '--no-deps'),
            *('--no-build-isolation', '--wheel-dir', str(folder), str(sources)),
        ],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert built.returncode == 0, built.stderr
    (made,) = folder.glob('*.whl')
    return made


@pytest.fixture(scope='module')
def installed(wheel, tmp_path_factory) -> Path:
    """The folder of the programs of an environment that has the wheel and what it requires."""
    folder = tmp_path_factory.mktemp('environment')
    venv.create(folder, with_pip=False)
    (site,) = folder.glob('lib/python*/site-packages')
    subprocess.run(
        [
            *(sys.executable, '-m', 'pip', f'--python={folder}/bin/python', 'install'),
            *('--quiet', '--no-deps', '--no-index', str(wheel)),
        ],
        check=True,
        timeout=PATIENCE_S,
    )
    (own,) = metadata.distributions(name='waferbot', path=[str(site)])
    for line in own.requires:
        if 'extra ==' not in line:
            for distribution in required(re.match(r'[\w.-]+', line).group(), set()):
                link(distribution, site)
    return folder / 'bin'


@pytest.fixture
def run(installed, tmp_path_factory):
    """Run a program of the environment in an empty folder with an empty environment."""
    home = tmp_path_factory.getbasetemp() / 'home'
    home.mkdir(exist_ok=True)

    def program(*arguments: str, cwd: Path = home) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(installed / arguments[0]), *arguments[1:]],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            env={'HOME': str(home), 'PATH': '/usr/bin:/bin', 'LANG': 'C.UTF-8'},
            stdin=subprocess.DEVNULL,
            cwd=cwd,
        )

    return program


def test_there_is_no_ros_and_no_checkout_in_the_environment(run):
    for module in ('rclpy', 'waferbot_msgs', 'ament_index_python'):
        assert f"No module named '{module}'" in run('python', '-c', f'import {module}').stderr
    where = run('python', '-c', 'import waferbot_twin; print(waferbot_twin.__file__)').stdout
    assert 'site-packages' in where
    assert str(ROOT) not in where


def test_the_version_is_that_of_the_sources_alone(run):
    from waferbot_twin.version import VERSION

    done = run('waferbot', '--version')
    assert (done.returncode, done.stdout) == (0, f'waferbot {VERSION}\n'), done.stderr


def test_it_is_typed_and_no_tests_are_in_it(installed):
    (site,) = installed.parent.glob('lib/python*/site-packages')
    packages = [path for path in site.glob('waferbot*') if path.suffix != '.dist-info']
    assert len(packages) == 6
    for package in packages:
        assert (package / 'py.typed').is_file(), package
    assert not list(site.glob('waferbot*/**/test_*.py'))
    assert not (site / 'test').exists()


def test_a_run_in_one_process_records_replays_and_compares(run, tmp_path):
    out = tmp_path / 'out'
    done = run(
        *('waferbot', 'run', '--engine', 'inprocess', '--experiment', 'step'),
        *('--duration', '0.05', '--out', str(out)),
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(run('waferbot', 'info', str(out), '--json').stdout)
    assert told['missing'] == 0
    replayed = run('waferbot', 'replay', str(out), '--node', 'copley')
    assert replayed.returncode == 0, replayed.stderr


def test_its_recording_is_that_of_an_environment_with_ros(run, tmp_path):
    from harness import run_engine

    done = run(
        *('waferbot', 'run', '--engine', 'inprocess', '--experiment', 'step'),
        *('--duration', '0.02', '--out', str(tmp_path / 'out')),
    )
    assert done.returncode == 0, done.stderr
    from waferbot_twin.recording.compare import differing_signals
    from waferbot_twin.recording.reader import read_content, read_recording, recording_file

    with_ros = run_engine('inprocess', tmp_path / 'with_ros', duration_s=0.02)
    without = read_recording(tmp_path / 'out')
    assert differing_signals(with_ros, without) == []
    one, other = (read_content([recording_file(r.path)]) for r in (with_ros, without))
    assert one.definitions == other.definitions
    assert one.hashes == other.hashes


def test_the_interface_finds_models_machines_mappings_and_the_logs_of_the_demo(run, tmp_path):
    done = run(
        'python',
        '-c',
        'import waferbot as wb\n'
        'from pathlib import Path\n'
        'from waferbot_twin.cli.demo import make_logs\n'
        'from waferbot_twin.logs.mapping import load_mapping\n'
        "print(wb.load_model('as_built'))\n"
        "print(load_mapping('emps').name)\n"
        'make_logs(Path())\n'
        "print(len(wb.load_logs('steps')[0].to_dataframe(wb.load_model('rigid'))))\n",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    model, mapping, rows = done.stdout.splitlines()
    assert (model, mapping) == ("Model('as_built')", 'EMPS')
    assert int(rows) > 1000


def test_every_command_can_be_imported(run):
    done = run(
        'python',
        '-c',
        'from waferbot_twin.cli.main import COMMANDS, build_parser\n'
        'for name in COMMANDS:\n'
        '    build_parser(name).format_help()\n'
        'print(len(COMMANDS))\n',
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 15


@pytest.mark.parametrize(
    'command',
    [
        ('run',),
        ('run', '--engine', 'ros'),
        ('run', '--engine', 'composed'),
        ('demo', '--out', 'demo'),
    ],
    ids=' '.join,
)
def test_what_needs_ros_says_so_in_one_line(run, tmp_path, command):
    done = run('waferbot', *command, cwd=tmp_path)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith('waferbot: error: nodes over ROS 2 need ROS 2 Jazzy')
    assert '--engine inprocess' in last
    assert 'Traceback' not in done.stderr
