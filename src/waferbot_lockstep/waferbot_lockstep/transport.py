# SPDX-License-Identifier: Apache-2.0
"""
The transport of nodes in real time: UDP only.

Between processes of one machine Fast DDS goes through shared memory first. Where a process is killed,
its port there stays behind. The others go on writing into it, for seconds each time that they look
whether somebody still reads; and they may write there for ever when the process is started again,
since its new port has the same name. So it is heard, and hears nothing. In lock-step a killed peer
ends the twin, and it does not matter; in real time the others go on and the killed one comes back. UDP
has nothing that stays behind.

With discovery on this machine only, rmw_fastrtps adds shared memory whatever the environment says, so
the same discovery is asked for by a file of Fast DDS settings instead.
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

    Discovery stays on this machine. With `timekeeping` set to `realtime` on the node's command line, it
    keeps to UDP, unless the user has Fast DDS settings of his own.
    """
    discovery = environment.setdefault(DISCOVERY, 'LOCALHOST')
    if PROFILES in environment or not asks_for_real_time(arguments):
        return
    if discovery == 'LOCALHOST':
        environment[DISCOVERY] = 'SYSTEM_DEFAULT'
        environment[PROFILES] = str(package_data('waferbot_lockstep', 'real_time_transport.xml'))
    else:
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
