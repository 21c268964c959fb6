# SPDX-License-Identifier: Apache-2.0
"""
Which axes a machine has and which encoders, in the order of every array that has a place for each.

    layout = Layout(('lift', 'shoulder'), ('lift', 'shoulder_load', 'shoulder_motor'))
    layout.place('shoulder')        # 1: its place in `CurrentCommand.current`
    layout.encoders_of('shoulder')  # ('shoulder_load', 'shoulder_motor')
    layout.names(topic)             # what the bits of `valid` stand for on a topic

A description has one (`Description.layout`), nodes are told it by their parameters `machine_axes` and
`machine_encoders`, a recording holds it in `run.json`. Without any it is that of the shipped machine,
`SHIPPED`.

An encoder has the name of its axis, or that with `_load` or `_motor` behind it: on either side of what
gives between motor and load.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError

MOST_AXES = 8
"""Axes that a machine can have: the bits of `valid`, and of `PhaseVoltages.open`."""

MOST_ENCODERS = 2 * MOST_AXES

SIDES = ('', '_load', '_motor')
"""What stands behind the name of an axis in those of its encoders, the load's before the motor's."""

_NAME = re.compile(r'[a-z][a-z0-9_]*')


@dataclass(frozen=True)
class Layout:
    """
    Names of the axes and of the encoders, each in the order of its places.

    Raises `UserError` if there are too many or none, for a name that cannot be one (lower case letters,
    digits, underscores) or comes twice, and for an encoder of no axis.
    """

    axes: tuple[str, ...]
    encoders: tuple[str, ...]

    def __post_init__(self) -> None:
        """Check the names."""
        for what, names, most in (
            ('axes', self.axes, MOST_AXES),
            ('encoders', self.encoders, MOST_ENCODERS),
        ):
            if not 1 <= len(names) <= most:
                raise UserError(f'{len(names)} {what}; a machine has 1 to {most}')
            for name in names:
                if not _NAME.fullmatch(name):
                    raise UserError(
                        f'{what}: {name!r} cannot be a name; it has lower case letters, digits and '
                        'underscores and begins with a letter'
                    )
                if names.count(name) > 1:
                    raise UserError(f'{what}: {name} comes twice')
        for axis in self.axes:
            if axis.endswith(SIDES[1:]):
                raise UserError(f'axes: {axis} cannot be a name; only an encoder ends like that')
        for encoder in self.encoders:
            if self.axis_of(encoder) not in self.axes:
                raise UserError(
                    f'encoders: {encoder} is on no axis; the axes are {", ".join(self.axes)}, their '
                    'encoders are called like them, or with _load or _motor behind it'
                )

    def __str__(self) -> str:
        """Return the names as one line for the user."""
        return f'axes {", ".join(self.axes)}; encoders {", ".join(self.encoders)}'

    @property
    def all_axes(self) -> int:
        """The mask with the bit of every axis set."""
        return (1 << len(self.axes)) - 1

    @property
    def all_encoders(self) -> int:
        """The mask with the bit of every encoder set."""
        return (1 << len(self.encoders)) - 1

    def place(self, axis: str) -> int:
        """Return the place of an axis; raises `ValueError` for one that the machine lacks."""
        return self.axes.index(axis)

    def encoder_place(self, encoder: str) -> int:
        """Return the place of an encoder; raises `ValueError` for one that the machine lacks."""
        return self.encoders.index(encoder)

    @staticmethod
    def axis_of(encoder: str) -> str:
        """Return the axis that an encoder is on: its name without the side."""
        return next(
            (encoder.removesuffix(side) for side in SIDES[1:] if encoder.endswith(side)), encoder
        )

    def encoders_of(self, axis: str) -> tuple[str, ...]:
        """Return the encoders of an axis, that of the load first."""
        return tuple(name for name in self.encoders if self.axis_of(name) == axis)

    def mask(self, axes: Sequence[str]) -> int:
        """Return the mask of the named axes; raises `ValueError` for a name that is no axis."""
        return sum(1 << self.place(axis) for axis in set(axes))


SHIPPED = Layout(
    ('y_linear', 'x_rotate', 'y_rotate'),
    ('y_linear', 'x_rotate', 'y_rotate_load', 'y_rotate_motor'),
)
"""The layout of the shipped machine, and of any that has no axis and no encoder of another name."""


def layout_of(axes: Sequence[str], encoders: Sequence[str]) -> Layout:
    """
    Return the layout of a machine with these axes and encoders.

    One of which the shipped machine has all has its places, so that what is known of one by the name is
    where it was; places of what it lacks stay zero. Any other has its own: axes in their order, encoders
    axis by axis, a place for one of its name where an axis has none. Raises `UserError`.
    """
    if set(axes) <= set(SHIPPED.axes) and set(encoders) <= set(SHIPPED.encoders):
        return SHIPPED
    places = []
    for axis in axes:
        places += [axis + side for side in SIDES if axis + side in encoders] or [axis]
    places += [name for name in encoders if name not in places]  # of no axis: refused
    return Layout(tuple(axes), tuple(places))
