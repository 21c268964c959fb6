# SPDX-License-Identifier: Apache-2.0
"""
Work in a process of its own, for readers of other people that crash on a damaged file.

SciPy's reader of MATLAB files is compiled code that trusts the file: a wrong type of array in it is a
segmentation fault, which no `except` can catch.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import pickle
import resource
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TypeVar, cast

Result = TypeVar('Result')


def isolated(work: Callable[[], Result]) -> Result:
    """
    Return what `work` returns, done in a forked child; what it returns must be picklable.

    Raises what `work` raised, or `ValueError` if the child crashed.
    """
    context = multiprocessing.get_context('fork')
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(work, there), daemon=True)
    child.start()
    there.close()
    try:
        answer: bytes | None = here.recv_bytes()
    except EOFError:
        answer = None
    finally:
        here.close()
        child.join()
    if answer is None:
        code = child.exitcode or 0
        reason = signal.Signals(-code).name if code < 0 else f'exit code {code}'
        raise ValueError(f'it is damaged: its reader crashed ({reason})')
    result, error = pickle.loads(answer)
    if error is not None:
        raise error
    return cast(Result, result)


def _work(work: Callable[[], object], answer: Connection) -> None:
    """In the child: do the work and send its result, or its error; a crash leaves no core file."""
    faulthandler.disable()
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        sent = pickle.dumps((work(), None), protocol=pickle.HIGHEST_PROTOCOL)
    except NotImplementedError as error:
        sent = pickle.dumps((None, NotImplementedError(str(error))))
    except Exception as error:
        sent = pickle.dumps((None, ValueError(str(error) or repr(error))))
    answer.send_bytes(sent)
    answer.close()
