# SPDX-License-Identifier: Apache-2.0
"""Real time: our own nodes go on whatever comes late, twice, early or not at all, and whoever leaves."""

from __future__ import annotations

import math
import random
import re
import signal
import sys
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import PATIENCE_S, start_node

sys.path.insert(0, str(Path(__file__).parent / 'bench'))

from endurance.losses import losses

from waferbot_msgs.msg import CurrentCommand, Encoders, PhaseCurrents, PhaseVoltages

SEED = 20241
NODES = ('plant', 'pmac', 'copley')
FAR_ENOUGH = 1500
"""Ticks: nobody who has missed something at the start comes that far."""

LATE = 10 * FAR_ENOUGH
"""Ticks, 0.8 s: a plant that begins anew is seen before it is there again."""

pytestmark = [pytest.mark.slow, pytest.mark.alone]


class Onlooker:
    """What a client sees of the twin: the newest tick of each topic, and the diagnostics."""

    def __init__(self, client):
        self.client = client
        self.tick = {}
        self.diagnostics = {}
        for kind, name in (
            (Encoders, 'encoders'), (CurrentCommand, 'current_command'),
            (PhaseVoltages, 'phase_voltages'),
        ):  # fmt: skip
            client.node.create_subscription(
                kind, name, lambda message, name=name: self.tick.update({name: message.tick}), 1
            )
        client.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_told, 10)

    def _on_told(self, array):
        for status in array.status:
            self.diagnostics[status.name.split(':')[0].strip('/')] = status

    def told(self, node, key):
        status = self.diagnostics.get(node)
        values = {value.key: value.value for value in status.values} if status else {}
        return float(values.get(key) or 'nan')

    def message_of(self, node):
        return self.diagnostics[node].message if node in self.diagnostics else ''

    def wait_for(self, done, what):
        self.client.spin_until(done, what, 60.0)

    def wait_for_tick(self, least, most=10**9):
        self.wait_for(
            lambda: (
                len(self.tick) == 3 and all(least < tick < most for tick in self.tick.values())
            ),
            f'all topics beyond tick {least}',
        )


def start_all(start, domain, order, delays=(0.0, 0.0, 0.0)):
    nodes = {}
    for name, delay_s in zip(order, delays, strict=True):
        nodes[name] = start_node(start, name, domain, 'timekeeping:=realtime')
        time.sleep(delay_s)
    return nodes


def test_all_three_run_in_any_order_of_starting(start, connect):
    from waferbot_twin.engines.domain import Domain

    rng = random.Random(SEED)
    for _ in range(3):
        order, delays = list(NODES), [rng.choice((0.0, rng.uniform(0.0, 2.5))) for _ in NODES]
        rng.shuffle(order)
        print(f'seed {SEED}: {order} with {delays} s behind each')
        domain = Domain()
        nodes = start_all(start, domain.number, order, delays)
        client = connect(domain.number)
        Onlooker(client).wait_for_tick(FAR_ENOUGH)
        for name, program in nodes.items():
            assert program.process.poll() is None, f'{name} ended\n{program.output}'
            program.end()
        domain.release()


def test_any_of_them_may_be_stopped_and_started_again(start, connect, domain):
    rng = random.Random(SEED)
    ends = [('plant', signal.SIGKILL), ('copley', signal.SIGKILL), ('pmac', signal.SIGINT)]
    rng.shuffle(ends)
    print(f'seed {SEED}: {ends}')
    nodes = start_all(start, domain, NODES)
    seen = Onlooker(connect(domain))
    seen.wait_for_tick(FAR_ENOUGH)
    for victim, number in ends:
        stop_and_start_again(start, domain, nodes, seen, victim, number)
    for name, program in nodes.items():
        assert program.process.poll() is None, f'{name} ended\n{program.output}'


