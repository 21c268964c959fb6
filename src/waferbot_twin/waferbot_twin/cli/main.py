# SPDX-License-Identifier: Apache-2.0
"""Entry point: picks the command, turns the user's errors into one line and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from waferbot_lockstep.errors import UserError

# Imported first: it decides where compiled code is kept.
import waferbot_lockstep.compiled  # noqa: F401  isort: skip

from waferbot_twin.cli import (
    calibrate,
    compare,
    demo,
    diagnose,
    frf,
    identify,
    import_log,
    info,
    metrics,
    modes,
    plot,
    replay,
    run,
    suggest,
    synthesize,
    tables,
    verify,
)

COMMANDS = {
    'run': run,
    'replay': replay,
    'info': info,
    'plot': plot,
    'metrics': metrics,
    'compare': compare,
    'import': import_log,
    'calibrate': calibrate,
    'tables': tables,
    'synthesize': synthesize,
    'diagnose': diagnose,
    'identify': identify,
    'frf': frf,
    'suggest': suggest,
    'modes': modes,
    'verify': verify,
    'demo': demo,
}

EXIT_OK, EXIT_ERROR, EXIT_INTERRUPTED = 0, 1, 130


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog='waferbot',
        description='Digital twin of a three-axis wafer-handling robot: run it, record it, replay it.',
        epilog='Each command has its own --help.',
    )
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, module in COMMANDS.items():
        summary = (module.__doc__ or '').strip().splitlines()[0]
        command = commands.add_parser(name, help=summary, description=module.__doc__)
        command.formatter_class = argparse.RawDescriptionHelpFormatter
        module.add_arguments(command)
        command.set_defaults(execute=module.execute)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 on success, 1 on an error (told in one line), 130 on Ctrl-C."""
    options = build_parser().parse_args(arguments)
    try:
        return int(options.execute(options) or EXIT_OK)
    except UserError as error:
        print(f'waferbot: error: {error}', file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print('waferbot: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output (head, less) has had enough; that is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
