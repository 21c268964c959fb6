# SPDX-License-Identifier: Apache-2.0
"""Services that are answered when something has come about, not at once."""

from __future__ import annotations

from typing import Any

from rclpy.task import Future

__all__ = ['Future', 'answer_later']


def answer_later(service: Any) -> None:
    """
    Let the callback of a service return a `Future` of its response.

    The events executor of rclpy (Jazzy) does not wait for callbacks that are coroutines. Every
    executor hands what the callback returns to `Service.send_response`, so that waits here.
    """
    send = service.send_response

    def send_when_done(answer: Any, header: Any) -> None:
        if isinstance(answer, Future):
            answer.add_done_callback(lambda done: send(done.result(), header))
        else:
            send(answer, header)

    service.send_response = send_when_done
