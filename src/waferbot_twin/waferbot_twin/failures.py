# SPDX-License-Identifier: Apache-2.0
"""
What makes a run fail though every tick of it was computed: an axis that nobody drives any more.

A motor that the controller has killed, or an amplifier whose fault has taken its gate drive away,
leaves its axis to gravity. Signals go on and are recorded, but they are not what the experiment was
run for, so every engine ends such a run with an error. Safe torque off is not one of these faults:
somebody has asked for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from waferbot_copley.faults import DISABLING, SAFE_TORQUE_OFF, describe
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_pmac.killed import KilledMotors

FAILING = DISABLING & ~SAFE_TORQUE_OFF


@dataclass
class Failures:
    """The killed motors, and the first fault of each amplifier (tick, faults) by axis."""

    timing: Timing
    killed: KilledMotors = field(default_factory=KilledMotors)
    faults: dict[str, tuple[int, int]] = field(default_factory=dict)

    @classmethod
    def of(cls, timing: Timing, layout: Layout = SHIPPED) -> Failures:
        """Begin with nothing found, of a machine with these axes."""
        return cls(timing, KilledMotors(layout))

    def note_faults(self, tick: int, valid: int, faults: Sequence[float] | np.ndarray) -> None:
        """Look at the faults (axes,) that a message of the amplifiers gives for the axes in `valid`."""
        for place, axis in enumerate(self.killed.layout.axes):
            if valid >> place & 1 and int(faults[place]) & FAILING:
                self.faults.setdefault(axis, (tick, int(faults[place])))

    def reason(self) -> str:
        """Return which axes are not driven any more, since when and why, as one line; '' if all are."""
        lines = [
            f'the amplifier of {axis} switched off at tick {tick} '
            f'({self.timing.seconds(tick):.4f} s): {describe(faults)}'
            for axis, (tick, faults) in self.faults.items()
        ]
        killed = self.killed.reason(self.timing)
        return '; '.join([*lines, killed] if killed else lines)

    def with_this(self, error: UserError) -> UserError:
        """Return the error of a run that ended early, with these failures before it if there are any."""
        reason = self.reason()
        return UserError(f'{reason}; {error}') if reason else error
