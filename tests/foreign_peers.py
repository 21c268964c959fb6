# SPDX-License-Identifier: Apache-2.0
"""What peers in other languages are given, and how they are compared with ours."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from harness import (
    LONG_PATIENCE_S,
    PATIENCE_S,
    Client,
    Program,
    domain_of,
    run_engine,
    start_node,
    waferbot,
)
from std_srvs.srv import SetBool

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import AXES, LOCKSTEP_TOPICS
from waferbot_msgs.msg import CurrentCommand, Encoders, PhaseVoltages
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording

SERVO = ('Ixx08', 'Ixx09', 'Ixx29', 'Ixx30', 'Ixx31', 'Ixx32', 'Ixx33', 'amplifier_peak_current')
DRIVE = (
    'commutation_encoder', 'counts_per_electrical_cycle', 'proportional', 'integral',
    'bus_voltage', 'peak_limit', 'motor_line_resistance',
)  # fmt: skip
STEPS = (2500, 800, 1000)  # counts, as in the experiment `step`
STEP_TICK = 360
PASSED_OVER = {'stale message', 'missing message', 'contradicting message', 'silence'}
"""Mistakes of their peers that the programs in C and C++ pass over."""

STATES = {'pmac': 'servo_state', 'copley': 'amplifier_state'}
"""What only our own nodes say of themselves."""


def pmac_arguments() -> list[str]:
    """Return the numbers that a foreign PMAC takes: those of the rigid model."""
    values = servo_parameters(_settings('pmac'))[0]
    numbers: list[Any] = [STEP_TICK]
    for place, counts in enumerate(STEPS):
        numbers += [counts, *(values[name][place] for name in SERVO)]
    return [str(number) for number in numbers]


def copley_arguments() -> list[str]:
    """Return the numbers that foreign amplifiers take: those of the rigid model."""
    values = amplifier_parameters(_settings('copley'))[0]
    return [str(values[name][place]) for place in range(len(AXES)) for name in DRIVE]


def _settings(node: str) -> dict[str, Any]:
    parameters = make_plan('rigid', 'step').model.parameters[node]
    return {axis: parameters[axis] for axis in AXES}


def check_same_bits(
    start: Callable[..., Program],
    folder: Path,
    peers: dict[str, Sequence[str]],
    duration_s: float,
    layout: Sequence[str] = (),
) -> None:
    """Run the twin with foreign peers (node: command); compare with the run of ours, bit for bit."""
    out = folder / 'run'
    without = [word for node in peers for word in ('--without', node)]
    twin = start(
        'waferbot_twin', 'run', *without, '--duration', str(duration_s), '--out', str(out), *layout
    )
    environment = {
        'ROS_DOMAIN_ID': str(domain_of(twin)),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    strangers = {
        node: Program(command, folder / f'{node}.log', environment)
        for node, command in peers.items()
    }
    try:
        code = twin.wait(LONG_PATIENCE_S)
    finally:
        for stranger in strangers.values():
            stranger.process.terminate()
        ends = {node: stranger.process.wait(PATIENCE_S) for node, stranger in strangers.items()}
    assert code == 0, twin.output + ''.join(one.output for one in strangers.values())
    assert set(ends.values()) == {0}, ends
    one = read_recording(out)
    other = run_engine('inprocess', folder / 'ours', duration_s=duration_s)
    for topic in LOCKSTEP_TOPICS:
        np.testing.assert_array_equal(one[topic], other[topic], err_msg=topic.name)
    assert len(one['current_command']) == round(2250 * duration_s)
    unsaid = [STATES[node] for node in peers]
    differing = differing_signals(one, other)
    assert [name for name in differing if not any(state in name for state in unsaid)] == []


def check_real_time(
    start: Callable[..., Program],
    client: Client,
    domain: int,
    log: Path,
    node: str,
    command: Sequence[str],
    patience_s: float,
    stands_still: bool = False,
) -> None:
    """
    Run the twin in real time with a foreign peer (`--realtime`): the axes move by the step, and stay.

    At a tenth of the speed; with much `patience_s` of our nodes load makes time slow and no more. Time
    begins when all have heard each other, so that no axis falls before. Where it `stands_still` for 0.2
    s meanwhile, who hears it counts that, and no more comes of it.
    """
    real_time = ('timekeeping:=realtime', f'patience_s:={patience_s}')
    hearer, topic = {
        'pmac': ('copley', 'current_command'),
        'copley': ('plant', 'phase_voltages'),
    }[node]
    start_node(start, 'plant', domain, *real_time, 'realtime_factor:=0.1', 'start_paused:=true')
    own = {'pmac': [*real_time, 'experiment:=step'], 'copley': [*real_time]}
    for name in own.keys() - {node}:
        start_node(start, name, domain, *own[name])
    environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    stranger = Program([command[0], '--realtime', *command[1:]], log, environment)
    newest: list[Any] = []
    client.node.create_subscription(Encoders, 'encoders', newest.append, 1)
    told: dict[str, Any] = {}
    client.node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda array: told.update({one.name: one for one in array.status}),
        10,
    )
    heard: set[str] = set()
    for kind, name in ((CurrentCommand, 'current_command'), (PhaseVoltages, 'phase_voltages')):
        client.node.create_subscription(kind, name, lambda _, name=name: heard.add(name), 10)

    def counted(what: str) -> int:
        values = told[f'/{hearer}: timekeeping'].values
        return int(next(one.value for one in values if one.key == f'{topic} {what}'))

    def at(tick: int) -> bool:
        return bool(newest) and newest[-1].tick > tick

    def near(message: Any, share: float) -> bool:
        return bool(np.all(np.abs(np.array(message.counts[:3]) - STEPS) < share * np.array(STEPS)))

    try:
        client.spin_until(
            lambda: (
                newest
                and len(heard) == 2
                and f'/{hearer}: timekeeping' in told
                and counted('received')
            ),
            'all have heard each other',
        )
        client.call(SetBool, 'plant/pause', SetBool.Request(data=False))
        client.spin_until(lambda: at(3000), 'time going on')
        if stands_still:
            stranger.signal(signal.SIGSTOP)
            client.spin_until(lambda: at(newest[0].tick + 4000), 'time going on without it')
            stranger.signal(signal.SIGCONT)
        client.spin_until(
            lambda: at(9000) and near(newest[-1], 0.02), 'the axes moved by the step'
        )
        before = len(newest)
        client.spin_until(lambda: len(newest) > before + 300, 'held')
        assert all(near(one, 0.05) for one in newest[before:])
        client.spin_until(
            lambda: counted('received') > 500 and (counted('missed') > 0 or not stands_still),
            'counted, as is told once a second',
        )
        assert counted('contradicting') == 0
        assert stranger.process.poll() is None, stranger.output
    finally:
        stranger.process.terminate()
        code = stranger.process.wait(PATIENCE_S)
    assert code == 0, stranger.output


def check_conformance(node: str, command: Sequence[str], forgiven: set[str]) -> None:
    """Drive a peer through the conformance kit: right in everything, or passing over as it may."""
    result = waferbot('conform', '--node', node, '--json', *command)
    assert result.returncode == 0, result.stdout + result.stderr
    grades = {one['check']: one['grade'] for one in json.loads(result.stdout)}
    assert {check for check, grade in grades.items() if grade == 'tolerated'} == forgiven
    assert set(grades.values()) == {'right', 'tolerated'}
