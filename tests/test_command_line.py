# SPDX-License-Identifier: Apache-2.0
"""The command line as a user meets it."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys

import pytest
from harness import PATIENCE_S, called, waferbot

from waferbot_twin.cli.main import COMMANDS as MODULES
from waferbot_twin.cli.main import main

COMMANDS = tuple(MODULES)
FAST = ('run', '--engine', 'inprocess', '--duration', '0.01')

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def short_run(tmp_path_factory):
    out = tmp_path_factory.mktemp('command_line') / 'short'
    result = called('run', '--engine', 'inprocess', '--duration', '0.1', '--out', str(out))
    assert result.returncode == 0, result.stderr
    return out


def test_help_names_every_command():
    result = waferbot('--help')
    assert result.returncode == 0
    for command in COMMANDS:
        assert command in result.stdout


@pytest.mark.parametrize('command', COMMANDS)
def test_each_command_has_help(command):
    result = called(command, '--help')
    assert result.returncode == 0
    assert 'usage: waferbot ' + command in result.stdout


def test_the_compiler_is_not_loaded_to_say_what_there_is():
    asked = (
        'import sys; from waferbot_twin.cli import main\n'
        'try: main(["--help"])\n'
        'except SystemExit: print("compiler" if "numba" in sys.modules else "no compiler")'
    )
    result = subprocess.run(
        [sys.executable, '-c', asked], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert result.stdout.splitlines()[-1] == 'no compiler', result.stderr


@pytest.mark.parametrize('engine', ['inprocess', 'composed'])
def test_run_tells_its_result_as_json(engine):
    result = waferbot('run', '--engine', engine, '--duration', '0.02', '--json')
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told['ticks'] == 360
    assert told['engine'] == engine


def test_info_replay_tell_their_result_as_json(short_run):
    info = json.loads(called('info', str(short_run), '--json').stdout)
    assert info['closed'] is True
    assert info['missing'] == 0
    rates = {topic['name']: topic['rate_hz'] for topic in info['topics']}
    assert rates['/phase_currents'] == pytest.approx(18000)
    assert rates['/encoders'] == pytest.approx(9000)
    assert rates['/servo_state'] == pytest.approx(2250)
    replay = json.loads(called('replay', str(short_run), '--node', 'pmac', '--json').stdout)
    assert replay['identical'] is True


def test_plot_draws_a_picture(short_run, tmp_path):
    picture = tmp_path / 'picture.png'
    result = called('plot', str(short_run), '--out', str(picture))
    assert result.returncode == 0, result.stderr
    assert picture.read_bytes().startswith(b'\x89PNG')
    picture.write_bytes(b'of somebody else')
    refused = called('plot', str(short_run), '--out', str(picture))
    assert refused.returncode == 1
    assert 'exists already; choose another file or give --force' in refused.stderr
    assert picture.read_bytes() == b'of somebody else'
    assert called('plot', str(short_run), '--out', str(picture), '--force').returncode == 0
    assert picture.read_bytes().startswith(b'\x89PNG')


MISTAKES = {
    'unknown model': ((*FAST, '--model', 'rigit'), "did you mean 'rigid'"),
    'unknown experiment': ((*FAST, '--experiment', 'stepp'), 'stepp'),
    'missing model file': ((*FAST, '--model', 'nowhere.yaml'), 'nowhere.yaml'),
    'missing experiment file': ((*FAST, '--experiment', 'nowhere.yaml'), 'nowhere.yaml'),
    'no recording': (('info', 'nowhere'), 'nowhere does not exist'),
    'not a recording': (('info', '.'), 'holds no recording'),
    'replay of nothing': (('replay', 'nowhere', '--node', 'pmac'), 'nowhere'),
    'plot of nothing': (('plot', 'nowhere'), 'nowhere'),
    'no time': (('run', '--duration', '0'), '--duration'),
    'backwards': (('run', '--duration', '-1'), '--duration'),
    'not a number': (('run', '--duration', 'nan'), '--duration'),
    'domain out of range': (('run', '--domain', '999', '--duration', '0.01'), '232'),
    'domain of the environment': (('run', '--duration', '0.01'), 'ROS_DOMAIN_ID'),
    'unknown node': (
        ('run', '--engine', 'composed', '--without', 'pmak', '--duration', '0.01'),
        "did you mean 'pmac'?",
    ),
    'nodes without ROS': (
        (*FAST, '--without', 'pmac'),
        '--without is for nodes over ROS; with --engine inprocess there are none',
    ),
    'no FMU': (('run', '--plant', 'plant.fmu'), 'plant.fmu: no such file'),
    'nodes beside an FMU': (
        ('run', '--plant', 'plant.fmu', '--engine', 'inprocess', '--device-clock', 'hold'),
        '--device-clock is for nodes over ROS; with --engine inprocess there are none',
    ),
}


@pytest.mark.parametrize('mistake', MISTAKES)
def test_a_mistake_is_told_in_one_line(mistake, tmp_path, monkeypatch):
    arguments, hint = MISTAKES[mistake]
    monkeypatch.chdir(tmp_path)
    if 'environment' in mistake:
        monkeypatch.setenv('ROS_DOMAIN_ID', 'many')
    result = called(*arguments)
    assert result.returncode == 1, result.stdout
    assert result.stderr.startswith('waferbot: error: ')
    assert result.stderr.count('\n') == 1, result.stderr
    assert hint in result.stderr


def test_the_version_is_told():
    result = waferbot('--version')
    assert result.returncode == 0
    assert re.fullmatch(r'waferbot \d+\.\d+\.\d+( \([0-9a-f]{7,}(-dirty)?\))?\n', result.stdout)


def test_a_misspelt_command_is_answered_with_the_nearest():
    result = called('dianose', 'log')
    assert result.returncode == 2
    assert "there is no command 'dianose'; did you mean 'diagnose'?" in result.stderr
    assert 'Traceback' not in result.stderr


def test_a_model_with_a_value_out_of_range_names_the_range(tmp_path):
    model = tmp_path / 'bad.yaml'
    model.write_text('/**/pmac: {ros__parameters: {y_linear: {Ixx69: 99999}}}\n')
    result = called(*FAST, '--model', str(model))
    assert result.returncode == 1
    assert result.stderr.startswith('waferbot: error: ')
    assert '32767' in result.stderr


@pytest.mark.parametrize(
    ('arguments', 'nearest'),
    [
        (('run', '--enigne', 'inprocess'), '--engine'),
        (('run', '--sed=3'), '--seed'),
        (('run', '--engine', 'inproces'), 'inprocess'),
        (('replay', 'run', '--node', 'pmak'), 'pmac'),
    ],
)
def test_a_misspelt_option_or_choice_is_answered_with_the_nearest(arguments, nearest, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert told.startswith(f'usage: waferbot {arguments[0]}')
    assert told.endswith(f'did you mean {nearest!r}?\n')


@pytest.mark.parametrize('arguments', [('run', '--speed', '2'), ('fly',), ()])
def test_an_unknown_option_or_command_is_refused_without_traceback(arguments):
    result = called(*arguments)
    assert result.returncode != 0
    assert 'Traceback' not in result.stderr
    assert 'usage: waferbot' in result.stderr


AT_ONCE = """
import sys
from waferbot_twin.cli import console, main
console.QUIET_S = 0.0
sys.exit(main(sys.argv[1:]))
"""
"""The command, with progress told from the beginning and not only where it takes long."""


def on_terminal(*arguments):
    """Run a command with standard error on a terminal; return exit code and what it drew."""
    leader, follower = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, '-c', AT_ONCE, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=follower,
        env={**os.environ, 'TERM': 'xterm', 'COLUMNS': '80'},
    )
    os.close(follower)
    drawn = b''
    while True:
        try:
            data = os.read(leader, 4096)
        except OSError:  # Linux: the other side is closed
            break
        if not data:
            break
        drawn += data
    os.close(leader)
    return process.wait(PATIENCE_S), drawn.decode('utf-8', 'replace')


def test_a_progress_bar_is_drawn_on_a_terminal_only():
    arguments = ('run', '--engine', 'composed', '--duration', '0.5', '--experiment', 'constant')
    code, drawn = on_terminal(*arguments)
    assert code == 0
    assert 'constant on rigid' in drawn
    assert '%' in drawn
    piped = subprocess.run(
        [sys.executable, '-c', AT_ONCE, *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert piped.returncode == 0
    assert 'constant on rigid: about' in piped.stderr
    assert '%' not in piped.stderr
    assert '\x1b' not in piped.stderr + piped.stdout


def test_output_into_a_closed_pipe_is_no_error(short_run):
    command = f'{sys.executable} -m waferbot_twin info {short_run} | head -n 1'
    result = subprocess.run(
        ['bash', '-o', 'pipefail', '-c', command],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert 'Traceback' not in result.stderr
