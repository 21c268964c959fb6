# SPDX-License-Identifier: Apache-2.0
"""Chromium without a window, driven over its debugging pipe: open a page, ask it, click, look."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
PATIENCE_S = 60.0


def chromium() -> str | None:
    """Return the path of a Chromium, or None if there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """
    A Chromium with one page; `events` are what it told unasked, newest last.

    The network is closed but for 127.0.0.1: other names are not looked up.
    """

    def __init__(self, program: str, folder: Path, width: int = 1400, height: int = 860) -> None:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        command = [
            program, '--headless=new', '--no-sandbox', '--disable-gpu', '--use-angle=swiftshader',
            '--enable-unsafe-swiftshader', '--no-first-run', '--disable-extensions',
            '--disable-background-networking', '--disable-component-update', '--hide-scrollbars',
            f'--user-data-dir={folder}', f'--window-size={width},{height}',
            '--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1',
            '--remote-debugging-pipe',
        ]  # fmt: skip

        # Chromium reads from descriptor 3 and writes to 4.
        script = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self.process = subprocess.Popen(
            ['bash', '-c', script, 'chromium', *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(theirs_in, theirs_out),
            start_new_session=True,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._in, self._out = ours_in, ours_out
        self._buffer = b''
        self._last = 0
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []
        target = self.ask('Target.createTarget', url='about:blank')['targetId']
        self._session = self.ask('Target.attachToTarget', targetId=target, flatten=True)[
            'sessionId'
        ]
        for domain in ('Page', 'Runtime', 'Network', 'Log'):
            self.ask(f'{domain}.enable')
        self.ask('Emulation.setDeviceMetricsOverride', width=width, height=height,
                 deviceScaleFactor=1, mobile=False)  # fmt: skip

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._last += 1
        message: dict[str, Any] = {'id': self._last, 'method': method, 'params': parameters}
        if self._session:
            message['sessionId'] = self._session
        os.write(self._out, json.dumps(message).encode() + b'\0')
        deadline = time.monotonic() + PATIENCE_S
        while True:
            answer = self._receive(deadline)
            if answer.get('id') == self._last:
                assert 'error' not in answer, f'{method}: {answer["error"]}'
                result: dict[str, Any] = answer['result']
                return result
            self.events.append(answer)

    def _receive(self, deadline: float) -> dict[str, Any]:
        while b'\0' not in self._buffer:
            left = max(deadline - time.monotonic(), 0.0)
            assert select.select([self._in], [], [], left)[0], 'the browser does not answer'
            data = os.read(self._in, 1 << 20)
            assert data, f'the browser ended (exit code {self.process.poll()})'
            self._buffer += data
        text, _, self._buffer = self._buffer.partition(b'\0')
        message: dict[str, Any] = json.loads(text)
        return message

    def open(self, url: str) -> None:
        """Open a page, without waiting for it."""
        self.ask('Page.navigate', url=url)

    def value(self, expression: str) -> Any:
        """Return what an expression in the page comes to, awaited if it is a promise."""
        answer = self.ask(
            'Runtime.evaluate', expression=expression, returnByValue=True, awaitPromise=True
        )
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    def wait_for(self, expression: str) -> None:
        """Wait until an expression in the page is true."""
        deadline = time.monotonic() + PATIENCE_S
        while not self.value(expression):
            assert time.monotonic() < deadline, f'never: {expression}; {self.troubles()}'
            time.sleep(0.05)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Move (`mouseMoved`), press or release (`mousePressed`, `mouseReleased`) the mouse."""
        self.ask('Input.dispatchMouseEvent', type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float, to_x: float | None = None) -> None:
        """Click at a place of the page, or drag from there to `to_x`."""
        end = x if to_x is None else to_x
        left = {'button': 'left', 'buttons': 1, 'clickCount': 1}
        self.mouse('mouseMoved', x, y)
        self.mouse('mousePressed', x, y, **left)
        if to_x is not None:
            self.mouse('mouseMoved', 0.5 * (x + end), y, button='left', buttons=1)
            self.mouse('mouseMoved', end, y, button='left', buttons=1)
        self.mouse('mouseReleased', end, y, **left)

    def place_of(self, selector: str) -> tuple[float, float, float, float]:
        """Return left, top, width and height of an element in the page."""
        left, top, width, height = self.value(
            f'(r => [r.left, r.top, r.width, r.height])'
            f'(document.querySelector({json.dumps(selector)}).getBoundingClientRect())'
        )
        return left, top, width, height

    def press(self, selector: str) -> None:
        """Click in the middle of an element."""
        left, top, width, height = self.place_of(selector)
        self.click(left + 0.5 * width, top + 0.5 * height)

    def picture(self) -> bytes:
        """Return what the page looks like, as PNG."""
        return base64.b64decode(self.ask('Page.captureScreenshot', format='png')['data'])

    def requests(self) -> list[str]:
        """Return the addresses that the page has asked for."""
        return [
            event['params']['request']['url']
            for event in self.events
            if event.get('method') == 'Network.requestWillBeSent'
        ]

    def troubles(self) -> list[str]:
        """Return the errors that the page threw or wrote to its console."""
        found = []
        for event in self.events:
            method, told = event.get('method'), event.get('params', {})
            if method == 'Runtime.exceptionThrown':
                found.append(str(told['exceptionDetails']))
            elif method == 'Runtime.consoleAPICalled':
                if told['type'] in ('error', 'warning', 'assert'):
                    found.append(str(told['args']))
            elif method == 'Log.entryAdded' and told['entry']['level'] == 'error':
                found.append(str(told['entry']))
        return found

    def end(self) -> None:
        """End the browser and all its processes."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self._in)
        os.close(self._out)
