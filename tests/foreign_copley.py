# SPDX-License-Identifier: Apache-2.0
"""
A stranger's amplifier for y_linear, from the contract alone: a PI current loop per line.

Line k should carry I sin(theta - 2 pi (k - 1) / 3), with theta the electrical angle, zero at
position zero; the third line follows by Kirchhoff. It imports nothing of waferbot but the messages.
"""

import contextlib
import copy
import math

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from waferbot_msgs.msg import CurrentCommand, Encoders, PhaseCurrents, PhaseVoltages

COUNTS_PER_PITCH = 320000.0  # 32 mm at 0.1 um
PROPORTIONAL = 37.0  # V/A: 1 kHz on 6 mH
INTEGRAL = 6283.0 / 18000  # V/A per tick: 1 kHz on 1 ohm
LARGEST = 160.0  # V


class ForeignCopley(Node):
    def __init__(self):
        super().__init__('foreign_copley')
        # As deep as the contract says: a recorder may be hundreds of ticks behind.
        qos = QoSProfile(depth=1024, reliability=ReliabilityPolicy.RELIABLE)
        self.publisher = self.create_publisher(PhaseVoltages, 'phase_voltages', qos)
        self.newest = {}
        self.spacing = {PhaseCurrents: 1, Encoders: 2, CurrentCommand: 8}
        names = {
            PhaseCurrents: 'phase_currents', Encoders: 'encoders', CurrentCommand: 'current_command'
        }  # fmt: skip
        for kind, name in names.items():
            self.create_subscription(kind, name, self.on_message, qos)
        self.create_timer(0.1, self.repeat)
        self.tick = 0
        self.integral = [0.0, 0.0]
        self.answer = None
        self.repeated = None

    def on_message(self, message):
        if message.valid & 1:
            self.newest[type(message)] = message
        while all(
            kind in self.newest and self.newest[kind].tick == self.tick - self.tick % spacing
            for kind, spacing in self.spacing.items()
        ):
            self.close_loop()

    def close_loop(self):
        measured = self.newest[PhaseCurrents].current
        command = self.newest[CurrentCommand].current[0]
        angle = 2 * math.pi * self.newest[Encoders].counts[0] / COUNTS_PER_PITCH
        voltage = []
        for line in range(2):
            error = command * math.sin(angle - 2 * math.pi * line / 3) - measured[line]
            self.integral[line] += INTEGRAL * error
            wanted = PROPORTIONAL * error + self.integral[line]
            voltage.append(max(-LARGEST, min(LARGEST, wanted)))
        voltage.append(-voltage[0] - voltage[1])
        answer = PhaseVoltages(tick=self.tick, valid=1, voltage=voltage + [0.0] * 6, open=0)
        answer.header.stamp = copy.copy(self.newest[PhaseCurrents].header.stamp)
        self.answer = answer
        self.publisher.publish(answer)
        self.tick += 1

    def repeat(self):
        if self.answer and self.answer is self.repeated:
            self.publisher.publish(self.answer)
        self.repeated = self.answer


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(ForeignCopley())


if __name__ == '__main__':
    main()
