# SPDX-License-Identifier: Apache-2.0
"""Signals while a process works, and while it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

ENDING = """
import ctypes, sys
from waferbot_lockstep.interrupt import Interrupt
interrupt = Interrupt()
# As the libraries of ROS do when Python has ended: they take their time. sleep() is given the exit code.
libc = ctypes.CDLL(None)
libc.on_exit(libc.sleep, None)
interrupt.ignore()
print('ending', flush=True)
sys.exit(1)
"""


@pytest.mark.skipif(sys.platform != 'linux', reason='on_exit is of the C library of Linux')
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_does_not_kill_a_process_that_is_ending(number):
    process = subprocess.Popen([sys.executable, '-c', ENDING], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == 'ending\n'
    time.sleep(0.5)  # Python has ended by then; where it has not, this cannot fail
    process.send_signal(number)
    assert process.wait(60) == 1
    process.stdout.close()