def stop_and_start_again(start, domain, nodes, seen, victim, number):
    seen.wait_for_tick(LATE)
    before = min(seen.tick.values())
    nodes[victim].signal(number)
    nodes[victim].process.wait(PATIENCE_S)
    others = [name for name in NODES if name != victim]
    seen.wait_for(
        lambda: any(f'{victim} is gone' in seen.message_of(name) for name in others),
        f'{victim} missed on /diagnostics',
    )
    assert any(seen.diagnostics[name].level == DiagnosticStatus.ERROR for name in others)
    if victim != 'plant':
        at = seen.tick['encoders']
        seen.wait_for(lambda: seen.tick['encoders'] > at + 500, 'time going on without it')

    nodes[victim] = start_node(start, victim, domain, 'timekeeping:=realtime')
    if victim == 'plant':
        seen.wait_for_tick(20, before)  # time has begun anew
        seen.wait_for_tick(FAR_ENOUGH)
    else:
        seen.wait_for_tick(seen.tick['encoders'] + 200)
    seen.wait_for(
        lambda: not any(f'{victim} is gone' in seen.message_of(name) for name in others),
        f'{victim} back on /diagnostics',
    )
    missing_it = ''.join(nodes[name].output for name in others)
    assert f'{victim} is gone' in missing_it
    assert f'{victim} is back' in missing_it


def test_time_follows_the_wall_clock_or_says_by_how_much_it_cannot(start, connect, domain):
    start_all(start, domain, NODES)
    seen = Onlooker(connect(domain))
    seen.wait_for_tick(FAR_ENOUGH)
    seen.wait_for(lambda: seen.told('plant', 'realtime factor') > 0.0, 'the rate')
    rate = seen.told('plant', 'realtime factor')
    says = re.search(r'([\d.e-]+) x real time, 1 x asked for', seen.message_of('plant'))
    assert rate < 1.2
    assert (says is not None) == (rate < 0.97)
    if says:
        assert float(says[1]) == pytest.approx(rate, rel=0.1)
        assert 'too slow for 18 kHz' in seen.message_of('plant')


# ---- a peer of the plant that does as the test likes -----------------------------------------------

FACTOR = 0.02


class FreePeer:
    """A stand-in for the amplifiers: answers each tick with no voltage at all, as the test says."""

    def __init__(self, client):
        self.client = client
        self.seen = Onlooker(client)
        self.publisher = client.node.create_publisher(PhaseVoltages, 'phase_voltages', 50)
        client.node.create_subscription(PhaseCurrents, 'phase_currents', self.on_currents, 50)
        self.answers = True
        self.tick = -1

    def on_currents(self, currents):
        self.tick = max(self.tick, currents.tick)
        if self.answers:
            self.answer(currents.tick)

    def answer(self, tick, **changes):
        message = PhaseVoltages(tick=tick, valid=0b111, open=0, **changes)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * 500000 // 9, 10**9)
        self.publisher.publish(message)

    def wait_for_tick(self, tick):
        self.seen.wait_for(lambda: self.tick > tick, f'tick {tick}')

    def count(self, key):
        return self.seen.told('plant', f'phase_voltages {key}')


@pytest.fixture
def plant(start, domain):
    return start_node(
        start, 'plant', domain, 'timekeeping:=realtime', f'realtime_factor:={FACTOR}'
    )


@pytest.fixture
def peer(plant, connect, domain):
    return FreePeer(connect(domain))


def test_what_comes_late_early_twice_or_not_at_all_is_counted_and_stops_nothing(plant, peer):
    peer.wait_for_tick(50)
    peer.seen.wait_for(lambda: peer.count('received') > 0, 'diagnostics')
    late, missed = peer.count('late'), peer.count('missed')
    # Silent for a while, then an answer to a tick long past: late, and the ones before it missed.
    peer.answers = False
    silent_from = peer.tick
    peer.wait_for_tick(silent_from + 120)
    peer.answer(silent_from + 60)
    peer.seen.wait_for(lambda: peer.count('late') > late, 'the late one told')
    assert peer.seen.diagnostics['plant'].level == DiagnosticStatus.WARN
    assert 50 <= peer.count('missed') - missed < 60 + 3, 'messages, not places'
    assert peer.count('behind [ticks]') > 0
    assert peer.count('lateness, worst [ms]') > 0.0

    peer.answer(silent_from + 60)
    peer.answer(peer.tick + 500)
    peer.answer(peer.tick + 100_000)
    peer.seen.wait_for(lambda: peer.count('doubled') > 0, 'the doubled one told')
    peer.seen.wait_for(lambda: peer.count('early') == 2, 'the early ones told')
    peer.answers = True
    peer.answer(peer.tick)
    peer.wait_for_tick(peer.tick + 200)
    peer.seen.wait_for(lambda: peer.count('behind [ticks]') <= 2, 'in step again')
    assert plant.process.poll() is None, plant.output


