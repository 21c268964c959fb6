# SPDX-License-Identifier: Apache-2.0
"""
Measured, simulated and residual as one recording that ROS tools open, with a picture.

A rosbag2 folder with one MCAP file. For each trace three topics of the standard type
`std_msgs/msg/Float64`,

    /measured/AXIS/SIGNAL    /simulated/AXIS/SIGNAL    /residual/AXIS/SIGNAL

with a message at each time of the trace: the same stamps in all three. Attached is `overlay.json`:
unit, block and RMS of each, and the stamp of time zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np

from waferbot_lockstep.standard_messages import FLOAT64
from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND
from waferbot_lockstep.wire import LITTLE_ENDIAN
from waferbot_twin.comparison.traces import Trace
from waferbot_twin.html_page import save_drawing, set_title
from waferbot_twin.plot import scaled_unit
from waferbot_twin.recording.writer import RecordingWriter, Table, as_json
from waferbot_twin.thinning import thinned_with_gaps

ATTACHMENT = 'overlay.json'
PICTURE = 'overlay.png'
SIDES = ('measured', 'simulated', 'residual')

MOST_DRAWN = 8000
"""Samples of a line; of a longer one the least and the greatest of each stretch."""

_MESSAGE = np.dtype([('encapsulation', 'V4'), ('data', '<f8')])
_COLOURS = {'measured': '#999999', 'simulated': '#1f5fa8', 'residual': '#b5401f'}
_WIDTHS = {'measured': 2.4, 'simulated': 0.9, 'residual': 0.9}


def write_overlay(
    traces: Sequence[Trace], about: Mapping[str, Any], path: Path, force: bool = False
) -> None:
    """
    Write traces to a new folder; raises `UserError` if it is there, unless `force`.

    `about` says what was compared. Stamps are the traces' times, all later by whole seconds where the
    first would be negative. Of several traces of one name the topics end in the block.
    """
    first_s = min(float(trace.time_s[0]) for trace in traces)
    zero_ns = max(0, -int(np.floor(first_s))) * NANOSECONDS_PER_SECOND
    names = _names(traces)
    attached = {
        **about,
        'stamp_of_time_zero_ns': zero_ns,
        'signals': [
            {'topic': name, **trace.as_dict()} for name, trace in zip(names, traces, strict=True)
        ],
    }
    with RecordingWriter(path, {ATTACHMENT: as_json(attached)}, force) as writer:
        tables = []
        for name, trace in zip(names, traces, strict=True):
            stamps_ns = np.round(trace.time_s * 1e9).astype(np.int64) + zero_ns
            for side in SIDES:
                writer.add_topic(f'/{side}/{name}', FLOAT64)
                records = np.zeros(len(stamps_ns), _MESSAGE)
                records['encapsulation'] = np.void(LITTLE_ENDIAN)
                records['data'] = getattr(trace, side)
                tables.append(Table.of(f'/{side}/{name}', stamps_ns, records))
        # In the order of time, as players want it; at equal times in the order of the topics.
        writer.write_tables(tables)
        _draw(traces, names, path.name, writer.folder / PICTURE)
        writer.close({'complete': 'true', 'samples': str(writer.message_count)})


def _names(traces: Sequence[Trace]) -> list[str]:
    """Return the ends of the topics, each for one trace."""
    plain = [trace.name for trace in traces]
    return [
        name if plain.count(name) == 1 else f'{name}_{trace.block}'.replace(' ', '_')
        for name, trace in zip(plain, traces, strict=True)
    ]


def _draw(traces: Sequence[Trace], names: Sequence[str], title: str, file: Path) -> None:
    """Draw a row for each trace: measured under simulated, and the residual beside them."""
    figure, panels = plt.subplots(
        len(traces), 2, figsize=(13.0, 1.0 + 2.1 * len(traces)), squeeze=False, sharex=True
    )
    for row, (name, trace) in enumerate(zip(names, traces, strict=True)):
        factor, unit = scaled_unit(np.concatenate([trace.measured, trace.simulated]), trace.unit)
        left_factor, left_unit = scaled_unit(trace.residual, trace.unit)
        for side in SIDES:
            left = side == 'residual'
            time_s, values = thinned_with_gaps(trace.time_s, getattr(trace, side), MOST_DRAWN)
            values = values * (left_factor if left else factor)
            panels[row][int(left)].plot(
                time_s, values, color=_COLOURS[side], lw=_WIDTHS[side], label=side
            )
        block = f', {trace.block}' if trace.block else ''
        panels[row][0].set_title(f'{name}{block}', fontsize=9)
        panels[row][0].set_ylabel(f'[{unit}]')
        panels[row][0].legend(loc='upper right', fontsize=8)
        size = left_factor * trace.as_dict()['rms_residual']
        panels[row][1].set_title(f'residual, RMS {size:.4g} {left_unit}', fontsize=9)
        panels[row][1].set_ylabel(f'[{left_unit}]')
        for panel in panels[row]:
            panel.grid(alpha=0.3)
            panel.ticklabel_format(axis='y', useOffset=False)
    for panel in panels[-1]:
        panel.set_xlabel('time [s]')
    set_title(figure, title)
    save_drawing(figure, file)
