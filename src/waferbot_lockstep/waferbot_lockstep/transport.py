# SPDX-License-Identifier: Apache-2.0
"""
The transport of nodes: whom their sockets are open to.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, as rmw_fastrtps has it, keeps nodes from looking for others, but
binds their sockets to every address: whoever knows one, on another host or in another network
namespace, joins, reads all and stops the twin. So the same discovery is asked for by a file of Fast DDS
settings instead, with sockets of the loopback interface only.

In real time shared memory is left out as well. Between processes of one machine Fast DDS goes through
it first. Where a process is killed, its port there stays behind. The others go on writing into it, for
seconds each time that they look whether somebody still reads; and they may write there for ever when
the process is started again, since its new port has the same name. So it is heard, and hears nothing. In
lock-step a killed peer ends the twin, and it does not matter; in real time the others go on and the
killed one comes back. UDP has nothing that stays behind.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import MutableMapping, Sequence
from pathlib import Path

from waferbot_lockstep.package_data import package_data

DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
BUILTIN_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
"""Environment variables of ROS and, the last two, of Fast DDS; other middleware ignores those."""

_IN_FILE = re.compile(r'\btimekeeping["\']?\s*:\s*["\']?realtime\b')


def choose_transport(
    arguments: Sequence[str], environment: MutableMapping[str, str] = os.environ
) -> None:
    """
    Set, before ROS starts, whom a node talks to and how, as far as the user has not.

    Discovery and sockets stay on this machine. With `timekeeping` set to `realtime` on the node's
    command line, it keeps to UDP. Fast DDS settings of the user's own hold; then only discovery stays.
    """
    discovery = environment.setdefault(DISCOVERY, 'LOCALHOST')
    if PROFILES in environment:
        return
    real_time = asks_for_real_time(arguments)
    if discovery == 'LOCALHOST':
        environment[DISCOVERY] = 'SYSTEM_DEFAULT'
        file = 'real_time_transport.xml' if real_time else 'closed_transport.xml'
        environment[PROFILES] = str(package_data('waferbot_lockstep', file))
    elif real_time:
        environment.setdefault(BUILTIN_TRANSPORTS, 'UDPv4')


def asks_for_real_time(arguments: Sequence[str]) -> bool:
    """
    Tell whether the last value that a node's arguments give for `timekeeping` is `realtime`.

    Needed before the node, and with it its transport, is there, so ROS cannot be asked.
    """
    answer = False
    for option, value in itertools.pairwise(arguments):
        if option in ('-p', '--param') and value.startswith('timekeeping:='):
            answer = value.removeprefix('timekeeping:=').strip('"\'') == 'realtime'
        elif option == '--params-file' and Path(value).is_file():
            answer = answer or bool(_IN_FILE.search(Path(value).read_text('utf-8', 'replace')))
    return answer
