# SPDX-License-Identifier: Apache-2.0
"""
The folder that a command writes its result to: whole or not at all, and never over what is not ours.

A folder that waferbot wrote holds a marker, `.waferbot.json`, with the name and the digest of every
file in it. `--force` replaces a folder only if it holds nothing else: no file of another name, no
folder, no link, no file that was changed since.

A result is written to `DIR.waferbot-new`, beside the old one. When it is complete and on the disk, the
old one is renamed to `DIR.waferbot-old`, the new one takes its place, and only then is the old one
deleted. So an exception, Ctrl-C, SIGTERM, a full disk and even SIGKILL leave the old result where it
was; between the two renamings it is `DIR.waferbot-old`, and the next start puts it back and says so.

A recording of a run that is going on is worth reading even if it is broken off. Where there is no old
one, it is therefore written in its place at once.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from waferbot_lockstep import atomic_files
from waferbot_lockstep.errors import UserError

MARKER = '.waferbot.json'
NEW, OLD = '.waferbot-new', '.waferbot-old'
"""What is added to the name of the folder for a result in the making, and for one that is replaced."""

_PURPOSE = 'what waferbot wrote here; --force replaces the folder only if it holds nothing else'
_MCAP = '.mcap'

_REPORTS_WITHOUT_MARKER = frozenset(
    {
        'report.json',
        'report.html',
        'extended.yaml',
        'gain.png',
        'identified.yaml',
        'experiment.yaml',
    }
)
"""Files of reports from before there was a marker; the first of them was in each."""


class OutputFolder:
    """
    A folder to be written; use it in a `with` statement, and write to `folder` inside.

    `path` is what the user gave. With `live`, a result that is broken off is kept if `worth_keeping`
    has been set: in its place if there was no old one, else beside it.
    """

    def __init__(
        self,
        path: Path,
        force: bool,
        live: bool = False,
        files: Sequence[str] = (),
        option: str = '--out',
    ) -> None:
        """
        Check that there is room at `path`, so that nobody waits for a result that cannot be written.

        `files` are the names that a live result may have when it was killed; `option` is the one that
        gave `path`, for messages. Raises `UserError` if
        something is at `path`, unless `force` and waferbot wrote all of it; also if another waferbot
        is writing there, or the folder cannot be made.
        """
        self.path = path
        self.folder = path
        self._name = f'{option} {path}'
        self.worth_keeping = False
        self._real = Path(os.path.realpath(path))
        self._new = self._real.parent / (self._real.name + NEW)
        self._old = self._real.parent / (self._real.name + OLD)
        self._force, self._live, self._files = force, live, tuple(files)
        self._marker: BinaryIO | None = None
        with self._told('cannot be made'):
            self._check()

    @property
    def _in_place(self) -> bool:
        return self.folder == self.path

    def _check(self) -> None:
        self._recover()
        if self._real.exists():
            if not self._real.is_dir():
                raise UserError(f'{self._name} is a file; give the name of a folder')
            if self._real in (here := Path.cwd(), *here.parents) or self._real.is_mount():
                raise UserError(f'{self._name} cannot be replaced; give a folder below it')
            if _occupied(self._real):
                if not self._force:
                    raise UserError(
                        f'{self._name} exists already; choose another folder or give --force'
                    )
                if stranger := foreign(self._real):
                    raise UserError(
                        f'{self._name}: {stranger}; --force only replaces what waferbot wrote. '
                        'Move it away, or choose another folder'
                    )
                if _is_locked(self._real):
                    raise self._busy()
        self._real.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(self._real.parent, os.W_OK | os.X_OK):
            raise PermissionError(13, f'{self._real.parent} may not be written to')

    def _recover(self) -> None:
        """Put right what a start that was killed left beside the folder."""
        if self._new.is_dir() and _is_locked(self._new):
            raise self._busy()
        if _read(self._old) is not None and not foreign(self._old):
            if not self._real.exists():
                self._old.rename(self._real)
                _tell(f'{self.path}: an earlier start was killed; the old result is back')
            elif (marker := _read(self._real)) is not None and marker['complete']:
                shutil.rmtree(self._old)
        for place in (self._new, self._old):
            if place.exists() and not (place == self._new and _unfinished(place)):
                raise UserError(f'{place} is in the way; look at what it is, and move it away')

    def _busy(self) -> UserError:
        return UserError(f'{self._name} is being written by another waferbot')

    def __enter__(self) -> OutputFolder:
        """Make the folder; raises `UserError` as `__init__` does, time has passed since."""
        with self._told('cannot be made'):
            self._check()
            if self._live and not _occupied(self._real):
                self.folder = self.path
                self._real.mkdir(exist_ok=True)
            else:
                self.folder = self._new
                if self._new.exists():
                    _tell(f'{self._new}, left by a start that was killed, is removed')
                    shutil.rmtree(self._new)
                self._new.mkdir()
            try:
                self._marker = (self.folder / MARKER).open('w+b')
                _lock(self._marker)
                self._mark(False, dict.fromkeys(self._files))
            except BaseException:
                self._discard()
                raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Put the result into its place; after an exception the old one stays, if there is one."""
        if error is None:
            with self._told('cannot be written'):
                self._complete()
            return
        if not (self._live and self.worth_keeping):
            self._discard()
            return
        with contextlib.suppress(OSError):
            self._mark(True, _digests(self.folder))
        self._unlock()
        if not self._in_place:
            _tell(f'{self.path} is as it was; what came until then is in {self.folder}')

    def _complete(self) -> None:
        try:
            for file in _files(self.folder):
                with file.open('rb') as stream:
                    os.fsync(stream.fileno())
            self._mark(True, _digests(self.folder))
            atomic_files.sync_folder(self.folder)
        except BaseException:
            if not (self._in_place and self.worth_keeping):
                self._discard()
            raise
        if not self._in_place:
            self._swap()
        self._unlock()

    def _swap(self) -> None:
        """Rename the new folder over the old one."""
        try:
            if _occupied(self._real):
                self._real.rename(self._old)
            self._new.rename(self._real)
        except BaseException:
            if self._old.exists() and not self._real.exists():
                self._old.rename(self._real)
            self._discard()
            raise
        atomic_files.sync_folder(self._real.parent)
        shutil.rmtree(self._old, ignore_errors=True)

    def _discard(self) -> None:
        """Remove what was begun."""
        self._unlock()
        shutil.rmtree(self._real if self._in_place else self._new, ignore_errors=True)

    def _mark(self, complete: bool, files: dict[str, str | None]) -> None:
        """Write the marker; the file stays the same one, as the lock is on it."""
        assert self._marker is not None
        content = {'waferbot': _PURPOSE, 'complete': complete, 'files': files}
        self._marker.seek(0)
        self._marker.truncate()
        self._marker.write((json.dumps(content, indent=1) + '\n').encode())
        atomic_files.flush_to_disk(self._marker)

    def _unlock(self) -> None:
        if self._marker is not None:
            with contextlib.suppress(OSError):
                self._marker.close()

    @contextlib.contextmanager
    def _told(self, what: str) -> Iterator[None]:
        """Turn what the system says into the one line for the user."""
        try:
            yield
        except OSError as error:
            raise UserError(f'{self._name} {what}: {error.strerror or error}') from error


