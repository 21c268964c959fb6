# SPDX-License-Identifier: Apache-2.0
"""
Pictures of a machine, drawn from its description: the mechanism, and the shapes of its modes.

Every body is shown as the box that has its mass and moments of inertia, at its place; so a picture
cannot say anything that the simulation does not know. Views look along an axis of the base frame
(y up): side (x to the right), front (z to the right), top (x to the right, z down).
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from numpy.typing import NDArray

from waferbot_lockstep.atomic_files import replacing
from waferbot_plant import motors, plant
from waferbot_plant.description import BASE, Description, Freedom, Joint
from waferbot_plant.modes import Mode
from waferbot_plant.plant import Machine

matplotlib.rcParams['text.parse_math'] = False  # a $ in a name is a $

Vector = NDArray[np.float64]

VIEWS = {'side': (0, 1, 1.0), 'front': (2, 1, 1.0), 'top': (0, 2, -1.0)}
"""Base axes to the right and up, and the sign of the latter."""

_EDGES = [
    (one, other)
    for one, other in itertools.combinations(range(8), 2)
    if bin(one ^ other).count('1') == 1
]
_COLOURS = ('#1f5fa8', '#b5401f', '#3c7d3c', '#7d4f9e', '#8a6d1d', '#3a8a8a', '#666666')
_SPRING_COLOUR = '#b5401f'
_DRIVE_COLOUR = '#3c7d3c'
_LARGEST_MOTION = 0.12
"""Largest motion in the picture of a mode, as a share of the machine's size."""

_SCREEN_INCHES = (16.0, 8.6)
"""Width of the picture of modes, and greatest height of all its rows; 100 pixels to the inch."""

_ROW_INCHES = 2.2
_MODES_OF_ONE_COLUMN = 4
_MOST_MODES = 14

_NAMED_ELEMENTS = 4
_LEAST_SHARE = 0.01
"""Elements named beside a mode: the largest shares of its elastic energy, down to 1 %."""


def corners(description: Description) -> dict[str, Vector]:
    """Return the corners (8, 3) of every body's box at home, m, base frame."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    found = {}
    for body in description.bodies.values():
        sides, axes = body.equivalent_box()
        found[body.name] = body.centre_of_gravity + (signs * sides) @ axes.T
    return found


def moved_corners(
    machine: Machine, state: NDArray[np.void], parameters: NDArray[np.void]
) -> dict[str, Vector]:
    """Return the corners of every body's box at the pose of `state`, m, base frame."""
    size = len(machine.coordinates)
    plant.mass_matrix(state, parameters, np.zeros((size, size)))
    found = {}
    for name, points in corners(machine.description).items():
        link = machine.assembly.link_of[name]
        rotation = state[0]['rotation'][link + 1].reshape(3, 3)
        home = machine.assembly.links[link].point if link >= 0 else np.zeros(3)
        found[name] = state[0]['point'][link + 1] + (points - home) @ rotation.T
    return found


