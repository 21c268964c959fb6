# SPDX-License-Identifier: Apache-2.0
"""
The transport of nodes: whom their sockets are open to, and how soon what is lost is sent again.

ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, as rmw_fastrtps has it, keeps nodes from looking for others, but
binds their sockets to every address: whoever knows one, on another host or in another network
namespace, joins, reads all and stops the twin. So the same discovery is asked for by a file of Fast DDS
settings instead, with sockets of the loopback interface only.

Shared memory is left out. Between processes of one machine Fast DDS goes through it first. Where a
process is killed, its port there stays behind, and the next process of its domain has one of the same
name. In real time, where a killed node is started again, it was seen that others went on writing into
the old one: the new process is heard, and hears nothing. A start in lock-step that hung for a minute
looked the same; it was not seen again in 46 starts after kills. UDP has nothing that stays behind, and
`waferbot run` of 1 s over three processes took as long (wall time, means of three: 10.4 s with shared
memory, 10.2 s without).

A lost message is sent again when its writer asks the readers what they have (a heartbeat, RTPS 8.3.7.5)
and one of them lacks it. Fast DDS asks every 3 s; a twin in lock-step stands for as long. Here it is
every 0.1 s, and nothing is asked while all is acknowledged.
"""

from __future__ import annotations

import os
from collections.abc import MutableMapping

from waferbot_lockstep.package_data import package_data

DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
BUILTIN_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
"""Environment variables of ROS and, the last two, of Fast DDS; other middleware ignores those."""

HERE, NETWORK = 'this_machine.xml', 'network.xml'


def choose_transport(environment: MutableMapping[str, str] = os.environ) -> None:
    """
    Set, before ROS starts, whom a node talks to and how, as far as the user has not.

    Discovery and sockets stay on this machine, and all goes by UDP. Fast DDS settings of the user's own
    hold; then only discovery stays.
    """
    of_ours = {name: str(package_data('waferbot_lockstep', name)) for name in (HERE, NETWORK)}
    profiles = environment.get(PROFILES)
    if profiles is not None and profiles not in of_ours.values():
        environment.setdefault(DISCOVERY, 'LOCALHOST')
        return
    discovery = environment.setdefault(DISCOVERY, 'LOCALHOST')
    if discovery == 'LOCALHOST':
        environment[DISCOVERY] = 'SYSTEM_DEFAULT'
        environment[PROFILES] = of_ours[HERE]
    elif discovery != 'SYSTEM_DEFAULT' or profiles is None:  # else a parent of ours has chosen
        environment[PROFILES] = of_ours[NETWORK]
        environment.setdefault(BUILTIN_TRANSPORTS, 'UDPv4')
