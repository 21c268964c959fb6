# SPDX-License-Identifier: Apache-2.0
"""
A stranger's position controller, from the contract alone: counts in, current commands out.

A PD law with a constant bias against the load's weight. It knows the messages, that a servo tick is
every 8th, and that a node that waits repeats its last message. It imports nothing of waferbot but
the messages.
"""

import contextlib
import copy

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from waferbot_msgs.msg import CurrentCommand, Encoders

SERVO_TICKS = 8
STEP_TICK = 360
STEP_COUNTS = 2500  # of y_linear: 0.25 mm
PROPORTIONAL = (1.43e-3, 3.91e-2, 1.01e-3)  # A/count
DERIVATIVE = (1.8e-2, 2.9e-1, 2.5e-2)  # A/(count per servo cycle)
BIAS = (0.731, -8.111, 0.0)  # A
LARGEST = 35.0  # A


class ForeignPmac(Node):
    def __init__(self):
        super().__init__('foreign_pmac')
        # As deep as the contract says: a recorder may be hundreds of ticks behind.
        qos = QoSProfile(depth=1024, reliability=ReliabilityPolicy.RELIABLE)
        self.publisher = self.create_publisher(CurrentCommand, 'current_command', qos)
        self.create_subscription(Encoders, 'encoders', self.on_encoders, qos)
        self.create_timer(0.1, self.repeat)
        self.answer = None
        self.repeated = None
        self.previous = None

    def on_encoders(self, encoders):
        if encoders.tick % SERVO_TICKS or (self.answer and encoders.tick <= self.answer.tick):
            return
        counts = [float(value) for value in encoders.counts[:3]]
        previous = self.previous or counts
        self.previous = counts
        target = [STEP_COUNTS if encoders.tick >= STEP_TICK else 0, 0, 0]
        current = []
        for axis in range(3):
            error = target[axis] - counts[axis]
            speed = counts[axis] - previous[axis]
            command = PROPORTIONAL[axis] * error - DERIVATIVE[axis] * speed + BIAS[axis]
            current.append(max(-LARGEST, min(LARGEST, command)))
        answer = CurrentCommand(tick=encoders.tick, valid=0b111, current=current)
        answer.header.stamp = copy.copy(encoders.header.stamp)
        self.answer = answer
        self.publisher.publish(answer)

    def repeat(self):
        if self.answer and self.answer is self.repeated:
            self.publisher.publish(self.answer)
        self.repeated = self.answer


def main():
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(ForeignPmac())


if __name__ == '__main__':
    main()
