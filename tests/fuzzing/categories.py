# SPDX-License-Identifier: Apache-2.0
"""
What comes from outside, by kind: files that are whole, how they are damaged, and what reads them.

Whatever is fed to it, the tool may use it or refuse it with an error for the user. Any other exception
would be a traceback on the user's screen.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import shutil
import sqlite3
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from unittest import mock

import numpy as np
import scipy.io
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fuzzing.mutations import damaged, exchanged, misspelt
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.plant import config_folder, load_machine
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_pmac.settings import load_settings
from waferbot_twin.cli.compare import compare
from waferbot_twin.cli.info import describe
from waferbot_twin.cli.main import main
from waferbot_twin.cli.replay import recorded_plan
from waferbot_twin.diagnosis.report_schema import SCHEMA
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.channels import parse_channel
from waferbot_twin.identification.named_parameters import parse_all
from waferbot_twin.logs.archive import read_archive, write_archive
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import load_mapping
from waferbot_twin.models import load_model, load_model_or_machine, models_folder, recorded_model
from waferbot_twin.output_folder import MARKER, OutputFolder, foreign
from waferbot_twin.recording.reader import (
    Content,
    Recording,
    read_content,
    read_recording,
    recording_file,
)
from waferbot_twin.recording.writer import RecordingWriter
from waferbot_twin.response_reader import load_responses
from waferbot_twin.suggestion.rivals import named, of_report, read_report

FEW = 40
"""Messages of each topic in a recording whose attachments are damaged."""

Feed = Callable[[bytes, Path], None]
"""Puts content into a folder and lets the tool read it."""


@dataclass(frozen=True)
class Category:
    """One kind of input: contents that are in order, what damages them, what reads them."""

    name: str
    whole: Callable[[Path], list[bytes]]
    damage: Callable[[bytes, Random], bytes]
    feed: Feed


def tracebacks(category: Category, count: int, seed: int, folder: Path) -> Iterator[str]:
    """
    Feed `count` damaged inputs; yield what each traceback says, with the number of the case.

    The contents in order are fed first: they must be taken, else nothing is tried. `folder` is empty.
    """
    whole = category.whole(folder)
    for content in whole:
        _quietly(category.feed, content, folder)
    for case in range(count):
        random = Random(f'{category.name} {seed} {case}')
        content = category.damage(random.choice(whole), random)
        try:
            _quietly(category.feed, content, folder)
        except (UserError, OSError):
            continue
        except Exception:
            last = traceback.format_exc().strip().splitlines()
            yield f'case {case}: {last[-1][:300]}\n' + '\n'.join(last[-7:-1])


def _quietly(feed: Feed, content: bytes, folder: Path) -> None:
    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        warnings.catch_warnings(),
        mock.patch('os.fsync'),  # what is written is soon removed
        np.errstate(all='ignore'),
    ):
        warnings.simplefilter('ignore')
        feed(content, folder)


def _put(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


# ---- models, machines, experiments, settings -----------------------------------------------------

MODEL = b"""
/**/plant:
  ros__parameters: {description: single_mass, damping: improved}
/**/pmac:
  ros__parameters:
    y_linear: {Ixx30: 2000, Ixx31: 1600, Ixx69: 20480}
    x_rotate: {Ixx33: 10, Ixx34: 1}
/**/copley:
  ros__parameters:
    y_linear: {bus_voltage: 48.0}
"""


def _models(folder: Path) -> list[bytes]:
    return [MODEL, *(path.read_bytes() for path in sorted(models_folder().glob('*.yaml')))]


def _feed_model(content: bytes, folder: Path) -> None:
    model = load_model(str(_put(folder, 'model.yaml', content)))
    servo_parameters(model.of_axes('pmac'), 'model')
    amplifier_parameters(model.of_axes('copley'), None, 'model')
    plant = model.parameters['plant']
    if plant.get('description') not in ('rigid', 'flexible', 'simplified', 'as_built'):
        load_machine(model.description, damping=plant.get('damping', 'improved'))
    assert model.text


def _machines(folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in sorted((config_folder() / 'examples').glob('*.yaml'))]


def _feed_machine(content: bytes, folder: Path) -> None:
    machine = load_machine(_put(folder, 'machine.yaml', content))
    machine.parameters()
    load_model_or_machine(str(folder / 'machine.yaml'))


def _experiments(folder: Path) -> list[bytes]:
    names = ('step', 'random_x_rotate', 'multisine_y_linear', 'swept_sine_y_linear',
             'slow_velocity_x_rotate', 'full_stroke_y_linear', 'wafer_exchange')  # fmt: skip
    return [load_experiment(name).text.encode() for name in names]


@functools.cache
def _servo() -> np.ndarray:
    return servo_parameters(load_model('rigid').of_axes('pmac'), 'rigid')


def _feed_experiment(content: bytes, folder: Path) -> None:
    experiment = load_experiment(str(_put(folder, 'experiment.yaml', content)))
    commanded_positions(experiment, _servo(), 2250.0)


LISTING = b"""; motor 1
I130=6400 I131=$640
I133..135=0
I130,3,100=2000
I134=*
I103=$3501 // an address
"""
SETTINGS = b"""/**/pmac:
  ros__parameters:
    y_linear: {Ixx30: 6400, Ixx31: 1600}
