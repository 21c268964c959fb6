# SPDX-License-Identifier: Apache-2.0
"""
The end of a process that is a Python itself and has an FMU of ours loaded.

The loader of pythonfmu and pythonfmu3, a C++ library, keeps its hold on the interpreter in a static
`std::shared_ptr`. The importing tool cannot unload it (GCC's unique symbols keep it), so the process
ends with it: first the destructor of the pointer releases what it holds, then
`finalizePythonInterpreter`, called when the dynamic linker finishes the library, releases the same once
more. By then that memory is somebody else's: of processes that only had to end, 1 of 48 to 7 of 24
found their heap corrupt and aborted, and one never ended. Released before both, there is nothing left
for either.
"""

from __future__ import annotations

import atexit
import ctypes
import os
from pathlib import Path

RELEASE = 'finalizePythonInterpreter'


def release_at_exit(resources: Path) -> None:
    """Have the loader of the FMU with this folder of resources let go before its library is finished."""
    already_loaded = getattr(os, 'RTLD_NOLOAD', None)
    if already_loaded is None:  # on Windows; not tried there
        return
    for file in sorted((resources.parent / 'binaries').glob('*/*')):
        try:
            library = ctypes.CDLL(str(file), mode=already_loaded | os.RTLD_NOW)
        except OSError:  # of another system, or not the one that is loaded
            continue
        if hasattr(library, RELEASE):
            atexit.register(getattr(library, RELEASE))
