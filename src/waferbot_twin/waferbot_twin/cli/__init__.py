# SPDX-License-Identifier: Apache-2.0
"""The `waferbot` command."""

from waferbot_twin.cli.main import main

__all__ = ['main']
