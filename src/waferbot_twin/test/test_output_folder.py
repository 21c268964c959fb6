# SPDX-License-Identifier: Apache-2.0
"""The folder of a result: whole or not at all, and never over what waferbot did not write."""

# ruff: noqa: PT012  the folder is written to, and then the trouble comes

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.output_folder import MARKER, NEW, OLD, OutputFolder, foreign, note_file


def write(path: Path, text: str, force: bool = False) -> None:
    with OutputFolder(path, force) as output:
        (output.folder / 'report.json').write_text(text)


def beside(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.parent.iterdir())


@pytest.fixture
def old(tmp_path) -> Path:
    write(tmp_path / 'out', 'old')
    return tmp_path / 'out'


def text_of(path: Path) -> str:
    return (path / 'report.json').read_text()


# ---- what is replaced ----------------------------------------------------------------------------


def test_a_result_is_replaced_by_force_only(old):
    with pytest.raises(UserError, match='exists already; choose another folder or give --force'):
        OutputFolder(old, force=False)
    write(old, 'new', force=True)
    assert text_of(old) == 'new'
    assert beside(old) == ['out']
    assert sorted(entry.name for entry in old.iterdir()) == [MARKER, 'report.json']


def add_file(folder):
    (folder / 'notes.txt').write_text('mine')


def add_folder(folder):
    (folder / 'drafts').mkdir()


def add_link(folder):
    (folder / 'report.json').unlink()
    (folder / 'report.json').symlink_to('/etc/hostname')


def edit(folder):
    (folder / 'report.json').write_text('old, and what I think of it')


def take_marker(folder):
    (folder / MARKER).unlink()
    (folder / 'notes.txt').write_text('mine')


def damage_marker(folder):
    (folder / MARKER).write_text('{"files": {"report.json": ')
    (folder / 'notes.txt').write_text('mine')


@pytest.mark.parametrize(
    'change', [add_file, add_folder, add_link, edit, take_marker, damage_marker]
)
def test_force_refuses_a_folder_with_anything_that_waferbot_did_not_write(old, change):
    change(old)
    before = {entry.name: entry.lstat().st_mtime_ns for entry in old.iterdir()}
    with pytest.raises(UserError, match=r'--force only replaces what waferbot wrote'):
        OutputFolder(old, force=True)
    assert {entry.name: entry.lstat().st_mtime_ns for entry in old.iterdir()} == before
    assert beside(old) == ['out']


@pytest.mark.parametrize('name', ['metadata.yaml', 'report.html', 'experiment.yaml', 'x_0.mcap'])
def test_a_name_that_waferbot_uses_too_does_not_make_a_folder_ours(tmp_path, name):
    (tmp_path / name).write_text('written by somebody else')
    assert foreign(tmp_path) == f'it holds {name}, which waferbot did not write'


def test_a_recording_of_somebody_else_is_not_ours(tmp_path):
    (tmp_path / 'metadata.yaml').write_text('rosbag2_bagfile_information: {}')
    (tmp_path / 'x_0.mcap').write_bytes(b'\x89MCAP0\r\n' + b'ros2 libmcap 1.1.0' * 4)
    assert 'x_0.mcap' in foreign(tmp_path) or 'metadata.yaml' in foreign(tmp_path)


def test_a_report_from_before_the_marker_is_ours_if_nothing_else_is_there(tmp_path):
    for name in ('report.json', 'report.html', 'extended.yaml', 'gain.png'):
        (tmp_path / name).write_text('')
    assert foreign(tmp_path) == ''
    (tmp_path / 'report.odt').write_text('mine')
    assert foreign(tmp_path) == 'it holds report.odt, which waferbot did not write'


def test_a_file_that_waferbot_adds_is_noted(old):
    (old / 'plot.png').write_text('picture')
    assert foreign(old)
    note_file(old / 'plot.png')
    assert not foreign(old)


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / 'out').mkdir()
    write(tmp_path / 'out', 'new')
    assert text_of(tmp_path / 'out') == 'new'


def test_a_link_to_a_folder_stays_one(old, tmp_path):
    (tmp_path / 'link').symlink_to(old)
    write(tmp_path / 'link', 'new', force=True)
    assert (tmp_path / 'link').is_symlink()
    assert text_of(old) == 'new'


def test_a_file_and_the_working_folder_are_refused(tmp_path, monkeypatch):
    (tmp_path / 'file').write_text('')
    with pytest.raises(UserError, match='is a file'):
        OutputFolder(tmp_path / 'file', force=True)
    with pytest.raises(UserError, match='cannot be made: '):
        OutputFolder(tmp_path / 'file' / 'below', force=True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match='give a folder below it'):
        OutputFolder(Path('.'), force=True)


# ---- broken off ----------------------------------------------------------------------------------


@pytest.mark.parametrize('trouble', [ValueError, KeyboardInterrupt, OSError(errno.ENOSPC, 'full')])
def test_what_is_broken_off_leaves_the_old_or_nothing(old, tmp_path, trouble):
    for path in (old, tmp_path / 'none'):
        with pytest.raises(BaseException), OutputFolder(path, force=True) as output:  # noqa: B017, PT011
            (output.folder / 'report.json').write_text('half')
            raise trouble
    assert text_of(old) == 'old'
    assert beside(old) == ['out']


