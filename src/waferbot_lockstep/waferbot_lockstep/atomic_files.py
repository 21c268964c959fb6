# SPDX-License-Identifier: Apache-2.0
"""
Files that are written whole or not at all.

A result goes to a file of another name in the same folder, is forced to the disk, and is then renamed
over what was there. POSIX makes the renaming one step: whoever reads, and whoever comes after a full
disk, a SIGKILL or a loss of power, finds the old file or the new one, never a part.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_TEMPORARY = re.compile(r'\.waferbot-[0-9a-f]{16}')


def is_temporary(name: str) -> bool:
    """Tell whether a file name is one of those that are written before the renaming."""
    return _TEMPORARY.fullmatch(name) is not None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """
    Give a stream whose content takes the place of the file at `path` at the end of the `with`.

    After an exception, whatever it is, the file at `path` is what it was. The folder is made if it
    lacks. A link is followed; what is no ordinary file (`/dev/stdout`, a pipe) is written to directly.
    Raises `OSError`, naming `path`, if the file cannot be written.
    """
    target = Path(os.path.realpath(path))
    temporary = target.parent / f'.waferbot-{secrets.token_hex(8)}'
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if target.exists() and not target.is_file():
            with target.open('wb') as stream:
                yield stream
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open('xb') as stream:
                yield stream
                flush_to_disk(stream)
            if target.exists():
                temporary.chmod(target.stat().st_mode & 0o7777)
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        if error.filename in (None, str(temporary)):
            error.filename, error.filename2 = str(path), None  # the file that the user meant
        raise
    sync_folder(target.parent)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file as `replacing` does; raises `OSError`."""
    with replacing(path) as stream:
        stream.write(data)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 as `replacing` does; raises `OSError`."""
    write_bytes(path, text.encode('utf-8'))


def flush_to_disk(stream: BinaryIO) -> None:
    """Bring what was written to an open file to the disk; raises `OSError` if there is no room."""
    stream.flush()
    os.fsync(stream.fileno())


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the file system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
