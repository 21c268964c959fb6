# SPDX-License-Identifier: Apache-2.0
"""
Make a keystore of SROS2, with which only who has a key takes part in a twin.

It has an enclave for every node, with the permissions that the contract gives it, one for observers
and one for operators; keys and signatures are made by `ros2 security`. Needs a ROS 2 installation with
sros2, and its Fast DDS built with security, as the packages of ROS 2 are (the wheels of PyPI are not).
A keystore is for one domain and one namespace.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console, say

EXAMPLES = ('waferbot secure --out keystore --domain 7',)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot secure`."""
    parser.add_argument(
        '--out', type=Path, required=True, metavar='KEYSTORE', help='a new folder; keep it secret'
    )
    parser.add_argument(
        '--domain', type=int, metavar='N', help='ROS domain (default: ROS_DOMAIN_ID, or 0)'
    )
    parser.add_argument(
        '--namespace', default='/', metavar='NAME', help='of the twin (default: none)'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Make the keystore; print its enclaves and how nodes are started with it."""
    from waferbot_twin.engines.domain import HIGHEST_DOMAIN
    from waferbot_twin.security import ROLES, enclave_of, environment_of, make_keystore

    domain = options.domain
    if domain is None:
        given = os.environ.get('ROS_DOMAIN_ID') or '0'
        if not given.isdecimal():
            raise UserError(f'ROS_DOMAIN_ID is {given!r}; it must be a number')
        domain = int(given)
    if not 0 <= domain <= HIGHEST_DOMAIN:
        raise UserError(f'the ROS domain is {domain}; it must be 0 to {HIGHEST_DOMAIN}')
    namespace = f'/{options.namespace.strip("/")}'
    if not re.fullmatch(r'/|(/[A-Za-z_][A-Za-z0-9_]*)+', namespace):
        raise UserError(f'--namespace {options.namespace} is no name of a ROS namespace')
    make_keystore(options.out, domain, namespace)
    enclaves = {enclave_of(name): role.what for name, role in ROLES.items()}
    if options.json:
        print_json({'domain': domain, 'namespace': namespace, 'enclaves': enclaves})
        return 0
    table = new_table('enclave', 'for', text=('for',))
    for name, what in enclaves.items():
        table.add_row(name, what)
    result_console.print(table)
    say(f'wrote {options.out}, for ROS domain {domain}')
    say(f'the twin: ros2 launch waferbot_twin twin.launch.py secure:={options.out}')
    say('a node of yours, in the place of the PMAC:')
    for name, value in environment_of(options.out, domain).items():
        say(f'  export {name}={value}')
    say(f'  ros2 run ... --ros-args --enclave {enclave_of("pmac")}')
    return 0
