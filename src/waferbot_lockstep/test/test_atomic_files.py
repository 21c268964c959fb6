# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

# ruff: noqa: PT012  something is written, and then the trouble comes

from __future__ import annotations

import errno
import os
import stat

import pytest

from waferbot_lockstep.atomic_files import is_temporary, replacing, write_text


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_text_is_written_and_nothing_else(tmp_path):
    write_text(tmp_path / 'deep' / 'new.txt', 'Ω\n')
    assert (tmp_path / 'deep' / 'new.txt').read_bytes() == 'Ω\n'.encode()
    assert names(tmp_path / 'deep') == ['new.txt']


@pytest.mark.parametrize('trouble', [ValueError, KeyboardInterrupt, OSError(errno.ENOSPC, 'full')])
def test_after_trouble_the_old_file_is_what_it_was(tmp_path, trouble):
    file = tmp_path / 'file'
    file.write_text('old')
    with pytest.raises(BaseException), replacing(file) as stream:  # noqa: B017, PT011
        stream.write(b'half of the n')
        raise trouble
    assert file.read_text() == 'old'
    assert names(tmp_path) == ['file']


def test_a_disk_that_fills_up_at_the_end_is_noticed(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    file = tmp_path / 'file'
    file.write_text('old')
    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OSError, match='No space left') as error:
        write_text(file, 'new')
    assert error.value.filename == str(file)
    assert file.read_text() == 'old'
    assert names(tmp_path) == ['file']


def test_while_it_is_written_the_old_file_is_there(tmp_path):
    file = tmp_path / 'file'
    file.write_text('old')
    with replacing(file) as stream:
        stream.write(b'new')
        stream.flush()
        assert file.read_text() == 'old'
        (temporary,) = [name for name in names(tmp_path) if name != 'file']
        assert is_temporary(temporary)
    assert file.read_text() == 'new'


def test_a_link_stays_a_link_and_a_file_keeps_its_rights(tmp_path):
    file, link = tmp_path / 'file', tmp_path / 'link'
    file.write_text('old')
    file.chmod(0o640)
    link.symlink_to(file)
    write_text(link, 'new')
    assert link.is_symlink()
    assert file.read_text() == 'new'
    assert stat.S_IMODE(file.stat().st_mode) == 0o640


def test_what_is_no_file_is_not_replaced(tmp_path):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_text(pipe, 'through')
    assert os.read(reader, 100) == b'through'
    os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    with pytest.raises(IsADirectoryError):
        write_text(tmp_path, 'over a folder')
