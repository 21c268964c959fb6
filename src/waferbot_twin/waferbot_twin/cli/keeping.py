# SPDX-License-Identifier: Apache-2.0
"""A result that took long is kept where there is room, and printed whatever becomes of the disk."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import say
from waferbot_twin.output_folder import OutputFolder

ELSEWHERE = 100
"""Names that are tried in each of the folders where a result could be kept instead."""


@dataclass(frozen=True)
class Kept:
    """Where a result was kept: `folder`, None for nowhere; `as_asked` if it is where it should be."""

    folder: Path | None
    as_asked: bool

    def tell(self, what: str) -> int:
        """Say where it is, `what` in words; return the command's exit code."""
        if self.folder is not None:
            say(f'{what.format(self.folder)}')
        if self.as_asked:
            return 0
        if self.folder is None:
            say('waferbot: error: the result is kept nowhere; what is printed is all there is')
        return 1


def keep(output: OutputFolder | None, write: Callable[[Path], None]) -> Kept:
    """
    Let `write` write a result into a folder; if that fails, into another one, and say so.

    Never raises for a disk that is full, read-only or gone: the caller still has the result to print.
    """
    if output is None:
        return Kept(None, True)
    try:
        _write(output, write)
        return Kept(output.path, True)
    except UserError as error:
        say(f'waferbot: error: {error}')
    for place in _elsewhere(output.path):
        try:
            _write(OutputFolder(place, force=False), write)
        except UserError:
            continue
        say(f'waferbot: kept in {place} instead')
        return Kept(place, False)
    return Kept(None, False)


def _write(output: OutputFolder, write: Callable[[Path], None]) -> None:
    """Write into an output folder; raises `UserError`."""
    try:
        with output:
            write(output.folder)
    except OSError as error:
        raise UserError(
            f'--out {output.path} cannot be written: {error.strerror or error}'
        ) from error


def _elsewhere(path: Path) -> list[Path]:
    """Return folders that are not there yet: for temporary files, the working folder, the home."""
    found = []
    bases = []
    for base_of in (_temporary, Path.cwd, Path.home):
        with contextlib.suppress(OSError, RuntimeError):
            bases.append(base_of())
    for base in dict.fromkeys(bases):
        names = [f'waferbot-{path.name or "result"}'] + [
            f'waferbot-{path.name or "result"}-{number}' for number in range(2, ELSEWHERE)
        ]
        free = next((base / name for name in names if not (base / name).exists()), None)
        if free is not None:
            found.append(free)
    return found


def _temporary() -> Path:
    return Path(tempfile.gettempdir())
