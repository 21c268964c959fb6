# SPDX-License-Identifier: Apache-2.0
"""
Motors that the controller has killed: which, when and why, for whoever must not take that for a result.

A killed motor has no current any more; its axis goes where gravity takes it. The causes are those of the
servo's protections (`waferbot_pmac.servo`), told by the flags of its state.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_pmac.servo import (
    AMPLIFIER_I2T,
    FATAL_FOLLOWING_ERROR,
    INTEGRATOR_LIMITED,
    MOTOR_KILLED,
)


def cause(flags: int) -> str:
    """Return why a motor was killed, from its flags; '' if it was killed together with another one."""
    if flags & AMPLIFIER_I2T:
        return "the controller's current protection (Ixx57, Ixx58)"
    if flags & FATAL_FOLLOWING_ERROR and flags & INTEGRATOR_LIMITED:
        return 'a full integrator (Ixx63 < 0)'
    if flags & FATAL_FOLLOWING_ERROR:
        return 'its fatal following error (Ixx11)'
    return ''


@dataclass
class KilledMotors:
    """The tick and the flags with which each motor of a machine was found killed first, by axis."""

    layout: Layout = SHIPPED
    found: dict[str, tuple[int, int]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Tell whether any was killed."""
        return bool(self.found)

    def note(self, tick: int, flags: Iterable[float]) -> bool:
        """Look at the flags (axes,) of one servo cycle; return whether a motor is killed anew."""
        before = len(self.found)
        for axis, own in zip(self.layout.axes, flags, strict=True):
            if int(own) & MOTOR_KILLED:
                self.found.setdefault(axis, (tick, int(own)))
        return len(self.found) > before

    def note_all(self, ticks: np.ndarray, flags: np.ndarray) -> None:
        """Look at the flags (n, axes) of many servo cycles, in the order of time."""
        for row in np.flatnonzero(np.any(flags.astype(np.int64) & MOTOR_KILLED, axis=1)):
            self.note(int(ticks[row]), flags[row])
            if len(self.found) == len(self.layout.axes):
                return

    def reason(self, timing: Timing) -> str:
        """Return which motors were killed, when and by what, as one line; '' if none was."""
        causes = [
            f'motor {axis} was killed at tick {tick} ({timing.seconds(tick):.4f} s) by {cause(flags)}'
            for axis, (tick, flags) in self.found.items()
            if cause(flags)
        ]
        others = [axis for axis, (_, flags) in self.found.items() if not cause(flags)]
        if others:
            causes.append(f'{", ".join(others)} with it (Ixx24)')
        return '; '.join(causes)
