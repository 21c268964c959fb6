# SPDX-License-Identifier: Apache-2.0
"""
Entry point: picks the command, turns the user's errors into one line and an exit code.

Only the command that was asked for is imported: the compiler alone takes a second, and `--help`, or a
command that simulates nothing, should not wait for it.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from importlib import import_module
from types import FrameType
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.workers import remove_shared_memory_of_the_dead

COMMANDS = {
    'run': 'run',
    'replay': 'replay',
    'conform': 'conform',
    'info': 'info',
    'plot': 'plot',
    'view': 'view',
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
    'library': 'library',
    'commission': 'commission',
    'tune': 'tune',
    'sweep': 'sweep',
    'optimise': 'optimise',
    'size': 'size',
    'feedforward': 'feedforward',
    'export-fmu': 'export_fmu',
    'export-model': 'export_model',
    'import-urdf': 'import_urdf',
    'secure': 'secure',
    'modes': 'modes',
    'verify': 'verify',
    'demo': 'demo',
}
"""The commands and their modules."""

EXIT_OK, EXIT_ERROR, EXIT_INTERRUPTED = 0, 1, 130


class Parser(argparse.ArgumentParser):
    """Answers a misspelt option or choice with the nearest that there is."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the arguments; what is left over ends the program, as it does in every parser."""
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            name = unknown[0].partition('=')[0]
            parser = self._of_command(getattr(options, 'command', ''))
            known = parser._option_string_actions if name.startswith('--') else ()
            parser.error(f'unrecognized arguments: {" ".join(unknown)}{did_you_mean(name, known)}')
        return options

    def _of_command(self, command: str) -> argparse.ArgumentParser:
        for action in self._actions:
            if isinstance(action.choices, dict) and command in action.choices:
                parser: argparse.ArgumentParser = action.choices[command]
                return parser
        return self

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(value, map(str, action.choices or ()))
            raise


def build_parser(chosen: str = '') -> argparse.ArgumentParser:
    """Return the parser of the command line: of all commands the names, of the chosen one everything."""
    parser = Parser(
        prog='waferbot',
        description='Digital twin of a three-axis wafer-handling robot: run it, record it, replay it.',
        epilog='Each command has its own --help.',
    )
    parser.add_argument(
        '--version', action=_Version, help='tell the version, and from which commit it is'
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
            command.epilog = '\n  '.join(['examples:', *module.EXAMPLES])
            command.set_defaults(execute=module.execute)
    return parser


class _Version(argparse.Action):
    """Prints the version and ends; it is looked up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print it."""
        from waferbot_twin.version import version_text

        print(f'waferbot {version_text()}')
        parser.exit()


def _docstring(module_name: str) -> str:
    """Return the docstring of a command's module without importing it."""
    source = package_data('waferbot_twin', 'cli', f'{module_name}.py').read_text('utf-8')
    return ast.get_docstring(ast.parse(source), clean=False) or ''


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 on success, 1 on an error (told in one line), 130 on Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    chosen = next((argument for argument in arguments if not argument.startswith('-')), '')
    _print_any_name()
    try:
        parser = build_parser(chosen)
        if chosen and chosen not in COMMANDS:
            parser.error(f'there is no command {chosen!r}{did_you_mean(chosen, COMMANDS)}')
        options = parser.parse_args(arguments)
        remove_shared_memory_of_the_dead()
        with _ended_in_order():
            code = int(options.execute(options) or EXIT_OK)
            sys.stdout.flush()
            return code
    except UserError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        print('waferbot: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output (head, less) has had enough; that is no error.
        _drop_output()
        return EXIT_OK
    except OSError as error:
        return _fail(_in_words(error))
    except MemoryError:
        return _fail('there is not enough memory for this')


def _fail(text: str) -> int:
    """Tell an error in one line; return the exit code."""
    print(f'waferbot: error: {" ".join(text.split())}', file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:
        _drop_output()  # the disk is full; Python would try again at the end, and complain
    return EXIT_ERROR


def _in_words(error: OSError) -> str:
    """Return what the system says: the file, if it names one, and what is wrong with it."""
    reason = error.strerror or str(error) or type(error).__name__
    return reason if error.filename is None else f'{os.fsdecode(error.filename)}: {reason}'


def _drop_output() -> None:
    """Send what is still to be printed nowhere."""
    with contextlib.suppress(OSError, ValueError):  # ValueError: no file is behind it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_any_name() -> None:
    """Let every name be printed: a terminal may not know a letter, a file's name may be no text."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


@contextlib.contextmanager
def _ended_in_order() -> Iterator[None]:
    """
    Let SIGTERM, and SIGHUP of a closed terminal, end the command as Ctrl-C does.

    What it had moved away is put back then, and what it had begun is removed.
    """

    def end(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores SIGHUP, and so do we
                before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for caught, handler in before.items():
            signal.signal(caught, handler)
