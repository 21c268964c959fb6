# SPDX-License-Identifier: Apache-2.0
"""
Some nodes of the twin in one process, where they hand each other their messages directly.

    ros2 run waferbot_twin composed plant copley --ros-args --params-file FILE

The others, each in its own process, exchange messages with them by ROS topics, or by Unix sockets with
`--channel FOLDER` (and `-p channel:=FOLDER` for nodes by themselves).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rclpy.utilities import remove_ros_args

from waferbot_copley.node import CopleyNode
from waferbot_lockstep.channel import Channel
from waferbot_lockstep.exchange import Exchange
from waferbot_lockstep.node import LockstepNode, run_nodes
from waferbot_plant.node import PlantNode
from waferbot_pmac.node import PmacNode

NODES: dict[str, type[LockstepNode]] = {
    'plant': PlantNode,
    'pmac': PmacNode,
    'copley': CopleyNode,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process."""
    everything = list(sys.argv if arguments is None else arguments)
    options = _parser().parse_args(remove_ros_args(everything)[1:])

    def make_nodes() -> list[LockstepNode]:
        channel = None
        if options.channel is not None:
            channel = Channel(options.channel, '+'.join(options.nodes))
        exchange = Exchange(channel, [f'/{name}' for name in options.from_topic])
        return [NODES[name](exchange=exchange) for name in options.nodes]  # type: ignore[call-arg]

    return run_nodes(make_nodes, everything)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='composed', description=__doc__.splitlines()[1])
    parser.add_argument('nodes', nargs='+', choices=tuple(NODES), help='nodes of this process')
    parser.add_argument('--channel', type=Path, metavar='FOLDER', help='folder of Unix sockets')
    parser.add_argument(
        '--from-topic', action='append', default=[], metavar='NAME',
        help='with a channel, a topic that comes from a node that has none',
    )  # fmt: skip
    return parser


if __name__ == '__main__':
    sys.exit(main())
