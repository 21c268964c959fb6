# SPDX-License-Identifier: Apache-2.0
"""
A stand-in for ros2_control: a JointStateTopicSystem with a JointTrajectoryController on effort.

It knows sensor_msgs and nothing of waferbot. Topics, names, quality of service and what is left empty
are those of the hardware component; the law is that of control_toolbox's Pid with the gains of the
controllers' file,

    effort = p e + clamp(i int e dt, +-i_clamp) + d (0 - velocity)        e = target - position

at 500 Hz of wall time. As the real one it commands from its start on, whatever it has heard, and holds
position zero until it is told another target on /target (JointState).
"""

from __future__ import annotations

import contextlib
import sys
import time

import rclpy
import yaml
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState


class StandIn(Node):
    def __init__(self, file: str) -> None:
        super().__init__('controller_manager')
        with open(file, encoding='utf-8') as stream:
            told = yaml.safe_load(stream)
        rate_hz = told['controller_manager']['ros__parameters']['update_rate']
        own = told['joint_trajectory_controller']['ros__parameters']
        self.joints, self.gains = own['joints'], own['gains']
        self.position = dict.fromkeys(self.joints, 0.0)
        self.velocity = dict.fromkeys(self.joints, 0.0)
        self.target = dict.fromkeys(self.joints, 0.0)
        self.integral = dict.fromkeys(self.joints, 0.0)
        self.updated_s = time.monotonic()
        self.commands = self.create_publisher(
            JointState, '/robot_joint_commands', QoSProfile(depth=1)
        )
        self.create_subscription(
            JointState, '/robot_joint_states', self.on_states, qos_profile_sensor_data
        )
        self.create_subscription(JointState, '/target', self.on_target, 1)
        self.create_timer(1.0 / rate_hz, self.update)

    def on_states(self, states: JointState) -> None:
        self.position.update(zip(states.name, states.position, strict=True))
        self.velocity.update(zip(states.name, states.velocity, strict=True))

    def on_target(self, target: JointState) -> None:
        self.target.update(zip(target.name, target.position, strict=True))

    def update(self) -> None:
        now_s = time.monotonic()
        period_s, self.updated_s = now_s - self.updated_s, now_s
        command = JointState(name=list(self.joints))
        command.header.stamp = self.get_clock().now().to_msg()
        for joint in self.joints:
            gains = self.gains[joint]
            error = self.target[joint] - self.position[joint]
            integral = self.integral[joint] + gains['i'] * error * period_s
            self.integral[joint] = max(-gains['i_clamp'], min(gains['i_clamp'], integral))
            damping = gains['d'] * -self.velocity[joint]
            command.effort.append(gains['p'] * error + self.integral[joint] + damping)
        self.commands.publish(command)


def main() -> None:
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(StandIn(sys.argv[1]))


if __name__ == '__main__':
    main()
