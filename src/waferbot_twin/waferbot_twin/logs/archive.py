# SPDX-License-Identifier: Apache-2.0
"""
Keeps a measured log as a recording: a rosbag2 folder with MCAP that ROS tools open.

One topic per signal, `/measured/AXIS/KIND`, of type `waferbot_msgs/msg/MeasuredSample`, at the
signal's own times. Attached: `measured.json` (units, resolutions, findings, where it came from) and
`mapping.yaml` if a mapping was used. Reading it back gives the same log to the last bit, as time and
value are in the messages as floating point; the stamps (whole nanoseconds) are for the tools.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND
from waferbot_lockstep.wire import LITTLE_ENDIAN
from waferbot_twin.checked_json import NUMBER, TEXT, WHOLE, checked_json
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.kinds import KINDS
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.recording.reader import Content
from waferbot_twin.recording.writer import RecordingWriter, Table, as_json

TYPE = 'waferbot_msgs/msg/MeasuredSample'
ATTACHMENT = 'measured.json'
SCHEMA = 1

_SCHEMA_GIVEN = {'type': 'object', 'required': ['schema']}
_ABOUT = {
    'type': 'object',
    'required': ['name', 'source', 'digest', 'origin_ns', 'signals', 'findings'],
    'properties': {
        **dict.fromkeys(('name', 'source', 'digest'), TEXT),
        'origin_ns': WHOLE,
        'signals': {
            'type': 'array',
            'items': {
                'type': 'object',
                'required': ['kind', 'axis', 'unit', 'resolution', 'samples'],
                'properties': {
                    'kind': {'enum': list(KINDS)},
                    'axis': TEXT,
                    'unit': TEXT,
                    'resolution': NUMBER,
                    'samples': WHOLE,
                },
            },
        },
        'findings': {
            'type': 'array',
            'items': {
                'type': 'object',
                'required': ['place', 'reason'],
                'properties': dict.fromkeys(('place', 'reason', 'action'), TEXT),
                'additionalProperties': False,
            },
        },
    },
}
"""What `measured.json` has to say, as a JSON schema."""

# CDR of MeasuredSample: header with an empty frame_id, padded to 8 bytes, then two float64.
_SAMPLE = np.dtype(
    {
        'names': ['encapsulation', 'sec', 'nanosec', 'frame_id_length', 'time', 'value'],
        'formats': ['V4', '<i4', '<u4', '<u4', '<f8', '<f8'],
        'offsets': [0, 4, 8, 12, 20, 28],
        'itemsize': 36,
    }
)


def topic_of(signal: Signal) -> str:
    """Return the topic of a signal."""
    return f'/measured/{signal.axis}/{signal.kind}'


def write_archive(log: MeasuredLog, path: Path, force: bool = False) -> None:
    """Write a log to a new folder; raises `UserError` if it is there, unless `force`."""
    shift_ns = _shift_ns(log)
    attachments = {ATTACHMENT: as_json(_about(log, shift_ns))}
    if log.mapping:
        attachments['mapping.yaml'] = log.mapping
    with RecordingWriter(path, attachments, force) as writer:
        tables = []
        for signal in log.signals:
            writer.add_topic(topic_of(signal), TYPE)
            stamps_ns = np.round(signal.time_s * 1e9).astype(np.int64) + shift_ns
            tables.append(Table.of(topic_of(signal), stamps_ns, _records(signal, stamps_ns)))
        # In the order of time, as players want it; at equal times in the order of the signals.
        writer.write_tables(tables)
        writer.close({'complete': 'true', 'samples': str(writer.message_count)})


def is_archive(content: Content) -> bool:
    """Tell whether what was read of a recording is a measured log."""
    return ATTACHMENT in content.attachments


def read_archive(path: Path, content: Content) -> MeasuredLog:
    """Return the log in what was read of a recording; raises `UserError` if it is damaged."""
    about = _parsed(path, content.attachments[ATTACHMENT])
    signals = []
    findings = [Finding(**finding) for finding in about['findings']]
    for entry in about['signals']:
        topic = f'/measured/{entry["axis"]}/{entry["kind"]}'
        data = b''.join(content.messages.get(topic, []))
        if len(data) % _SAMPLE.itemsize:
            raise UserError(f'{path}: topic {topic}: not written by waferbot import')
        samples = np.frombuffer(data, _SAMPLE)
        if len(samples) < entry['samples']:
            reason = f'cut off: {len(samples)} of {entry["samples"]} samples'
            findings.append(Finding(f'{path}, topic {topic}', reason))
        if len(samples) == 0:
            continue
        signals.append(
            Signal(
                entry['kind'],
                entry['axis'],
                entry['unit'],
                samples['time'].astype(np.float64),
                samples['value'].astype(np.float64),
                entry['resolution'],
                entry.get('hold', ''),
                entry.get('counting', ''),
                entry.get('half_step', 0.0),
            )
        )
    if not signals:
        raise UserError(f'{path}: no sample of the log is left in it; import it again')
    return MeasuredLog(
        about['name'],
        tuple(signals),
        tuple(findings),
        about['source'],
        about['digest'],
        content.attachments.get('mapping.yaml', ''),
        about['origin_ns'],
    )


def _about(log: MeasuredLog, shift_ns: int) -> dict[str, Any]:
    """Return what `measured.json` says."""
    return {
        'schema': SCHEMA,
        **{key: value for key, value in log.describe().items() if key != 'usable_axes'},
        'stamp_of_time_zero_ns': shift_ns,
    }


def _parsed(path: Path, text: str) -> dict[str, Any]:
    where = f'{path}: {ATTACHMENT}'
    schema = checked_json(text, _SCHEMA_GIVEN, where)['schema']
    if schema != SCHEMA:
        raise UserError(
            f'{where} has schema {schema}, this waferbot reads {SCHEMA}; import the log again'
        )
    about: dict[str, Any] = checked_json(text, _ABOUT, where)
    return about


def _shift_ns(log: MeasuredLog) -> int:
    """Return the stamp of time zero: the log's own, or later where stamps would be negative."""
    first_s = min((float(signal.time_s[0]) for signal in log.signals), default=0.0)
    first_ns = log.origin_ns + round(first_s * 1e9)
    if first_ns >= 0:
        return log.origin_ns
    seconds = -(first_ns // NANOSECONDS_PER_SECOND)
    return log.origin_ns + seconds * NANOSECONDS_PER_SECOND


def _records(signal: Signal, stamp_ns: np.ndarray) -> np.ndarray:
    records = np.zeros(len(stamp_ns), _SAMPLE)
    records['encapsulation'] = np.void(LITTLE_ENDIAN)
    records['sec'], records['nanosec'] = np.divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    records['frame_id_length'] = 1  # only the closing zero of an empty string
    records['time'], records['value'] = signal.time_s, signal.value
    return records
