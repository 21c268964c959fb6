# SPDX-License-Identifier: Apache-2.0
"""Every command's help has examples, and what they say can be done as it stands there."""

from __future__ import annotations

import json
import shlex
import shutil
from importlib import import_module

import numpy as np
import pytest

from waferbot_twin.cli.main import COMMANDS, build_parser, main

pytestmark = pytest.mark.long(80)

EXAMPLES = {
    command: import_module(f'waferbot_twin.cli.{module}').EXAMPLES
    for command, module in COMMANDS.items()
}
ALL = list(dict.fromkeys(example for examples in EXAMPLES.values() for example in examples))

LONG = tuple(
    example
    for example in ALL
    if example.startswith(
        (
            'waferbot demo',
            'waferbot diagnose',
            'waferbot suggest',
            'waferbot calibrate --quick',
            'waferbot conform',
            'waferbot tune --model as_built --experiment',
            'waferbot tune --model flexible --also',
        )
    )
)
"""Minutes each; their arguments are parsed, other tests run these commands on less."""

SCOPE = """\
signals:
  - {column: position, kind: position, axis: x_rotate, unit: rad}
  - {column: current, kind: current, axis: x_rotate, unit: A_rms}
time: {column: time, unit: ms}
"""
"""A mapping as a user writes it for the trace of a drive."""


def arguments_of(example):
    """Return the arguments behind `waferbot`."""
    program, *arguments = shlex.split(example)
    assert program == 'waferbot'
    return arguments


def output_of(example):
    """Return the folder or file that an example writes, or None."""
    arguments = arguments_of(example)
    return arguments[arguments.index('--out') + 1] if '--out' in arguments else None


@pytest.mark.parametrize('command', COMMANDS)
def test_the_help_shows_examples_of_the_command(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, '--help'])
    assert ended.value.code == 0
    shown = capsys.readouterr().out.partition('examples:\n')[2].splitlines()
    assert [line.strip() for line in shown] == list(EXAMPLES[command])
    assert any(arguments_of(example)[0] == command for example in EXAMPLES[command])


@pytest.mark.parametrize('example', ALL)
def test_its_arguments_are_understood(example):
    arguments = arguments_of(example)
    assert build_parser(arguments[0]).parse_args(arguments).command == arguments[0]


def test_no_two_examples_write_the_same():
    outputs = [output_of(example) for example in ALL if output_of(example)]
    assert len(outputs) == len(set(outputs))


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """The folder in which all examples are run, with what a user would bring."""
    made = tmp_path_factory.mktemp('examples')
    time_ms = np.arange(2000) * 0.5
    position = 0.3 * np.sin(2e-3 * np.pi * time_ms)
    table = np.column_stack([time_ms, position, -12.0 * position])
    np.savetxt(made / 'scope.csv', table, '%.6f', ',', header='time,position,current', comments='')
    (made / 'scope.yaml').write_text(SCOPE, 'utf-8')
    speed, torque = (grid.ravel() for grid in np.meshgrid([20.0, 60.0, 120.0], [0.2, 0.5, 1.0]))
    table = np.column_stack([speed, torque, 50.0 * (0.94 * torque - 0.02 - 1e-4 * speed)])
    header = 'speed_rad_s,input_torque_nm,output_torque_nm'
    np.savetxt(made / 'gearbox_test.csv', table, '%.6f', ',', header=header, comments='')
    return made


@pytest.fixture
def run(folder, monkeypatch, capfd):
    """Give a function that runs an example, and before it the ones that make what it reads."""
    import webbrowser

    from waferbot_twin.view.server import ViewServer

    def serve_once(server):
        assert server.pages['/view.html']
        raise KeyboardInterrupt

    monkeypatch.chdir(folder)
    monkeypatch.setattr(webbrowser, 'open', lambda url: True)
    monkeypatch.setattr(ViewServer, 'serve_forever', serve_once)

    def run_example(example):
        """Run it, unless what it writes is there; return what it prints."""
        out = output_of(example)
        if out and (folder / out).exists():
            return ''
        for maker in ALL:
            made = output_of(maker)
            if maker != example and made in arguments_of(example):
                run_example(maker)
        code = main(arguments_of(example))
        shown = capfd.readouterr()
        assert code == 0, shown.err
        assert out is None or (folder / out).exists()
        return shown.out

    return run_example


NEEDS_SROS2 = pytest.mark.skipif(
    shutil.which('ros2') is None, reason='there is no ros2 command: no `ros2 security`'
)


def marked(example):
    """Return an example as a parameter, left out where what it needs is not there."""
    marks = NEEDS_SROS2 if example.startswith('waferbot secure') else ()
    return pytest.param(example, marks=marks)


@pytest.mark.slow
@pytest.mark.parametrize('example', [marked(example) for example in ALL if example not in LONG])
def test_it_runs(example, run):
    run(example)


JSON_ELSEWHERE = (
    *('run', 'tables', 'tune', 'sweep', 'optimise', 'feedforward', 'frf', 'modes', 'verify'),
)
"""Commands that their own tests ask for JSON; they take long."""

FIRST = {
    command: next((one for one in examples if arguments_of(one)[0] == command), None)
    for command, examples in EXAMPLES.items()
    if command not in JSON_ELSEWHERE
}
"""The first example of each command that is one of its own."""


@pytest.mark.slow
@pytest.mark.parametrize('example', [marked(one) for one in FIRST.values() if one not in LONG])
def test_its_result_is_json_and_nothing_else(example, run):
    command = arguments_of(example)[0]
    out = output_of(example)
    asked = example if out is None else example.replace(f'--out {out}', f'--out as_json/{out}')
    again = ' --force' if '--html' in asked or '--plot' in asked else ''
    told = json.loads(run(f'{asked}{again} --json'))
    assert told or command == 'library', 'an empty library is an empty list'
