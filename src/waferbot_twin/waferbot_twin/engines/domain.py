# SPDX-License-Identifier: Apache-2.0
"""
A ROS domain for each twin, so that two twins on one machine do not hear each other.

A twin takes the first domain that no other twin has and no ROS node of this machine is in: a node of
somebody else's stays for seconds after its twin has ended, and would speak to the next one of old ticks.
The claim is the name of a socket that no file belongs to (Linux: the abstract namespace of Unix
sockets). The system releases it when the process ends, however it ends; it counts for all users and, as
domains do, for one network namespace. A domain that the user names (option or ROS_DOMAIN_ID) is taken as
it is, with whoever is in it, but not twice.
"""

from __future__ import annotations

import errno
import os
import socket

from waferbot_lockstep.errors import UserError

FIRST_DOMAIN = 42
LAST_DOMAIN = 101
"""ROS 2 recommends domains up to 101 on Linux; 0 and the low ones are where people work by hand."""


HIGHEST_DOMAIN = 232
"""Above it the UDP ports of the domain would not be port numbers any more."""

PARTICIPANTS = 32
"""How many participants of a domain look for one another on a machine by unicast (docs/contract.md)."""


class Domain:
    """A claimed ROS domain; the claim holds until `release` or the end of the process."""

    def __init__(self, wanted: int | None = None) -> None:
        """Claim `wanted`, else the user's ROS_DOMAIN_ID, else a free domain; raises `UserError`."""
        if wanted is None and os.environ.get('ROS_DOMAIN_ID'):
            wanted = _number('ROS_DOMAIN_ID', os.environ['ROS_DOMAIN_ID'])
        elif wanted is not None:
            wanted = _number('--domain', wanted)
        candidates = range(FIRST_DOMAIN, LAST_DOMAIN + 1) if wanted is None else (wanted,)
        for number in candidates:
            claim = _claim(number)
            if claim is not None and wanted is None and _inhabited(number):
                claim.close()
            elif claim is not None:
                self.number = number
                self._claim = claim
                return
        if wanted is not None:
            raise UserError(
                f'ROS domain {wanted} is in use by another twin; choose another with --domain, or '
                'leave it out (and unset ROS_DOMAIN_ID) to get a free one'
            )
        raise UserError(
            f'every ROS domain from {FIRST_DOMAIN} to {LAST_DOMAIN} is in use by another twin or node'
        )

    def release(self) -> None:
        """Give the domain back."""
        self._claim.close()


def check_loopback() -> None:
    """Raise `UserError` if processes of this computer cannot send to one another by network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        try:
            one.bind(('127.0.0.1', 0))
            one.sendto(b'', one.getsockname())
        except OSError as error:
            raise UserError(
                'nodes over ROS find one another through the loopback interface, 127.0.0.1, which does '
                f'not work ({error.strerror}): ip link set lo up, or take --engine inprocess'
            ) from None


def _claim(number: int) -> socket.socket | None:
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f'\0waferbot-domain-{number}')
    except OSError as error:
        claim.close()
        if error.errno != errno.EADDRINUSE:
            raise
        return None
    return claim


def _inhabited(number: int) -> bool:
    """
    Tell whether any participant of this machine is in a domain.

    Participant k listens for others at UDP port 7400 + 250 number + 10 + 2 k (DDSI-RTPS 2.5, 9.6.2.3),
    whatever its vendor; a port that somebody has cannot be bound again.
    """
    for k in range(PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            try:
                one.bind(('', 7400 + 250 * number + 10 + 2 * k))
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    return True
    return False


def _number(source: str, text: str | int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = -1
    if not 0 <= number <= HIGHEST_DOMAIN:
        raise UserError(
            f'{source} is {text!r}; it must be a whole number from 0 to {HIGHEST_DOMAIN}'
        )
    return number
