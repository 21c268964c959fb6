# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM as a flag, so that a run ends between two steps and never within one."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any


class Interrupt:
    """
    Catches SIGINT (Ctrl-C) and SIGTERM from its making until the end of its `with` statement.

    `raised` tells whether one has come; whoever loops looks at it. Afterwards the signals do again
    what they did before. Only the main thread of a process may make one.
    """

    def __init__(self) -> None:
        """Catch the signals from now on."""
        self.raised = False
        self._before: dict[int, Any] = {
            number: signal.signal(number, self._on_signal)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def __enter__(self) -> Interrupt:
        """Return the flag."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def ignore(self) -> None:
        """
        Ignore the signals from now on: the process is ending.

        When Python ends it gives signals that it caught back to the system, and one that comes while the
        libraries below end would kill the process; those that are ignored stay ignored.
        """
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.raised = True