def foreign(folder: Path) -> str:
    """
    Return what in a folder is not as waferbot wrote it, in words; '' if nothing is.

    Reads every file in it but recordings, of which it only looks at the size.
    """
    marker = _read(folder)
    if marker is None:
        return _foreign_without_marker(folder)
    for entry in sorted(folder.iterdir()):
        name = entry.name
        if name == MARKER or atomic_files.is_temporary(name):
            continue
        if name not in marker['files'] or not _is_file(entry):
            return f'it holds {name}, which waferbot did not write'
        wanted = marker['files'][name]
        if wanted is not None and _digest(entry) != wanted:
            return f'{name} in it was changed since waferbot wrote it'
    return ''


def note_file(file: Path) -> None:
    """Add a file to what waferbot wrote in its folder, if the folder is one of waferbot's."""
    marker = _read(file.parent)
    if marker is not None:
        marker['files'][file.name] = _digest(file)
        atomic_files.write_text(file.parent / MARKER, json.dumps(marker, indent=1) + '\n')


def _foreign_without_marker(folder: Path) -> str:
    """Return the same for a folder from before there was a marker: by known names and contents."""
    entries = {entry.name: entry for entry in folder.iterdir()}
    recorded = {
        name
        for name, entry in entries.items()
        if name.endswith(_MCAP) and _is_file(entry) and _recorded_by_waferbot(entry)
    }
    if recorded and 'metadata.yaml' in entries:
        known = recorded | {'metadata.yaml', 'plot.png'}
    elif 'report.json' in entries:
        known = set(_REPORTS_WITHOUT_MARKER)
    else:
        known = set()
    strange = sorted(
        name for name, entry in entries.items() if name not in known or not _is_file(entry)
    )
    return f'it holds {strange[0]}, which waferbot did not write' if strange else ''


def _recorded_by_waferbot(file: Path) -> bool:
    """Tell whether the header of an MCAP file, right behind its magic, names waferbot."""
    with file.open('rb') as stream:
        return b'waferbot' in stream.read(64)


def _read(folder: Path) -> dict[str, Any] | None:
    """Return the marker of a folder; None if it has none that can be read."""
    try:
        marker = json.loads((folder / MARKER).read_text('utf-8'))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(marker, dict) or not isinstance(marker.get('files'), dict):
        return None
    return marker if isinstance(marker.get('complete'), bool) else None


def _unfinished(folder: Path) -> bool:
    """Tell whether a folder is a result in the making, of a start that was killed or broken off."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    marker = _read(folder)
    if marker is None:
        # Killed before the marker was written: there is nothing else yet.
        return all(entry.name == MARKER for entry in folder.iterdir())
    return not marker['complete'] or not foreign(folder)


def _occupied(folder: Path) -> bool:
    return folder.exists() and any(folder.iterdir())


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.name != MARKER and _is_file(path))


def _is_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _digests(folder: Path) -> dict[str, str | None]:
    return {file.name: _digest(file) for file in _files(folder)}


def _digest(file: Path) -> str:
    """Return what a file is known by: SHA-256, or the size of a recording, which may be huge."""
    if file.suffix == _MCAP:
        return f'{file.stat().st_size} bytes'
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _lock(marker: BinaryIO) -> None:
    """Lock a marker until it is closed or the process ends, where the file system can."""
    try:
        fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass


def _is_locked(folder: Path) -> bool:
    try:
        with (folder / MARKER).open('rb') as marker:
            fcntl.flock(marker, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _tell(text: str) -> None:
    print(text, file=sys.stderr)