def test_silence_is_told_and_stops_nothing(plant, peer):
    peer.wait_for_tick(20)
    peer.answers = False
    peer.seen.wait_for(
        lambda: 'copley is gone: topic phase_voltages' in peer.seen.message_of('plant'), 'silence'
    )
    assert peer.seen.diagnostics['plant'].level == DiagnosticStatus.ERROR
    peer.wait_for_tick(peer.tick + 100)
    assert plant.process.poll() is None, plant.output


def test_no_finite_number_still_stops_it(plant, peer):
    peer.wait_for_tick(20)
    peer.answer(peer.tick, voltage=[math.nan] + [0.0] * 8)
    assert plant.wait() == 1
    assert re.search(r'topic phase_voltages, tick \d+ from copley: .*finite', plant.output)


# ---- amplifiers that were away ---------------------------------------------------------------------


def stamped(message, tick):
    message.tick = tick
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * 500000 // 9, 10**9)
    return message


def test_amplifiers_that_were_away_answer_the_newest_tick_not_all_that_went_by(
    start, connect, domain
):
    """
    A plant that does not wait has gone on by 600 ticks meanwhile.

    Who works off all of them answers ticks long past, and falls further behind as it does.
    """
    copley = start_node(start, 'copley', domain, 'timekeeping:=realtime')
    client = connect(domain)
    answers = []
    client.node.create_subscription(
        PhaseVoltages, 'phase_voltages', lambda message: answers.append(message.tick), 1024
    )
    currents = client.node.create_publisher(PhaseCurrents, 'phase_currents', 1024)
    encoders = client.node.create_publisher(Encoders, 'encoders', 1024)
    commands = client.node.create_publisher(CurrentCommand, 'current_command', 1024)

    def tell(tick):
        if tick % 2 == 0:
            encoders.publish(stamped(Encoders(valid=0b1111), tick))
        if tick % 8 == 0:
            commands.publish(stamped(CurrentCommand(valid=0b111), tick))
        currents.publish(stamped(PhaseCurrents(valid=0b111), tick))

    def answered(tick):
        if not answers:
            tell(0)  # a sign of life: Copley may not have been there yet
        return tick in answers

    client.spin_until(lambda: answered(0), 'the first answer')
    for tick in range(1, 9):
        tell(tick)
        client.spin_until(lambda tick=tick: tick in answers, f'an answer to tick {tick}')
    copley.signal(signal.SIGSTOP)
    answers.clear()
    for tick in range(9, 610):
        tell(tick)
    copley.signal(signal.SIGCONT)
    client.spin_until(lambda: 609 in answers, 'an answer to the newest tick')
    assert len(set(answers)) < 20, f'{len(set(answers))} ticks of the past were answered'


def test_a_command_that_is_lost_does_not_cost_the_plant_its_voltages(start, connect, domain):
    """The amplifiers go on by themselves before the plant would; it counts no voltages as missed."""
    start_node(start, 'plant', domain, 'timekeeping:=realtime', 'patience_s:=5.0')
    start_node(start, 'copley', domain, 'timekeeping:=realtime', 'patience_s:=5.0')
    client = connect(domain)
    seen = Onlooker(client)
    commands = client.node.create_publisher(CurrentCommand, 'current_command', 1024)

    def begun():
        if seen.tick.get('phase_voltages', -1) < 0:
            commands.publish(stamped(CurrentCommand(valid=0b111), 0))
        return seen.tick.get('phase_voltages', -1) >= 8

    client.spin_until(begun, 'the first servo cycle, and the second without a command', 120.0)
    seen.wait_for(lambda: seen.told('plant', 'phase_voltages received') > 8, 'the plant to tell')
    assert seen.told('plant', 'phase_voltages missed') == 0


# ---- a controller behind a bad network -------------------------------------------------------------


def test_a_controller_that_loses_and_delays_commands_is_counted_to_the_message(tmp_path):
    """For a few seconds; `tests/bench/bench_endurance.py` does it for ten minutes."""
    found = losses(6.0, SEED, tmp_path)
    print(f'seed {SEED}: {found}')
    assert found['ok'], found
    assert found['done']['dropped'] > 0
    assert found['done']['delayed'] > 0
    # A command that was lost costs one servo cycle; the axes hardly notice (142 counts of the start).
    assert found['done']['largest deviation'] < 1000
