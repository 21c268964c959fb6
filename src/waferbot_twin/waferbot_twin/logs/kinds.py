# SPDX-License-Identifier: Apache-2.0
"""The kinds of signals that a measured log may hold, and what each means on each axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.layout import SHIPPED


@dataclass(frozen=True)
class Kind:
    """
    One kind of signal.

    `linear` and `rotary` are the quantities that it has on an axis that slides and on one that turns;
    `held` tells that its value stands until the next one comes (a command), where others change
    steadily between samples, unless the log says otherwise.
    """

    name: str
    linear: str
    rotary: str
    held: bool
    meaning: str

    def quantity(self, is_linear: bool) -> str:
        """Return the quantity of this kind on an axis."""
        return self.linear if is_linear else self.rotary


def _same(name: str, quantity: str, held: bool, meaning: str) -> Kind:
    return Kind(name, quantity, quantity, held, meaning)


KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            'position', 'length', 'angle', False, 'the axis, by the encoder that the servo follows'
        ),
        Kind(
            'motor_position',
            'length',
            'angle',
            False,
            'the second encoder, before the transmission',
        ),
        Kind('velocity', 'speed', 'angular speed', False, 'rate of `position`'),
        Kind(
            'commanded_position', 'length', 'angle', True, 'where the servo wants `position` to be'
        ),
        Kind('following_error', 'length', 'angle', False, 'commanded minus actual position'),
        _same('drive_command', 'share', True, 'output of the servo over its full scale'),
        _same('current_command', 'current', True, 'A, peak of the sine; positive drives forward'),
        _same('current', 'current', False, 'the part that makes force, A, peak of the sine'),
        _same('direct_current', 'current', False, 'the part that makes none, A, peak of the sine'),
        Kind('force', 'force', 'torque', False, 'at the axis, behind the transmission'),
        _same('voltage_q', 'voltage', False, 'the part along `current`, V, line to neutral'),
        _same('voltage', 'voltage', False, 'of the bus'),
        _same('temperature', 'temperature', False, 'of the winding, degC'),
    )
}
"""Every kind by name, in the order in which a log lists them."""

DRIVES = ('current', 'force', 'current_command', 'drive_command')
"""What moves an axis: one of these and `position` is the least that a log must have of an axis."""

UNITS = {
    'length': 'm',
    'angle': 'rad',
    'speed': 'm/s',
    'angular speed': 'rad/s',
    'current': 'A',
    'force': 'N',
    'torque': 'Nm',
    'share': '1',
    'voltage': 'V',
    'temperature': 'degC',
}
"""The SI unit of each quantity, as signals have it."""

OTHER_QUANTITIES = {'drive_command': ('voltage',)}
"""
What a kind may be in, too: the output of a controller may be a voltage. What a drive makes of it is in
the description of the controller.
"""

SAME_KIND = {'torque': 'force'}
"""Other names of a kind: on an axis that turns, a force is a torque."""


def is_linear(axis: str, linear: Mapping[str, bool] | None = None) -> bool:
    """Tell whether an axis moves by metres: `linear`, what a description says, or as is usual."""
    return (linear or {}).get(axis, USUAL_UNITS.get(axis) == 'm')


def axes_in_order(axes: Iterable[str]) -> tuple[str, ...]:
    """Return the axes that come in a log, each once: those of the shipped machine first, as there."""
    found = dict.fromkeys(axes)
    return (
        *(axis for axis in SHIPPED.axes if axis in found),
        *(axis for axis in found if axis not in SHIPPED.axes),
    )
