# SPDX-License-Identifier: Apache-2.0
"""
A position controller behind a bad network: it loses 1 % of its commands and sends 1 % late.

It runs in real time: in each servo cycle of which it hears, it answers the newest counts that there are
with one command on `current_command`, but for

    dropped     1 in 100, at random: never sent
    delayed     1 in 100, at random: sent up to 5 ms of wall time later; `overtaken` are those of them
                that were sent after the command of a later cycle
    unanswered  cycles that went by while it was busy, or of which it never heard

The command of tick 0 is never lost: the amplifiers answer nobody before they have heard it, so all that
comes later is sent to peers that hear. After `--seconds` the last command is sent, also without loss,
and repeated as a sign of life until SIGINT; what was done is printed as one line of JSON.

It knows the messages and nothing else of waferbot. The law is that of foreign_pmac.py, with the speed
taken over all the time since the last command.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import json
import random
import time

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from waferbot_msgs.msg import CurrentCommand, Encoders

SERVO_TICKS = 8
DROPPED, DELAYED = 0.01, 0.01
LONGEST_DELAY_S = 5e-3
REPEAT_S = 0.1
PROPORTIONAL = (1.43e-3, 3.91e-2, 1.01e-3)  # A/count
DERIVATIVE = (1.8e-2, 2.9e-1, 2.5e-2)  # A/(count per servo cycle)
BIAS = (0.731, -8.111, 0.0)  # A
LARGEST = 35.0  # A
STRETCH_S = 10.0  # of wall time, for each of which the largest deviations are told


class LossyPmac(Node):
    def __init__(self, seconds: float, seed: int) -> None:
        super().__init__('pmac')
        qos = QoSProfile(depth=1024, reliability=ReliabilityPolicy.RELIABLE)
        self.publisher = self.create_publisher(CurrentCommand, 'current_command', qos)
        self.create_subscription(Encoders, 'encoders', self.on_encoders, 1)  # the newest alone
        self.create_timer(REPEAT_S, self.repeat)
        self.rng = random.Random(seed)
        self.seconds = seconds
        self.end_s = float('inf')
        self.delayed: list[tuple[float, int, CurrentCommand]] = []  # due, tick, command
        self.cycle = -1  # the newest that was answered, or whose answer was dropped
        self.previous: tuple[int, list[float]] | None = None  # tick and counts
        self.newest = CurrentCommand()  # the newest that was sent
        self.spoke_s = 0.0
        self.ended = False
        self.counts = {
            'sent': 0, 'dropped': 0, 'delayed': 0, 'overtaken': 0, 'unanswered': 0, 'last tick': 0,
            'largest deviation': 0.0, 'largest deviations': [],
        }  # fmt: skip
        self.begun_s = 0.0

    def on_encoders(self, encoders: Encoders) -> None:
        """Answer the servo cycle of the newest counts, if it has not been answered yet."""
        cycle = encoders.tick // SERVO_TICKS
        if self.ended or cycle <= self.cycle:
            return
        if self.cycle < 0 and encoders.tick > 0:
            raise SystemExit(f'the twin has begun without this controller: tick {encoders.tick}')
        self.counts['unanswered'] += cycle - self.cycle - 1
        self.cycle = cycle
        now_s = time.monotonic()
        if cycle > 0:
            self.end_s = min(self.end_s, now_s + self.seconds)
        command = self.command(encoders, cycle * SERVO_TICKS)
        if now_s > self.end_s:
            self.end(command)
            return
        lot = self.rng.random() if cycle else 1.0
        if lot < DROPPED:
            self.counts['dropped'] += 1
        elif lot < DROPPED + DELAYED:
            self.counts['delayed'] += 1
            due_s = now_s + self.rng.uniform(0.0, LONGEST_DELAY_S)
            heapq.heappush(self.delayed, (due_s, command.tick, command))
        else:
            self.send(command)

    def command(self, encoders: Encoders, tick: int) -> CurrentCommand:
        """Hold the axes where they are at count zero: PD and a bias against the load's weight."""
        counts = [float(value) for value in encoders.counts[:3]]
        before, previous = self.previous or (encoders.tick - SERVO_TICKS, counts)
        self.previous = encoders.tick, counts
        cycles = (encoders.tick - before) / SERVO_TICKS
        self.note_deviations(counts)
        current = []
        for axis in range(3):
            speed = (counts[axis] - previous[axis]) / cycles
            wanted = BIAS[axis] - PROPORTIONAL[axis] * counts[axis] - DERIVATIVE[axis] * speed
            current.append(max(-LARGEST, min(LARGEST, wanted)))
        command = CurrentCommand(tick=tick, valid=0b111, current=current)
        stamp_ns = tick * 500000 // 9
        command.header.stamp.sec, command.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        return command

    def note_deviations(self, counts: list[float]) -> None:
        """Keep how far each axis was from where it is held, in each stretch of wall time."""
        told = self.counts
        told['largest deviation'] = max(told['largest deviation'], *map(abs, counts))
        self.begun_s = self.begun_s or time.monotonic()
        stretches = told['largest deviations']
        while len(stretches) <= (time.monotonic() - self.begun_s) / STRETCH_S:
            stretches.append([0.0] * 3)
        stretches[-1] = [max(pair) for pair in zip(stretches[-1], map(abs, counts), strict=True)]

    def send(self, command: CurrentCommand) -> None:
        self.counts['sent'] += 1
        if command.tick < self.newest.tick:
            self.counts['overtaken'] += 1
        else:
            self.newest = command
        self.publisher.publish(command)
        self.spoke_s = time.monotonic()

    def send_due(self) -> None:
        """Send the delayed commands whose time has come."""
        while self.delayed and self.delayed[0][0] <= time.monotonic():
            self.send(heapq.heappop(self.delayed)[2])

    def wait_s(self) -> float:
        """Return how long nothing is due."""
        due_s = self.delayed[0][0] - time.monotonic() if self.delayed else REPEAT_S
        return min(max(due_s, 0.0), REPEAT_S)

    def repeat(self) -> None:
        if self.counts['sent'] and time.monotonic() - self.spoke_s > REPEAT_S / 2:
            self.publisher.publish(self.newest)

    def end(self, command: CurrentCommand) -> None:
        """Send what is delayed and the last command; say what was done."""
        self.ended = True
        while self.delayed:
            self.send(heapq.heappop(self.delayed)[2])
        self.send(command)
        self.counts['last tick'] = command.tick
        print(json.dumps(self.counts), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument('--seconds', type=float, required=True)
    parser.add_argument('--seed', type=int, required=True)
    options = parser.parse_args()
    rclpy.init()
    node = LossyPmac(options.seconds, options.seed)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        while True:
            executor.spin_once(timeout_sec=node.wait_s())
            node.send_due()


if __name__ == '__main__':
    main()
