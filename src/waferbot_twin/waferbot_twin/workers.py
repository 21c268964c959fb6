# SPDX-License-Identifier: Apache-2.0
"""
Worker processes end with the process that they work for, and leave nothing behind in shared memory.

joblib's workers wait for more work when their parent is gone: a diagnosis that is killed would leave
them running. Each looks for its parent instead, from its first task on; one that never got a task ends
by itself, after joblib's five minutes. When all of them are killed at once, what they shared
stays in `/dev/shm`; the next command removes it.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from waferbot_lockstep.errors import UserError

LOOK_S = 0.5
"""Between two looks for the parent; a compiled function that is being run comes to its end before."""

SHARED_MEMORY = Path('/dev/shm')

UNUSED_S = 600.0
"""For so long nobody may have written to what is taken for left behind."""

# joblib ends a worker that has grown, starts another one and says so: nothing is lost.
warnings.filterwarnings('ignore', 'A worker stopped while some jobs were given to the executor')


def number_of(workers: int | None) -> int:
    """Return a number of workers, all cores for None; raises `UserError` if it is below 1."""
    if workers is not None and workers < 1:
        raise UserError(f'workers is {workers}; it must be at least 1')
    return workers or os.cpu_count() or 1


def end_with_parent(end: Callable[[int], None] = os._exit) -> None:
    """In a worker of joblib, end the process when its parent has ended; do nothing elsewhere."""
    parent = multiprocessing.parent_process()
    if parent is None or not multiprocessing.current_process().name.startswith('LokyProcess'):
        return

    def watch() -> None:
        while os.getppid() == parent.pid:
            time.sleep(LOOK_S)
        end(1)

    threading.Thread(target=watch, name='parent', daemon=True).start()


def remove_shared_memory_of_the_dead(
    folder: Path = SHARED_MEMORY, unused_s: float = UNUSED_S
) -> None:
    """
    Remove what processes of this user left in shared memory when they, and all beside them, were killed.

    That is what joblib shared with its workers, `joblib_memmapping_folder_<process>_...`. What was
    touched within `unused_s` stays: a container may see our shared memory, and has process numbers of
    its own.
    """
    before_s = time.time() - unused_s
    for path in folder.glob('joblib_memmapping_folder_*'):
        number = path.name.split('_')[3]
        if _is_old(path, before_s) and number.isdigit() and not Path('/proc', number).exists():
            shutil.rmtree(path, ignore_errors=True)


def _is_old(path: Path, before_s: float) -> bool:
    """Tell whether a file or folder is ours and nobody wrote to it of late."""
    try:
        status = path.stat()
    except OSError:
        return False
    return status.st_uid == os.getuid() and status.st_mtime < before_s