"""


def _feed_settings(content: bytes, folder: Path) -> None:
    for name in ('settings.txt', 'settings.yaml'):
        with contextlib.suppress(UserError):
            load_settings(_put(folder, name, content))


# ---- logs ----------------------------------------------------------------------------------------

ROWS = 40
MAPPING = b"""
name: log
machine: single_mass
time: {column: time, unit: s}
signals:
  - {column: angle, axis: x_rotate, kind: position, unit: rad, scale: 1.0, sign: 1}
  - {column: current, axis: x_rotate, kind: current, unit: A, offset: 0.0, delay_s: 0.001}
options: {start_s: 0.0, end_s: 100.0}
"""
GATHER = b"""
time: {I10: 3713991, sample_time_s: 0.001}
gather: {sources: [$80008B, $4000BF], Ixx08: 96}
signals:
  - {column: $80008B, axis: x_rotate, kind: position, unit: rad}
  - {column: $4000BF, axis: x_rotate, kind: drive_command, unit: DAC_bits}
"""
ARRAYS = b"""
time: {sample_time_s: 0.001}
signals:
  - {column: %s, axis: x_rotate, kind: position, unit: rad}
  - {column: %s, axis: x_rotate, kind: current, unit: A}
"""


def _csv(start_s: float = 0.0) -> bytes:
    rows = (f'{start_s + k / 1000:.6f},{k * 1e-4:g},{k % 7}' for k in range(ROWS))
    return ('# a logger\ntime,angle,current\n' + '\n'.join(rows) + '\n').encode()


def _load(path: Path, mapping: bytes | None = None) -> None:
    """Load a log, and tell of it as every command does."""
    file = None if mapping is None else str(_put(path.parent, 'mapping.yaml', mapping))
    log = load_log(path, file)
    json.dumps(log.describe())
    write_archive(log, path.parent / 'out', force=True)
    shutil.rmtree(path.parent / 'out')


def _csvs(folder: Path) -> list[bytes]:
    quoted = _csv().replace(b'angle', b'"angle"').replace(b',3\n', b',"3"\n')
    return [_csv(), _csv(1.7e9), quoted, _csv().replace(b',', b';'), _csv().replace(b',', b'\t')]


def _damaged_csv(content: bytes, random: Random) -> bytes:
    if random.random() < 0.05:  # a cell of 200 kB, quoted or not
        quote = random.choice((b'', b'"'))
        at = random.randrange(len(content))
        return content[:at] + quote + b'x' * 200_000 + quote + content[at:]
    return misspelt(content, random)


def _feed_csv(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'log.csv', content), MAPPING)


def _samples() -> list[dict[str, object]]:
    return [{'time': k / 1000, 'axis': {'angle': k * 1e-4, 'i': [0, k % 7]}} for k in range(ROWS)]


def _json_list(folder: Path) -> list[bytes]:
    return [json.dumps(_samples(), indent=1).encode()]


def _json_lines(folder: Path) -> list[bytes]:
    return ['\n'.join(map(json.dumps, _samples())).encode(), *_json_list(folder)]


def _feed_json(content: bytes, folder: Path) -> None:
    mapping = MAPPING.replace(b'column: angle', b'column: axis.angle')
    mapping = mapping.replace(b'column: current', b"column: 'axis.i[1]'")
    _load(_put(folder, 'log.json', content), mapping)


def _lists(folder: Path) -> list[bytes]:
    rows = (
        f'({k / 1000:.6f});can0;{name};{value:g}'
        for k in range(ROWS)
        for name, value in (('angle', k * 1e-4), ('current', k % 7))
    )
    return [('time;bus;what;value\n' + '\n'.join(rows) + '\n').encode()]


def _feed_list(content: bytes, folder: Path) -> None:
    mapping = MAPPING
    for name in (b'angle', b'current'):
        chosen = b'column: value, where: {column: what, is: %s}' % name
        mapping = mapping.replace(b'column: %s' % name, chosen)
    _load(_put(folder, 'log.csv', content), mapping)


def _scopes(folder: Path) -> list[bytes]:
    rows = (f'angle {k * 1e-4:+.14f} current {k % 7:+.14f} ' for k in range(ROWS))
    return [('Sampling period is 1000000 ns \n\n' + '\n'.join(rows) + '\n').encode()]


def _feed_scope(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'log.txt', content), MAPPING.replace(b'time: {column: time, unit: s}', b''))


def _parquets(folder: Path) -> list[bytes]:
    import pyarrow
    import pyarrow.parquet as file_format

    angle, current = _signals().T
    columns = {'time': np.arange(ROWS) / 1000, 'angle': angle, 'current': current}
    file_format.write_table(pyarrow.table(columns), folder / 'whole.parquet')
    return [(folder / 'whole.parquet').read_bytes()]


def _feed_parquet(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'log.parquet', content), MAPPING)


def _feed_mapping(content: bytes, folder: Path) -> None:
    _put(folder, 'log.csv', _csv())
    _load(folder / 'log.csv', content)


def _gathers(folder: Path) -> list[bytes]:
    return [b''.join(b'%012X\n' % (k * 3072 << 4) for k in range(ROWS))]


def _feed_gather(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'gather.txt', content), GATHER)


def _signals() -> np.ndarray:
    return np.column_stack([np.arange(ROWS) * 1e-4, np.arange(ROWS) % 7.0])


def _saved(save: Callable[[io.BytesIO], object]) -> bytes:
    buffer = io.BytesIO()
    save(buffer)
    return buffer.getvalue()


def _npys(folder: Path) -> list[bytes]:
    both = _signals()
    structured = np.zeros(ROWS, [('angle', 'f8'), ('current', 'f4')])
    structured['angle'], structured['current'] = both.T
    arrays = (both, both.T.copy(), structured)
    return [_saved(functools.partial(np.save, arr=array)) for array in arrays]


def _feed_npy(content: bytes, folder: Path) -> None:
    path = _put(folder, 'log.npy', content)
    for columns in ((b'1', b'2'), (b'angle', b'current')):
        try:
            _load(path, ARRAYS % columns)
        except UserError:
            if columns[0] == b'angle':
                raise
        else:
            return


def _variables(folder: Path) -> dict[str, np.ndarray]:
    both = _signals()
    return {'data': both, 'angle': both[:, 0], 'current': both[:, 1]}


def _npzs(folder: Path) -> list[bytes]:
    kept = _variables(folder)
    return [
        _saved(lambda file: np.savez(file, **kept)),
        _saved(lambda file: np.savez_compressed(file, **kept)),
    ]


def _mats(folder: Path) -> list[bytes]:
    kept = {**_variables(folder), 'log': {'angle': _signals()[:, 0]}}
    return [
        _saved(lambda file: scipy.io.savemat(file, kept)),
        _saved(lambda file: scipy.io.savemat(file, kept, do_compression=True)),
        _saved(lambda file: scipy.io.savemat(file, _variables(folder), format='4')),
    ]


def _feed_npz(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'log.npz', content), ARRAYS % (b'"data(:,1)"', b'current'))


def _feed_mat(content: bytes, folder: Path) -> None:
    _load(_put(folder, 'log.mat', content), ARRAYS % (b'"data(:,1)"', b'current'))


# ---- recordings ----------------------------------------------------------------------------------


def _run(folder: Path) -> Path:
    """Return a recording of a run of 180 ticks."""
    path = folder.parent / f'{folder.name}_run'
    if not path.exists():
        command = ['run', '--engine', 'inprocess', '--duration', '0.01', '--out', str(path)]
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(command) == 0
    return path


def _archive(folder: Path) -> Path:
    """Return a log that was imported."""
    path = folder.parent / f'{folder.name}_log'
    if not path.exists():
        log = _put(folder, 'log.csv', _csv())
        mapping = _put(folder, 'mapping.yaml', MAPPING)
        command = ['import', str(log), '--map', str(mapping), '--out', str(path)]
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(command) == 0
    return path


def _joint_states(folder: Path, plugin: StoragePlugin) -> Path:
    """Return a recording of joint states by another program."""
    path = folder.parent / f'{folder.name}_{plugin.name}'
    if path.exists():
        return path
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = 'sensor_msgs/msg/JointState'
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection('/joint_states', kind, typestore=store)
        for row in range(ROWS):
            time = store.types['builtin_interfaces/msg/Time'](
                sec=1_700_000_000, nanosec=row * 10**6
            )
            value = np.array([row * 1e-4])
            message = store.types[kind](
                header=store.types['std_msgs/msg/Header'](stamp=time, frame_id=''),
                name=['x_rotate'], position=value, velocity=value, effort=value,
            )  # fmt: skip
            writer.write(connection, row * 10**6, store.serialize_cdr(message, kind))
    return path


def _mcaps(folder: Path) -> list[bytes]:
    paths = (_run(folder), _archive(folder), _joint_states(folder, StoragePlugin.MCAP))
    return [recording_file(path).read_bytes() for path in paths]


def _feed_mcap(content: bytes, folder: Path) -> None:
    path = _put(folder, 'x_0.mcap', content)
    recording = read_recording(path)
    if 'run.json' in recording.attachments:
        _tell(path)
    _load(path)


def _short(folder: Path, attachments: dict[str, str]) -> Path:
    """Write the first messages of the run as a recording with other attachments."""
    out, content = folder / 'short', _content(_run(folder))
    with RecordingWriter(out, attachments, force=True) as writer:
        for topic, messages in content.messages.items():
            writer.add_topic(topic, content.types[topic])
            times_ns = content.log_times_ns[topic]
            for message, time_ns in zip(messages[:FEW], times_ns, strict=False):
                writer.write(topic, time_ns, message)
    return out / 'short_0.mcap'  # the folder's metadata are a category of their own


def _tell(path: Path) -> None:
    """Do with a recording of a run what the commands do."""
    told = describe(path)
    f'{told["ticks"]} {told["sim_s"]:.4f} {sorted(told["run"].get("versions", {}).items())}'
    responses = load_responses(path)
    for response in responses:
        response.metrics()
        compare([response, response], 'first')


def _feed_db3(content: bytes, folder: Path) -> None:
    metadata = (_joint_states(folder, StoragePlugin.SQLITE3) / 'metadata.yaml').read_bytes()
    bag = folder / 'bag'
    bag.mkdir(exist_ok=True)
    _put(bag, 'metadata.yaml', metadata)
    _put(bag, _database(folder).name, content)
    _load(bag)


def _database(folder: Path) -> Path:
    path = next(iter(_joint_states(folder, StoragePlugin.SQLITE3).glob('*.db3')))
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    return path


def _feed_metadata(content: bytes, folder: Path) -> None:
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        origin = _joint_states(folder, plugin)
        bag = folder / plugin.name
        bag.mkdir(exist_ok=True)
        for file in (path for path in origin.iterdir() if path.suffix in ('.mcap', '.db3')):
            if not (bag / file.name).exists():
                _put(bag, file.name, file.read_bytes())
        _put(bag, 'metadata.yaml', content)
        with contextlib.suppress(UserError):
            _load(bag)


def _metadata(folder: Path) -> list[bytes]:
    return [
        (_joint_states(folder, plugin) / 'metadata.yaml').read_bytes() for plugin in StoragePlugin
    ]


@functools.cache
def _content(path: Path) -> Content:
    return read_content([recording_file(path)])


@functools.cache
def _recording(path: Path) -> Recording:
    return read_recording(path)


def _attachments(name: str) -> Category:
    """Return the category of a text that is attached to the recording of a run."""

    def whole(folder: Path) -> list[bytes]:
        return [_recording(_run(folder)).attachments[name].encode()]

    def feed(content: bytes, folder: Path) -> None:
        text = content.decode('utf-8', 'replace')
        kept = _recording(_run(folder))
        recording = replace(kept, attachments={**kept.attachments, name: text})
        _tell(_short(folder, recording.attachments))
        model = recorded_model(recording)
        recorded_plan(recording, model)
        servo_parameters(model.of_axes('pmac'), 'model')
        amplifier_parameters(model.of_axes('copley'), recording.timing, 'model')

    return Category(name, whole, exchanged if name.endswith('json') else misspelt, feed)


def _measured(folder: Path) -> list[bytes]:
    return [_recording(_archive(folder)).attachments['measured.json'].encode()]


def _feed_measured(content: bytes, folder: Path) -> None:
    kept = read_content([recording_file(_archive(folder))])
    text = content.decode('utf-8', 'replace')
    log = read_archive(folder, replace(kept, attachments={'measured.json': text}))
    json.dumps(log.describe())


# ---- reports and the command line ----------------------------------------------------------------

REPORT = {
    'schema': SCHEMA,
    'model': 'rigid',
    'causes': [
        {
            'effect': 'coulomb_friction', 'axis': 'x_rotate',
            'parameters': {'friction': {'value': 2.5, 'unit': 'N m', 'low95': 2.0, 'high95': 3.0}},
            'credible_set': [
                {'effect': 'coulomb_friction', 'axis': 'x_rotate', 'values': {'friction': 2.5}},
                {'effect': 'viscous_friction', 'axis': 'x_rotate', 'values': {'damping': 0.3}},
            ],
        },
        {'effect': 'viscous_friction', 'axis': 'y_linear', 'parameters': {'damping': {'value': 9.0}},
         'credible_set': []},
    ],
}  # fmt: skip


@functools.cache
def _nominal() -> Variant:
    return Variant.of(load_model('rigid'))


def _feed_report(content: bytes, folder: Path) -> None:
    report = read_report(_put(folder, 'report.json', content))
    of_report(report, _nominal(), None)


ARGUMENTS = (
    b'x_rotate.force', b'coulomb_friction:x_rotate,friction=2.5', b'pmac.y_linear.Ixx30=1:2',
    b'bodies.carriage.mass_kg', b'connections.cable.stiffness_n_m=1e3:1e5',
)  # fmt: skip


def _feed_arguments(content: bytes, folder: Path) -> None:
    text = content.decode('utf-8', 'surrogateescape').replace('\0', '')
    for read in (
        lambda: parse_channel(text, 'x_rotate', AXES),
        lambda: named([text], _nominal()),
        lambda: parse_all([text], _nominal()),
        lambda: load_model(text),
        lambda: load_experiment(text),
        lambda: load_mapping(text),
    ):
        with contextlib.suppress(UserError, OSError):
            read()


def _markers(folder: Path) -> list[bytes]:
    return [(_archive(folder) / MARKER).read_bytes()]


def _feed_marker(content: bytes, folder: Path) -> None:
    ours = folder / 'ours'
    ours.mkdir(exist_ok=True)
    _put(ours, 'thesis.txt', b'years of work')
    _put(ours, MARKER, content)
    assert foreign(ours), 'a damaged list must not make other files ours'
    with contextlib.suppress(UserError):
        OutputFolder(ours, force=True)


CATEGORIES = {
    category.name: category
    for category in (
        Category('model', _models, misspelt, _feed_model),
        Category('machine', _machines, misspelt, _feed_machine),
        Category('experiment', _experiments, misspelt, _feed_experiment),
        Category('settings', lambda folder: [LISTING, SETTINGS], misspelt, _feed_settings),
        Category('mapping', lambda folder: [MAPPING], misspelt, _feed_mapping),
        Category('csv', _csvs, _damaged_csv, _feed_csv),
        Category('json', _json_list, exchanged, _feed_json),
        Category('json text', _json_lines, misspelt, _feed_json),
        Category('list', _lists, _damaged_csv, _feed_list),
        Category('scope', _scopes, _damaged_csv, _feed_scope),
        Category('parquet', _parquets, damaged, _feed_parquet),
        Category('gather', _gathers, misspelt, _feed_gather),
        Category('npy', _npys, damaged, _feed_npy),
        Category('npz', _npzs, damaged, _feed_npz),
        Category('mat', _mats, damaged, _feed_mat),
        Category('mcap', _mcaps, damaged, _feed_mcap),
        Category('db3', lambda folder: [_database(folder).read_bytes()], damaged, _feed_db3),
        Category('metadata.yaml', _metadata, misspelt, _feed_metadata),
        _attachments('run.json'),
        _attachments('model.yaml'),
        _attachments('experiment.yaml'),
        Category('measured.json', _measured, exchanged, _feed_measured),
        Category(
            'report.json', lambda folder: [json.dumps(REPORT).encode()], exchanged, _feed_report
        ),
        Category('arguments', lambda folder: list(ARGUMENTS), misspelt, _feed_arguments),
        Category('marker', _markers, exchanged, _feed_marker),
    )
}
"""All categories, by name."""
