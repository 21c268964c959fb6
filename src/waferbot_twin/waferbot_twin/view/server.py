# SPDX-License-Identifier: Apache-2.0
"""
A web server for one recording and one computer.

It is bound to 127.0.0.1, answers only requests for that address, serves the files of the page and
two JSON texts, and tells the browser to load nothing from elsewhere. So it works without a network,
and a page of somebody else cannot read the recording through it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

from waferbot_lockstep.errors import UserError
from waferbot_twin.plain_values import finite
from waferbot_twin.view.content import ViewContent

ADDRESS = '127.0.0.1'
_TYPES = {'html': 'text/html', 'js': 'text/javascript', 'css': 'text/css'}
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data:"
)


class ViewServer(ThreadingHTTPServer):
    """Serves a recording at `url`; `port` 0 takes a free one. Raises `UserError` if it is taken."""

    daemon_threads = True

    def __init__(self, content: ViewContent, port: int = 0) -> None:
        """Bind to the port; the caller runs `serve_forever`."""
        self.content = content
        self.pages = _page_files()
        try:
            super().__init__((ADDRESS, port), _Handler)
        except OSError as error:
            raise UserError(
                f'port {port} of {ADDRESS} cannot be used ({error.strerror}); leave --port away '
                'for a free one'
            ) from error

    @property
    def url(self) -> str:
        """Address of the page."""
        return f'http://{ADDRESS}:{self.server_port}/'


def _page_files() -> dict[str, tuple[str, bytes]]:
    """Return type and content of every file that the page may ask for, by its path."""
    folder = files('waferbot_twin.view').joinpath('page')
    found = {}
    for place, part in (('/', folder), ('/vendor/', folder.joinpath('vendor'))):
        for file in part.iterdir():
            kind = _TYPES.get(file.name.rpartition('.')[2])
            if kind is not None:
                found[place + file.name] = (kind, file.read_bytes())
    found['/'] = found['/view.html']
    return found


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: ViewServer

    def do_GET(self) -> None:
        """Send a file of the page, or a part of the recording."""
        host, _, port = self.headers.get('Host', '').partition(':')
        if host not in (ADDRESS, 'localhost') or port != str(self.server.server_port):
            self.send_error(HTTPStatus.FORBIDDEN, f'open {self.server.url}')
            return
        request = urlsplit(self.path)
        if request.path == '/recording.json':
            self._send_json(self.server.content.recording())
        elif request.path == '/curves.json':
            self._send_curves(parse_qs(request.query))
        elif request.path in self.server.pages:
            self._send(*self.server.pages[request.path])
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _send_curves(self, query: Mapping[str, list[str]]) -> None:
        try:
            start_s, end_s = (float(query[key][0]) for key in ('from', 'to'))
        except (KeyError, ValueError):
            start_s = end_s = math.nan
        if not start_s < end_s:
            self.send_error(HTTPStatus.BAD_REQUEST, 'give from and to, in s')
            return
        self._send_json(self.server.content.curves(start_s, end_s))

    def _send_json(self, value: Any) -> None:
        self._send('application/json', json.dumps(finite(value)).encode())

    def _send(self, kind: str, data: bytes) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header('Content-Type', f'{kind}; charset=utf-8')
        self.send_header('Content-Length', str(len(data)))
        self.send_header('Content-Security-Policy', _POLICY)
        self.send_header('X-Content-Type-Options', 'nosniff')
        self.send_header('Cache-Control', 'no-store')
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of single requests."""
