# SPDX-License-Identifier: Apache-2.0
"""
Records a twin that others have started, until it is interrupted or the twin stops.

    ros2 run waferbot_twin recorder DIR --model rigid --experiment step

A plant that was started with `start_paused` waits for it: as soon as every topic has been heard at tick
0 the recorder lets time go, so the recording has all of it. With the plant's `recorder_window` it never
falls too far behind.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_srvs.srv import SetBool

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.node import SIGN_OF_LIFE_PERIOD_S, make_executor
from waferbot_lockstep.node_settings import REALTIME
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_lockstep.ros_security import refusals_told
from waferbot_lockstep.transport import choose_transport
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.completeness import close_complete, reported
from waferbot_twin.recording.recorder import Recorder
from waferbot_twin.recording.writer import RecordingWriter
from waferbot_twin.validity import OUTSIDE, Validity

QUIET_S = 0.5
"""Wall time without anything new, after which no more is on its way."""

DRAIN_S = 5.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the recorder as a process; return its exit code (0: all of it is there)."""
    everything = list(sys.argv if arguments is None else arguments)
    options = _parser().parse_args(remove_ros_args(everything)[1:])
    choose_transport()
    try:
        print(record(options, everything))
    except UserError as error:
        print(f'recorder: error: {error}', file=sys.stderr)
        return 1
    return 0


def record(options: argparse.Namespace, arguments: Sequence[str]) -> str:
    """Record until the end; return `0 missing of N`, or raise `UserError` with what is not right."""
    without = [name.strip() for name in options.without.split(',') if name.strip()]
    plan = make_plan(options.model, options.experiment)
    with contextlib.ExitStack() as stack:
        interrupt = stack.enter_context(Interrupt())
        ensure_log_folder()
        with refusals_told():
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown)
        attachments = plan.attachments('recorder', without)
        writer = stack.enter_context(
            RecordingWriter(options.out, attachments, options.force, live=True)
        )
        lockstep = options.timekeeping != REALTIME
        validity = Validity(plan.model, plan.timing)
        with refusals_told():
            recorder = Recorder(
                writer,
                plan.timing,
                reported(without, plan.model.layout),
                clock_needed=lockstep and 'plant' not in without,
                validity=validity,
                layout=plan.model.layout,
            )
        stack.callback(recorder.destroy_node)
        executor = make_executor()
        executor.add_node(recorder)
        stack.callback(executor.shutdown, 0.0)
        stack.callback(executor.remove_node, recorder)
        with refusals_told():
            recorder.begin()
            release = recorder.create_client(SetBool, 'plant/pause')
        released = False
        while not (interrupt.raised or recorder.stop_reason or recorder.failure):
            recorder.exchange.serve(executor, SIGN_OF_LIFE_PERIOD_S)
            if recorder.begun and not released and release.service_is_ready():
                release.call_async(SetBool.Request(data=False))
                released = True
        _drain(recorder, executor)
        stopped = '' if recorder.interrupted else recorder.stop_reason
        reasons = (recorder.failures.reason(), recorder.failure, stopped)
        failure = '; '.join(reason for reason in reasons if reason)
        for line in validity.departures():
            print(f'{OUTSIDE}: {line}')
        return close_complete(
            writer, recorder.account, recorder.account.reached(), failure, validity.told()
        )


def _drain(recorder: Recorder, executor: object) -> None:
    """Take what is still on its way."""
    end_s = time.monotonic() + DRAIN_S
    reached, since_s = -1, time.monotonic()
    while time.monotonic() < min(end_s, since_s + QUIET_S):
        recorder.exchange.serve(executor, QUIET_S / 4)
        if recorder.account.reached() != reached:
            reached, since_s = recorder.account.reached(), time.monotonic()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='recorder', description=(__doc__ or '').splitlines()[1])
    parser.add_argument('out', type=Path, metavar='DIR', help='record to this new folder')
    parser.add_argument('--force', action='store_true', help='replace the recording there')
    parser.add_argument('--model', default='rigid', help='what the nodes were started with')
    parser.add_argument('--experiment', default='constant', help='the one that begins at tick 0')
    parser.add_argument('--without', default='', help='nodes that somebody else provides: A,B')
    parser.add_argument('--timekeeping', default='lockstep', choices=('lockstep', REALTIME))
    return parser


if __name__ == '__main__':
    sys.exit(main())
