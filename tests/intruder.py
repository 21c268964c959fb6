# SPDX-License-Identifier: Apache-2.0
"""A stranger on another host who knows the address: says what it sees, and tries to stop the twin."""

import json
import sys
import time

import rclpy
from rclpy.node import Node

from waferbot_msgs.msg import Encoders, Stop

OUTPUT = sys.argv[1]

rclpy.init()
node = Node('intruder')
heard = []
node.create_subscription(Encoders, 'encoders', lambda message: heard.append(message.tick), 1024)
publisher = node.create_publisher(Stop, 'stop', 8)
seen = set()
while True:  # until it is killed
    rclpy.spin_once(node, timeout_sec=0.2)
    seen |= {name for name, _ in node.get_topic_names_and_types()}
    publisher.publish(Stop(tick=1, node='/pmac', reason='the intruder says so'))
    with open(f'{OUTPUT}.new', 'w', encoding='utf-8') as stream:
        json.dump({'topics': sorted(seen), 'heard': len(heard), 'time': time.time()}, stream)
    __import__('os').replace(f'{OUTPUT}.new', OUTPUT)