def draw_modes(
    machine: Machine, modes: list[Mode], path: Path, positions: dict[str, float] | None = None
) -> None:
    """
    Draw modes in three views, and where they bend, into an image file that fits a screen.

    Grey is the machine at rest at the pose `positions`, coloured the (linear) motion, enlarged so
    that the largest is the same in all pictures. Modes stand one below the other, of many in two
    columns; the lowest `_MOST_MODES` are drawn.
    """
    drawn = modes[:_MOST_MODES]
    parameters = machine.parameters()
    state = machine.initial_state(parameters, positions)
    rest = moved_corners(machine, state, parameters)
    everything = np.concatenate(list(rest.values()))
    size = float(np.ptp(everything, axis=0).max())
    columns = 1 if len(drawn) <= _MODES_OF_ONE_COLUMN else 2
    rows = -(-len(drawn) // columns)
    high = min(_ROW_INCHES, _SCREEN_INCHES[1] / rows)
    figure, grid = _subplots(
        rows, columns * (len(VIEWS) + 1), (_SCREEN_INCHES[0], high * rows + 1.0),
        (1.0, 1.0, 1.0, 1.5) * columns,
    )  # fmt: skip
    panels = [
        grid[row][column * (len(VIEWS) + 1) :][: len(VIEWS) + 1]
        for column in range(columns)
        for row in range(rows)
    ]
    for empty in panels[len(drawn) :]:
        for panel in empty:
            panel.axis('off')
    for row, mode in enumerate(drawn):
        motion = _motion(machine, state, parameters, rest, mode)
        largest = max(float(np.abs(motion[name]).max()) for name in motion)
        scale = _LARGEST_MOTION * size / largest if largest > 0.0 else 0.0
        for column, (view, (right, up, sign)) in enumerate(VIEWS.items()):
            panel = panels[row][column]
            for place, (name, points) in enumerate(rest.items()):
                _draw_box(panel, points, right, up, sign, '#cccccc', 0.8)
                moved = points + scale * motion[name]
                _draw_box(panel, moved, right, up, sign, _COLOURS[place % len(_COLOURS)], 1.0)
            _frame(panel, everything, right, up, sign, size)
            if row % rows == 0:
                panel.set_title(f'{view} ({"xyz"[right]}, {"xyz"[up]})', fontsize=9)
        panels[row][0].set_ylabel(
            f'{mode.frequency_hz:.1f} Hz\ndamping\n{100.0 * mode.damping_ratio:.2f} %',
            rotation=0, ha='right', va='center', fontsize=10,
        )  # fmt: skip
        _draw_shares(panels[row][-1], mode)
        if row % rows == 0:
            panels[row][-1].set_title('share of elastic energy', fontsize=9)
    _legend(figure, list(rest))
    which = (
        'mode shapes' if len(drawn) == len(modes) else f'lowest {len(drawn)} of {len(modes)} modes'
    )
    figure.suptitle(f'{machine.description.name}: {which}', fontsize=12, y=0.99, va='top')
    _save(figure, path)


def _motion(
    machine: Machine,
    state: NDArray[np.void],
    parameters: NDArray[np.void],
    rest: dict[str, Vector],
    mode: Mode,
) -> dict[str, Vector]:
    """Return the motion of all corners per unit of a mode's shape, m."""
    step = 1e-6
    probe = state.copy()
    shape = np.array([mode.shape[name] for name in machine.coordinates])
    probe[0]['position'][: len(shape)] += step * shape
    moved = moved_corners(machine, probe, parameters)
    return {name: (moved[name] - points) / step for name, points in rest.items()}


def _draw_shares(panel: Axes, mode: Mode) -> None:
    """Draw the elements that hold most of a mode's elastic energy as bars."""
    largest = sorted(mode.energy.items(), key=lambda item: -item[1])[:_NAMED_ELEMENTS]
    shares = [item for item in largest if item[1] >= _LEAST_SHARE]
    rows = range(len(shares))
    panel.barh(rows, [100.0 * share for _, share in shares], height=0.35, color=_SPRING_COLOUR)
    for row, (name, share) in zip(rows, shares, strict=True):
        panel.text(0.0, row - 0.25, f'{name}  {100.0 * share:.0f} %', fontsize=7.5, va='bottom')
    panel.set_ylim(_NAMED_ELEMENTS - 0.4, -0.9)
    panel.set_xlim(0.0, 100.0)
    panel.set_yticks([])
    panel.set_xticks([])
    panel.spines[['top', 'right', 'bottom']].set_visible(False)


def _draw_box(
    panel: Axes, points: Vector, right: int, up: int, sign: float, colour: str, width: float
) -> None:
    for one, other in _EDGES:
        panel.plot(
            points[[one, other], right], sign * points[[one, other], up], color=colour, lw=width
        )


def _frame(panel: Axes, everything: Vector, right: int, up: int, sign: float, size: float) -> None:
    """Show a square that holds the machine in every view, with room for its motion; no axes."""
    half = (0.5 + _LARGEST_MOTION) * size
    for set_limits, values in (
        (panel.set_xlim, everything[:, right]),
        (panel.set_ylim, sign * everything[:, up]),
    ):
        middle = 0.5 * float(values.min() + values.max())
        set_limits(middle - half, middle + half)
    panel.set_aspect('equal')
    panel.set_xticks([])
    panel.set_yticks([])
    for spine in panel.spines.values():
        spine.set_visible(False)


def _legend(figure: Figure, names: list[str]) -> None:
    handles = [
        matplotlib.lines.Line2D([], [], color=_COLOURS[place % len(_COLOURS)], label=name)
        for place, name in enumerate(names)
    ]
    figure.legend(handles=handles, loc='lower center', ncols=4, fontsize=8, frameon=False)


def _subplots(
    rows: int, columns: int, size: tuple[float, float], widths: tuple[float, ...]
) -> tuple[Figure, Any]:
    """Return a figure that needs no display, and its panels (rows, columns)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Figure(figsize=size)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(
        rows, columns, squeeze=False, gridspec_kw={'width_ratios': widths}
    )


def _save(figure: Figure, path: Path) -> None:
    """Write the figure, whole; the same figure gives the same bytes. Raises `OSError`."""
    inches = figure.get_figheight()
    figure.tight_layout(rect=(0.0, 0.55 / inches, 1.0, 1.0 - 0.2 / inches))
    metadata = {'.svg': {'Date': None}, '.pdf': {'CreationDate': None}}.get(path.suffix, {})
    with (
        matplotlib.rc_context({'svg.hashsalt': 'waferbot', 'svg.fonttype': 'none'}),
        replacing(path) as stream,
    ):
        figure.savefig(stream, dpi=100, format=path.suffix[1:], metadata=metadata)


# ---- the mechanism ---------------------------------------------------------------------------


def draw_mechanism(machine: Machine, path: Path) -> None:
    """
    Draw the mechanism into an image file: bodies in side and front view, and how they hang
    together.

    The plan on the right reads from the base down: each line between two bodies is a joint with
    its freedoms; axes are bold, freedoms that parts hold are named with the parts and what holds
    them; transmissions and rotors stand at the right.
    """
    description = machine.description
    plan = _Plan(description)
    height = max(7.0, 0.26 * plan.height)
    figure = Figure(figsize=(15.0, height))
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 2.1))
    boxes = corners(description)
    everything = np.concatenate(list(boxes.values()))
    size = float(np.ptp(everything, axis=0).max())
    for row, view in enumerate(('side', 'front')):
        right, up, sign = VIEWS[view]
        panel = figure.add_subplot(grid[row, 0])
        for place, points in enumerate(boxes.values()):
            _draw_box(panel, points, right, up, sign, _COLOURS[place % len(_COLOURS)], 1.0)
        for joint in description.joints.values():
            if joint.freedoms:
                panel.plot(
                    joint.at[right], sign * joint.at[up], 'o', color='black', ms=4, zorder=5
                )
        _frame(panel, everything, right, up, sign, size)
        panel.set_title(f'{view} view ({"xyz"[right]}, {"xyz"[up]}); dots: joints', fontsize=9)
    plan.draw(figure.add_subplot(grid[:, 1]))
    _legend(figure, list(boxes))
    figure.suptitle(description.name, fontsize=12)
    _save(figure, path)


class _Plan:
    """The plan of a mechanism: where its bodies, joints and rotors are written, in lines of text."""

    line = 1.0
    body = 2.0
    column = 62.0
    springs = 31.0

    def __init__(self, description: Description) -> None:
        self.description = description
        self.bodies: dict[str, tuple[float, float]] = {BASE: (0.0, 0.0)}
        self.lines: list[tuple[float, float, Joint, list[Freedom]]] = []
        self.marks: dict[str, tuple[float, float]] = {}
        self.next_column = 1
        self._place(BASE)
        self.height = 6.0 - min(y for _, y in self.bodies.values())
        self.height += 3.0 * len(description.transmissions)

    def _place(self, name: str) -> None:
        """Place everything that hangs on a body below it; a second child in a column of its own."""
        x, y = self.bodies[name]
        own = [joint for joint in self.description.joints.values() if joint.parent == name]
        for number, joint in enumerate(own):
            column = x if number == 0 else self.column * self.next_column
            self.next_column += number > 0
            freedoms = list(joint.freedoms)
            room = self.line * max(1, len(freedoms)) + 1.0
            self.lines.append((column, y, joint, freedoms))
            for place, freedom in enumerate(freedoms):
                self.marks[freedom.name] = (column, y - self.body - self.line * (place + 0.4))
            self.bodies[joint.child] = (column, y - self.body - room)
            self._place(joint.child)

    def draw(self, panel: Axes) -> None:
        """Draw the plan."""
        description = self.description
        for x, y, joint, freedoms in self.lines:
            below = self.bodies[joint.child][1]
            start = self.bodies[joint.parent]
            if x != start[0]:
                panel.plot([start[0] + 8.0, x], [start[1] - 0.6, start[1] - 0.6], color='black')
                panel.plot([x, x], [start[1] - 0.6, below], color='black', lw=1.2)
            else:
                panel.plot([x, x], [y - 1.2, below], color='black', lw=1.2)
            if not freedoms:
                panel.text(x + 1.5, y - self.body - 0.4, 'fixed', fontsize=8, va='center')
            for freedom in freedoms:
                self._draw_freedom(panel, freedom)
        for number, (name, (x, y)) in enumerate(self.bodies.items()):
            colour = _COLOURS[(number - 1) % len(_COLOURS)] if name != BASE else '#000000'
            if name != BASE:
                colour = _COLOURS[list(description.bodies).index(name) % len(_COLOURS)]
            text = name if name == BASE else f'{name}  {description.bodies[name].mass:.4g} kg'
            panel.add_patch(
                FancyBboxPatch(
                    (x - 1.0, y - 1.2), 1.1 * len(text) + 3.0, 1.3,
                    boxstyle='round,pad=0.1', fc='white', ec=colour, lw=1.5,
                )
            )  # fmt: skip
            panel.text(x, y - 0.55, text, fontsize=9, va='center', color=colour)
        bottom = min(y for _, y in self.bodies.values()) - 3.0
        panel.text(0.0, bottom, 'transmissions and rotors', fontsize=9, weight='bold')
        for line, text in enumerate(self._transmissions()):
            panel.text(0.0, bottom - 1.2 * (line + 1), text, fontsize=8, color=_DRIVE_COLOUR)
        panel.set_xlim(-2.0, self.column * self.next_column)
        panel.set_ylim(bottom - 1.2 * (len(self._transmissions()) + 1), 1.0)
        panel.axis('off')

    def _draw_freedom(self, panel: Axes, freedom: Freedom) -> None:
        """Write one freedom beside its joint."""
        description = self.description
        x, y = self.marks[freedom.name]
        arrow = '\u21bb' if freedom.revolute else '\u2195'
        along = ', '.join(f'{value:g}' for value in freedom.axis)
        unit = 'Nm/rad' if freedom.revolute else 'N/m'
        text = f'{arrow} {freedom.name} ({along})'
        axes = [axis for axis, own in description.axes.items() if own == freedom.name]
        for axis, motor in description.motors.items():
            if motor.coordinate == freedom.name:
                per = 'Nm/A' if freedom.revolute else 'N/A'
                text += (
                    f'  motor {axis}: {motor.winding}, {motors.force_constant(motor):.3g} {per}'
                )
        places = [
            place
            for place, encoder in description.encoders.items()
            if encoder.coordinate == freedom.name
        ]
        text += f'  encoder {", ".join(places)}' if places else ''
        panel.text(x + 1.5, y, text, fontsize=8, va='center', weight='bold' if axes else 'normal')
        if freedom.connections:
            held = ' + '.join(
                f'{name} {description.connections[name].stiffness:.3g} {unit}'
                for name in freedom.connections
            )
            panel.text(
                x + self.springs, y, held,
                fontsize=8, va='center', color=_SPRING_COLOUR,
            )  # fmt: skip

    def _transmissions(self) -> list[str]:
        """Return a line for every transmission and rotor."""
        description = self.description
        lines = []
        for item in description.transmissions.values():
            stages = []
            for stage in item.stages:
                text = f'{stage.kind} {stage.ratio:.4g}'
                if stage.connection:
                    part = description.connections[stage.connection]
                    text += f' ({part.stiffness:.3g} {"Nm/rad" if part.rotary else "N/m"})'
                stages.append(text)
            lines.append(
                f'{item.name}: {item.driving} \u2192 {", ".join(stages)} \u2192 {item.driven}'
            )
        for rotor in description.rotors.values():
            moved = '' if rotor.coordinate == rotor.name else f', turns with {rotor.coordinate}'
            motor = [
                f', motor {axis}: {own.winding}, {motors.force_constant(own):.3g} Nm/A'
                for axis, own in description.motors.items()
                if own.coordinate == rotor.name
            ]
            lines.append(
                f'rotor {rotor.name}: {rotor.inertia:.4g} kg m\u00b2{moved}{"".join(motor)}'
            )
        return lines
