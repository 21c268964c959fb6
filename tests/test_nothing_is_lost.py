# SPDX-License-Identifier: Apache-2.0
"""What becomes of a user's data when the disk is full or a command is broken off."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from harness import PATIENCE_S, wait_until

from waferbot_twin.cli.main import main
from waferbot_twin.output_folder import NEW
from waferbot_twin.recording.reader import read_recording

RUN = ('run', '--engine', 'inprocess')
LOG = 'time,angle,current\n' + ''.join(f'{k / 1000},{k * 1e-4},{k % 7}\n' for k in range(500))
MAPPING = """
time: {column: time, unit: s}
signals:
  - {column: angle, axis: x_rotate, kind: position, unit: rad}
  - {column: current, axis: x_rotate, kind: current, unit: A}
"""


def limited(size, *arguments):
    """Run a command that may write no file beyond `size` bytes: as on a disk that is full."""
    return subprocess.run(
        [sys.executable, '-m', 'waferbot_twin', *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
    )


@pytest.fixture(scope='module', autouse=True)
def compiled():
    """Compile, and keep it: there would be no room for that either."""
    assert main([*RUN, '--duration', '0.001']) == 0


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob('*'))
        if path.is_file()
    }


@pytest.fixture
def importing(tmp_path):
    """The arguments that import a small log to `tmp_path / 'log'`."""
    (tmp_path / 'log.csv').write_text(LOG)
    (tmp_path / 'map.yaml').write_text(MAPPING)
    return [
        'import', str(tmp_path / 'log.csv'), '--map', str(tmp_path / 'map.yaml'),
        '--out', str(tmp_path / 'log'),
    ]  # fmt: skip


# ---- a disk that is full -------------------------------------------------------------------------


def test_a_log_that_has_no_room_leaves_the_old_one_or_none(importing, tmp_path):
    for force in ([], ['--force']):
        before = contents(tmp_path)
        result = limited(2000, *importing, *force)
        assert result.returncode == 1
        assert result.stderr.startswith('waferbot: error: ')
        assert result.stderr.count('\n') == 1, result.stderr
        assert 'cannot be written: File too large' in result.stderr
        assert contents(tmp_path) == before
        assert main([*importing, *force]) == 0


def test_a_run_that_has_no_room_keeps_what_was_recorded(tmp_path):
    out = tmp_path / 'run'
    result = limited(600_000, *RUN, '--duration', '2', '--out', out)
    assert result.returncode == 1
    assert 'Traceback' not in result.stderr
    assert 'cannot be written: File too large' in result.stderr
    recording = read_recording(out)
    assert not recording.closed
    ticks = recording['phase_currents']['tick']
    assert len(ticks) > 500
    assert ticks[-1] == len(ticks) - 1


def test_a_run_without_room_for_a_message_leaves_nothing(tmp_path):
    result = limited(60_000, *RUN, '--duration', '0.5', '--out', tmp_path / 'run')
    assert result.returncode == 1
    assert 'Traceback' not in result.stderr
    assert contents(tmp_path) == {}


def full(*arguments, **named):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


CALIBRATE = ['calibrate', '--evaluate', '--stage', 'y_rotate', '--json']


def test_a_result_that_has_no_room_is_printed_and_kept_elsewhere(tmp_path, capsys, monkeypatch):
    out, elsewhere = tmp_path / 'out', tmp_path / 'elsewhere'
    elsewhere.mkdir()
    monkeypatch.setattr('tempfile.gettempdir', lambda: str(elsewhere))
    true_write = Path.write_text

    def write_text(path, *arguments, **named):
        return (
            full() if out.name in path.parent.name[:3] else true_write(path, *arguments, **named)
        )

    monkeypatch.setattr(Path, 'write_text', write_text)
    assert main([*CALIBRATE, '--out', str(out)]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)['y_rotate']['rows']
    assert f'--out {out} cannot be written: No space left on device' in printed.err
    assert f'kept in {elsewhere / "waferbot-out"} instead' in printed.err
    assert (elsewhere / 'waferbot-out' / 'calibrated.yaml').stat().st_size > 0
    assert not out.exists()


def test_a_result_that_has_no_room_anywhere_is_printed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Path, 'write_text', full)
    monkeypatch.chdir(tmp_path)
    assert main([*CALIBRATE, '--out', str(tmp_path / 'out')]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)['y_rotate']['rows']
    assert 'kept nowhere; what is printed is all there is' in printed.err
    assert contents(tmp_path) == {}


def test_output_to_a_full_disk_is_an_error_of_one_line(tmp_path):
    with open('/dev/full', 'w') as stdout:
        result = subprocess.run(
            [sys.executable, '-m', 'waferbot_twin', 'synthesize', '--list'],
            stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    assert result.returncode == 1
    assert result.stderr == 'waferbot: error: No space left on device\n'


# ---- broken off ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_run_that_is_broken_off_leaves_the_old_recording(tmp_path, start, number):
    out = tmp_path / 'run'
    assert main([*RUN, '--duration', '0.05', '--out', str(out)]) == 0
    before = contents(out)
    long = ('--duration', '10000', '--out', str(out), '--force')
    program = start('waferbot_twin', *RUN, *long)
    recorded = out.parent / f'run{NEW}' / 'run_0.mcap'
    wait_until(
        lambda: recorded.exists() and recorded.stat().st_size > 1e6, 'a megabyte recorded', program
    )
    program.signal(number)
    program.wait()
    assert contents(out) == before
    assert len(read_recording(recorded.parent)['phase_currents']) > 1000
    assert main([*RUN, '--duration', '0.02', '--out', str(out), '--force']) == 0
    assert read_recording(out).closed
    assert contents(out) != before
    assert not recorded.parent.exists()


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGKILL])
def test_a_log_that_is_broken_off_leaves_the_old_one(tmp_path, start, number):
    out = tmp_path / 'log'
    short = tmp_path / 'short.yaml'
    short.write_text('name: short\nduration_s: 0.05\nmotion: {y_linear: {kind: constant}}\n')
    assert main(['synthesize', '--experiment', str(short), '--out', str(out)]) == 0
    before = contents(out)
    program = start('waferbot_twin', 'synthesize', '--out', str(out), '--force')
    recorded = out.parent / f'log{NEW}' / 'log_0.mcap'
    wait_until(
        lambda: recorded.exists() and recorded.stat().st_size > 1e5, 'something recorded', program
    )
    program.signal(number)
    program.wait()
    assert contents(out) == before
    assert recorded.exists() == (number == signal.SIGKILL)
