# SPDX-License-Identifier: Apache-2.0
"""
Entry point: picks the command, turns the user's errors into one line and an exit code.

Only the command that was asked for is imported: the compiler alone takes a second, and `--help`, or a
command that simulates nothing, should not wait for it.
"""

from __future__ import annotations

import argparse
import ast
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.resources import files

from waferbot_lockstep.errors import UserError

COMMANDS = {
    'run': 'run',
    'replay': 'replay',
    'info': 'info',
    'plot': 'plot',
    'metrics': 'metrics',
    'compare': 'compare',
    'import': 'import_log',
    'calibrate': 'calibrate',
    'tables': 'tables',
    'synthesize': 'synthesize',
    'diagnose': 'diagnose',
    'identify': 'identify',
    'frf': 'frf',
    'suggest': 'suggest',
    'modes': 'modes',
    'verify': 'verify',
    'demo': 'demo',
}
"""The commands and their modules."""

EXIT_OK, EXIT_ERROR, EXIT_INTERRUPTED = 0, 1, 130


def build_parser(chosen: str = '') -> argparse.ArgumentParser:
    """Return the parser of the command line: of all commands the names, of the chosen one everything."""
    parser = argparse.ArgumentParser(
        prog='waferbot',
        description='Digital twin of a three-axis wafer-handling robot: run it, record it, replay it.',
        epilog='Each command has its own --help.',
    )
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, module_name in COMMANDS.items():
        purpose = _docstring(module_name)
        summary = purpose.strip().splitlines()[0]
        command = commands.add_parser(name, help=summary, description=purpose)
        command.formatter_class = argparse.RawDescriptionHelpFormatter
        if name == chosen:
            module = import_module(f'waferbot_twin.cli.{module_name}')
            module.add_arguments(command)
            command.set_defaults(execute=module.execute)
    return parser


def _docstring(module_name: str) -> str:
    """Return the docstring of a command's module without importing it."""
    source = files('waferbot_twin.cli').joinpath(f'{module_name}.py').read_text('utf-8')
    return ast.get_docstring(ast.parse(source), clean=False) or ''


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 on success, 1 on an error (told in one line), 130 on Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    chosen = next((argument for argument in arguments if not argument.startswith('-')), '')
    options = build_parser(chosen).parse_args(arguments)
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
