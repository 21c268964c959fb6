# SPDX-License-Identifier: Apache-2.0
"""The option `--seed`, which several commands have."""

from __future__ import annotations

import argparse

from waferbot_lockstep.errors import UserError

LARGEST = 2**63 - 1


def add_seed(parser: argparse.ArgumentParser, purpose: str, default: int = 0) -> None:
    """Declare `--seed`; anything but a whole number from 0 on raises `UserError` when parsed."""
    parser.add_argument(
        '--seed', type=_seed, default=default, metavar='N', help=f'{purpose} (default {default})'
    )


def _seed(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= LARGEST:
        raise UserError(f'--seed is {text}; it must be a whole number from 0 to {LARGEST}')
    return value
