# SPDX-License-Identifier: Apache-2.0
"""A position controller with one fault, named on its command line, for the conformance kit to find."""

import contextlib
import math
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from waferbot_msgs.msg import CurrentCommand, Encoders, Stop

FAULT = sys.argv[1]


class FaultyPmac(Node):
    def __init__(self):
        super().__init__('faulty_pmac')
        qos = QoSProfile(depth=1024, reliability=ReliabilityPolicy.RELIABLE)
        self.publisher = self.create_publisher(CurrentCommand, 'current_command', qos)
        self.create_subscription(Encoders, 'encoders', self.on_encoders, qos)
        self.create_subscription(Stop, 'stop', self.on_stop, 10)
        self.create_timer(0.1, self.repeat)
        self.answer = None
        if FAULT in ('speaks first', 'starts late and speaks first'):
            self.answer = self.answer_to(Encoders(tick=0))

    def answer_to(self, encoders):
        tick = encoders.tick
        answer = CurrentCommand(tick=tick, valid=0b111, current=[0.25 * encoders.counts[0]] * 3)
        answer.header.stamp.nanosec = tick * 500000 // 9
        if FAULT == 'stamps by accumulating':
            answer.header.stamp.nanosec = tick // 8 * 444444
        if FAULT == 'speaks for a fourth axis':
            answer.valid = 0b1111
        if FAULT == 'divides by zero':
            answer.current[2] = math.nan
        if FAULT == 'lags by a cycle':
            answer.tick = max(tick - 8, 0)
            answer.header.stamp.nanosec = answer.tick * 500000 // 9
        return answer

    def on_encoders(self, encoders):
        if encoders.tick % 8 and FAULT != 'answers every message':
            return
        known = self.answer is not None and FAULT != 'believes everything'
        if known and encoders.tick <= self.answer.tick and FAULT != 'lags by a cycle':
            return
        self.answer = self.answer_to(encoders)
        self.publisher.publish(self.answer)

    def on_stop(self, stop):
        if FAULT != 'does not hear a stop':
            raise SystemExit

    def repeat(self):
        if self.answer is not None and FAULT != 'repeats nothing':
            self.publisher.publish(self.answer)


rclpy.init()
if FAULT == 'starts late and speaks first':
    time.sleep(3)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(FaultyPmac())