@pytest.mark.parametrize('call', ['fsync', 'rename'])
def test_a_disk_that_fills_up_at_the_end_leaves_the_old(old, monkeypatch, call):
    def full(*arguments, **named):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    output = OutputFolder(old, force=True)
    with pytest.raises(UserError, match='cannot be written: No space left'), output:
        (output.folder / 'report.json').write_text('new')
        if call == 'fsync':
            monkeypatch.setattr(os, 'fsync', full)
        else:
            # The second renaming, when the old one has been moved away already.
            true_rename = Path.rename

            def rename(path, target):
                return full() if path.name.endswith(NEW) else true_rename(path, target)

            monkeypatch.setattr(Path, 'rename', rename)
    assert text_of(old) == 'old'
    assert beside(old) == ['out']


def test_a_live_result_that_is_broken_off_is_kept_where_nothing_was(tmp_path):
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path / 'out', False, True) as output:
        assert output.folder == tmp_path / 'out'
        (output.folder / 'x_0.mcap').write_text('half')
        output.worth_keeping = True
        raise KeyboardInterrupt
    assert (tmp_path / 'out' / 'x_0.mcap').read_text() == 'half'
    assert not foreign(tmp_path / 'out')


def test_a_live_result_that_is_broken_off_is_kept_beside_the_old(old, capsys):
    with pytest.raises(KeyboardInterrupt), OutputFolder(old, True, True) as output:
        (output.folder / 'x_0.mcap').write_text('half')
        output.worth_keeping = True
        raise KeyboardInterrupt
    assert text_of(old) == 'old'
    assert (old.parent / f'out{NEW}' / 'x_0.mcap').read_text() == 'half'
    assert 'is as it was; what came until then is in' in capsys.readouterr().err
    write(old, 'new', force=True)
    assert text_of(old) == 'new'
    assert beside(old) == ['out']


# ---- killed --------------------------------------------------------------------------------------

KILLED = """
    import os, signal, sys
    from pathlib import Path
    from waferbot_twin.output_folder import OutputFolder
    path, where, live = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == 'live'
    true_rename = Path.rename

    def die(*_):
        os.kill(os.getpid(), signal.SIGKILL)

    def rename(source, target):
        true_rename(source, target)
        if where == 'between':
            die()

    Path.rename = rename
    with OutputFolder(path, True, live, ('x_0.mcap',)) as output:
        (output.folder / 'x_0.mcap').write_text('half')
        if where == 'writing':
            die()
"""


def killed(path: Path, where: str, live: str = '') -> None:
    program = [sys.executable, '-c', textwrap.dedent(KILLED), str(path), where, live]
    assert subprocess.run(program, timeout=60, check=False).returncode == -signal.SIGKILL


def test_killed_while_writing_leaves_the_old_in_its_place(old):
    killed(old, 'writing')
    assert text_of(old) == 'old'
    write(old, 'new', force=True)
    assert text_of(old) == 'new'
    assert beside(old) == ['out']


def test_killed_while_writing_leaves_nothing_that_looks_like_a_result(tmp_path, capsys):
    killed(tmp_path / 'out', 'writing')
    assert beside(tmp_path / 'out') == [f'out{NEW}']
    write(tmp_path / 'out', 'new')
    assert 'left by a start that was killed, is removed' in capsys.readouterr().err
    assert beside(tmp_path / 'out') == ['out']


def test_killed_between_the_renamings_the_next_start_puts_the_old_back(old, capsys):
    killed(old, 'between')
    assert beside(old) == [f'out{NEW}', f'out{OLD}']
    with pytest.raises(UserError, match='exists already'):
        OutputFolder(old, force=False)
    assert 'an earlier start was killed; the old result is back' in capsys.readouterr().err
    assert text_of(old) == 'old'


def test_a_killed_recording_may_be_replaced(tmp_path):
    killed(tmp_path / 'out', 'writing', 'live')
    assert (tmp_path / 'out' / 'x_0.mcap').read_text() == 'half'
    write(tmp_path / 'out', 'new', force=True)
    assert text_of(tmp_path / 'out') == 'new'


def test_something_else_of_the_name_of_the_new_folder_is_in_the_way(old):
    for added in (NEW, OLD):
        mine = old.parent / f'out{added}'
        mine.mkdir()
        (mine / 'thesis.txt').write_text('years of work')
        with pytest.raises(UserError, match='is in the way'):
            OutputFolder(old, force=True)
        assert (mine / 'thesis.txt').read_text() == 'years of work'
        (mine / 'thesis.txt').rename(old.parent / f'saved{added}')
        mine.rmdir()


def test_two_cannot_write_to_one_folder(old, tmp_path):
    for path in (old, tmp_path / 'none'):
        with OutputFolder(path, force=True) as output:
            (output.folder / 'report.json').write_text('first')
            with pytest.raises(UserError, match='being written by another waferbot'):
                OutputFolder(path, force=True)
        assert text_of(path) == 'first'


@pytest.mark.parametrize(
    'text', ['', '[]', 'null', '{"complete": true}', '{"files": []}', '[' * 9999, '\xff', '{"a']
)
def test_any_marker_can_be_read(tmp_path, text):
    (tmp_path / MARKER).write_text(text, 'latin-1')
    (tmp_path / 'thesis.txt').write_text('years of work')
    assert foreign(tmp_path)


def test_the_marker_says_what_it_is(old):
    marker = json.loads((old / MARKER).read_text())
    assert '--force' in marker['waferbot']
    assert marker['complete'] is True
    assert list(marker['files']) == ['report.json']
