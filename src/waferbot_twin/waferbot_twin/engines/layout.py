# SPDX-License-Identifier: Apache-2.0
"""How a twin is laid out over ROS: which nodes, with which parameters, and in which processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    PLANT_STATE,
    RECORDER_WINDOW,
    SERVO_STATE,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.node_settings import MACHINE_AXES, MACHINE_ENCODERS
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.standard_messages import CLOCK, JOINT_STATES
from waferbot_pmac.user_units import units_text
from waferbot_twin.models import NODES
from waferbot_twin.plan import Plan

STARTUP_TIMEOUT_S = 60.0
"""
Wall time for nodes to start and find each other, if the user does not say; the time that it takes to
start one's own node by hand is part of it.
"""

COMPILING_S = 240.0
"""
Wall time more where nothing of these sources is compiled yet: half a minute of a quiet core, and nodes
compile side by side.
"""


def startup_timeout_s(compiled: bool) -> float:
    """Return how long nodes may take to start, s, where the model is or is not `compiled` yet."""
    return STARTUP_TIMEOUT_S + (0.0 if compiled else COMPILING_S)


TOPICS, DIRECT, CHANNEL = 'topics', 'direct', 'channel'
DELIVERIES = (TOPICS, DIRECT, CHANNEL)
"""
How messages reach their receivers: all by ROS topics; inside a process from node to node, between
processes by topics; or between processes by Unix sockets.
"""

NodeLayout = tuple[str, dict[str, Any]]
"""Kind (plant, pmac, copley) and parameters of a node."""


@dataclass
class RosOptions:
    """
    How to lay the twin out over ROS.

    `compose` names the nodes that live in the runner's process, if not all do (`composed`).
    """

    composed: bool = False
    compose: Sequence[str] = ()
    delivery: str = DIRECT
    one_copley_per_axis: bool = False
    device_clock: str = ''  # policy, if commands are the clock: hold, ramp or fault
    device_timeout_s: float = 1.0
    without: Sequence[str] = ()  # nodes that somebody else provides
    start_order: Sequence[str] = ()  # names of the processes, in the order to start them
    startup_timeout_s: float = STARTUP_TIMEOUT_S
    domain: int | None = None
    any_host: bool = False
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    on_domain: Callable[[int], None] | None = None
    on_processes: Callable[[Mapping[str, int]], None] | None = None


def layout(plan: Plan, options: RosOptions) -> Iterator[tuple[str, NodeLayout]]:
    """Yield name, kind and parameters of each node that this run starts."""
    timing = {
        'current_loop_hz': plan.timing.current_loop_hz,
        'encoder_divider': plan.timing.encoder_divider,
        'servo_divider': plan.timing.servo_divider,
        'end_tick': plan.ticks,
        'startup_timeout_s': options.startup_timeout_s,
    }
    machine = plan.model.layout
    named = {MACHINE_AXES: list(machine.axes), MACHINE_ENCODERS: list(machine.encoders)}
    extra: dict[str, dict[str, Any]] = {
        'plant': {'start_paused': True, 'recorder_window': RECORDER_WINDOW},
        'pmac': {
            'experiment': plan.experiment.text,
            'units': units_text(plan.model.axis_units),
            **named,
        },
        'copley': named,
    }
    if options.device_clock:
        extra['copley'] = {
            **named,
            'device_clock': options.device_clock,
            'device_timeout_s': options.device_timeout_s,
        }
    for node, own in extra.items():
        if node in options.without:
            continue
        parameters = {**timing, **plan.model.parameters[node], **own}
        if node == 'copley' and options.one_copley_per_axis:
            for axis in machine.axes:
                name = f'copley_{axis}'
                if name in options.without:
                    continue
                mine = {key: value for key, value in parameters.items() if key not in machine.axes}
                mine[axis] = parameters.get(axis, {})
                yield name, (node, {**mine, 'axes': [axis], **options.overrides.get(name, {})})
        else:
            yield node, (node, {**parameters, **options.overrides.get(node, {})})


TOPICS_OF = {
    'plant': (
        ENCODERS_TOPIC.name,
        PHASE_CURRENTS.name,
        CLOCK[0],
        JOINT_STATES[0],
        PLANT_STATE.name,
    ),
    'pmac': (CURRENT_COMMAND.name, SERVO_STATE.name),
    'copley': (PHASE_VOLTAGES.name, AMPLIFIER_STATE.name),
}
"""What each kind of node publishes at rate."""


def given_by(names: Iterable[str]) -> list[str]:
    """Return the topics that nodes publish, by their names (`plant`, `copley_x_rotate`, ...)."""
    kinds = {name.partition('_')[0] for name in names}
    return [topic for kind in TOPICS_OF if kind in kinds for topic in TOPICS_OF[kind]]


def on_channel(
    nodes: Mapping[str, NodeLayout], folder: Path, without: Sequence[str]
) -> dict[str, NodeLayout]:
    """Return nodes that exchange messages by a channel, but for those of the nodes in `without`."""
    extra = {'channel': str(folder), 'from_topics': given_by(without) or ['']}
    return {name: (kind, {**parameters, **extra}) for name, (kind, parameters) in nodes.items()}


def check_names(options: RosOptions, axes: Sequence[str]) -> None:
    """Refuse to leave out a node that this twin does not have."""
    copleys = [f'copley_{axis}' for axis in axes] if options.one_copley_per_axis else []
    known = [*NODES, *copleys]
    for name in options.without:
        if name not in known:
            hint = (
                ' (with --copley-per-axis)'
                if name.startswith('copley_')
                else did_you_mean(name, known)
            )
            raise UserError(
                f'--without {name}: the twin has no such node{hint}; it has {", ".join(known)}'
            )
