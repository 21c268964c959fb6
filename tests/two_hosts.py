# SPDX-License-Identifier: Apache-2.0
"""
Two network namespaces with a cable between them: a twin in one, an intruder in the other.

    unshare --map-root-user --net python two_hosts.py DOMAIN INTRUDER'S_OUTPUT TWIN'S_COMMAND ...

Ends with the exit code of the twin. Needs user namespaces, and `ip`, `unshare` and `nsenter`.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

TWIN, INTRUDER = '10.77.0.1', '10.77.0.2'


def ip(*arguments, inside=()):
    subprocess.run([*inside, 'ip', *arguments], check=True)


def output_of(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


domain, output, *command = sys.argv[1:]
other = subprocess.Popen(['unshare', '--net', 'sleep', '600'])
try:
    mine = os.readlink('/proc/self/ns/net')
    while os.readlink(f'/proc/{other.pid}/ns/net') == mine:
        time.sleep(0.01)
    there = ('nsenter', '--target', str(other.pid), '--net')
    ip('link', 'add', 'cable', 'type', 'veth', 'peer', 'name', 'cable', 'netns', str(other.pid))
    for address, inside in ((TWIN, ()), (INTRUDER, there)):
        ip('link', 'set', 'lo', 'up', inside=inside)
        ip('addr', 'add', f'{address}/24', 'dev', 'cable', inside=inside)
        ip('link', 'set', 'cable', 'up', inside=inside)
    for inside in ((), there):  # DDS looks once, at its start, for interfaces that are up
        while ' UP ' not in output_of(*inside, 'ip', '-brief', 'link', 'show', 'cable'):
            time.sleep(0.05)
    if command == ['--try']:
        sys.exit(0)
    environment = {
        **os.environ,
        'ROS_DOMAIN_ID': domain,
        'ROS_STATIC_PEERS': TWIN,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    }
    script = str(Path(__file__).parent / 'intruder.py')
    intruder = subprocess.Popen([*there, sys.executable, script, output], env=environment)
    try:
        while not Path(output).exists():
            time.sleep(0.05)
        code = subprocess.run(command).returncode
    finally:
        intruder.kill()
        intruder.wait()
finally:
    other.kill()
    other.wait()
sys.exit(code)
