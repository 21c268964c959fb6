# SPDX-License-Identifier: Apache-2.0
"""Recordings read piece by piece: nothing is lost, nothing depends on where a piece ends."""

from __future__ import annotations

import tracemalloc
from functools import partial

import numpy as np
import pytest
from mcap.reader import make_reader

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import CONTRACT_TOPICS, PHASE_CURRENTS
from waferbot_lockstep.layout import SHIPPED
from waferbot_lockstep.timing import Timing
from waferbot_twin.cli.info import describe
from waferbot_twin.cli.main import main
from waferbot_twin.models import recorded_model
from waferbot_twin.plot import plot_recording
from waferbot_twin.recording import reader
from waferbot_twin.recording.completeness import Account
from waferbot_twin.recording.reader import read_recording, recording_file, stream_recording
from waferbot_twin.response import driving_current
from waferbot_twin.response_reader import load_responses
from waferbot_twin.thinning import Thinned, extremes, thinned

SEED = 33


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp('streamed') / 'run'
    arguments = ['--duration', '0.4', '--model', 'rigid', '--out', str(out)]
    assert main(['run', '--engine', 'inprocess', *arguments]) == 0
    return out


def test_chunks_hold_what_the_library_reads_message_by_message(run) -> None:
    wanted: dict[str, list[bytes]] = {}
    times: dict[str, list[int]] = {}
    with recording_file(run).open('rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            wanted.setdefault(channel.topic, []).append(message.data)
            times.setdefault(channel.topic, []).append(message.log_time)
    content = reader.read_content([recording_file(run)])
    assert {name: data for name, data in content.messages.items() if data} == wanted
    assert {name: ns for name, ns in content.log_times_ns.items() if ns} == times
    assert content.closed


def test_a_stream_gives_the_messages_of_the_whole_recording(run) -> None:
    whole = read_recording(run)
    parts: dict[str, list[np.ndarray]] = {}
    reached = []
    streamed = stream_recording(
        run,
        lambda topic, records: parts.setdefault(topic.name, []).append(records),
        lambda done, total: reached.append(done / total),
    )
    assert streamed.counts == whole.counts
    assert streamed.attachments == whole.attachments
    for topic in CONTRACT_TOPICS:
        assert len(parts[topic.name]) > 1, 'one piece only: this proves nothing'
        together = np.concatenate(parts[topic.name])
        np.testing.assert_array_equal(together, whole[topic])
    assert reached == sorted(reached)
    assert 0.5 < reached[-1] <= 1.0


def test_responses_do_not_depend_on_where_pieces_end(run) -> None:
    """Every current stands with the counts that were newest then, also across the end of a piece."""
    recording = read_recording(run)
    model, timing = recorded_model(recording), recording.timing
    amplifier = amplifier_parameters(model.of_axes('copley'), timing, 'test')[0]
    currents, encoders = recording[PHASE_CURRENTS], recording['encoders']
    for axis, response in enumerate(load_responses(run)):
        wanted = driving_current(
            currents['tick'],
            currents['current'],
            axis,
            amplifier,
            (encoders['tick'], encoders['counts']),
        )
        np.testing.assert_array_equal(response.current, wanted)
        np.testing.assert_array_equal(
            response.tick_time, currents['tick'] / timing.current_loop_hz
        )


def test_many_messages_are_accounted_for_as_one_by_one(random) -> None:
    for _ in range(20):
        single, many = Account(Timing()), Account(Timing())
        for topic in CONTRACT_TOPICS:
            one, other = single.topics[topic], many.topics[topic]
            ticks = np.repeat(np.arange(0, 400, one.spacing), 2).astype(np.uint64)
            ticks = np.sort(ticks[random.uniform(size=len(ticks)) > 0.3])
            if random.uniform() < 0.3:
                random.shuffle(ticks)
            valid = random.integers(0, topic.all_places(SHIPPED) + 1, len(ticks)).astype(np.uint8)
            for tick, mask in zip(ticks.tolist(), valid.tolist(), strict=True):
                one.is_new(tick, mask)
            for part in np.array_split(np.arange(len(ticks)), 3):
                other.note_all(ticks[part], valid[part])
            assert other.given == one.given
            assert other.last == one.last
            assert other.first_gap == one.first_gap


def test_what_info_says_is_what_is_there(run) -> None:
    told = describe(run)
    recording = read_recording(run)
    assert told['missing'] == 0
    assert told['ticks'] == recording.ticks == 7200
    counts = {topic['name']: topic['messages'] for topic in told['topics']}
    assert counts == recording.counts


def peak_of(work) -> int:
    """Return the most memory that something held at once, in bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_info_needs_no_more_memory_for_a_longer_recording(run, tmp_path) -> None:
    arguments = ['--duration', '1.6', '--model', 'rigid', '--out', str(tmp_path / 'long')]
    assert main(['run', '--engine', 'inprocess', *arguments]) == 0
    peaks = {}
    for path in (run, tmp_path / 'long'):
        describe(path)  # what is kept from the first time on is there now
        peaks[path] = peak_of(partial(describe, path))
    size = recording_file(tmp_path / 'long').stat().st_size
    assert max(peaks.values()) < 0.5 * size, 'the file is held as a whole'
    assert peaks[tmp_path / 'long'] < 1.25 * peaks[run]


@pytest.mark.slow
def test_a_picture_of_five_minutes_stays_within_a_gigabyte(tmp_path) -> None:
    """
    By what each further second of a recording takes.

    Beyond the seven seconds of which currents are kept whole that is the same for all of them. A
    quarter of the gigabyte is for the libraries, and what drawing takes is in both.
    """
    peaks = []
    for duration_s in (8, 14):
        path = tmp_path / f'{duration_s}'
        arguments = ['--engine', 'inprocess', '--experiment', 'constant', '--model', 'rigid']
        arguments += ['--duration', str(duration_s), '--out', str(path)]
        assert main(['run', *arguments]) == 0
        picture = path.with_suffix('.png')
        peaks.append(peak_of(partial(plot_recording, path, picture)))
        assert picture.stat().st_size > 10_000
    of_a_second = (peaks[1] - peaks[0]) / 6.0
    assert of_a_second > 0.0, 'the longer one took less: what was measured?'
    assert peaks[0] + 292.0 * of_a_second < 750e6


@pytest.mark.parametrize('pieces', [1, 7, 200])
def test_thinning_keeps_every_peak(random, pieces) -> None:
    count = 40_000
    time_s = np.cumsum(random.uniform(0.5, 1.5, count))
    values = random.standard_normal(count)
    values[random.integers(count)], values[random.integers(count)] = 50.0, -60.0
    kept = Thinned(3000)
    for part in np.array_split(np.arange(count), pieces):
        kept.add(time_s[part], values[part])
    kept_s, found = kept.samples()
    assert len(found) <= 3000 + count // 1000
    assert np.all(np.diff(kept_s) > 0.0)
    assert found.max() == 50.0
    assert found.min() == -60.0
    np.testing.assert_array_equal(values[np.searchsorted(time_s, kept_s)], found)
    # As fine everywhere: each fiftieth of the signal has its own greatest and least sample.
    for part in np.array_split(np.arange(count), 50):
        inside = (kept_s >= time_s[part[0]]) & (kept_s <= time_s[part[-1]])
        assert found[inside].max() == values[part].max()
        assert found[inside].min() == values[part].min()


def test_a_short_signal_is_kept_whole(random) -> None:
    time_s, values = np.arange(100.0), random.standard_normal(100)
    kept = Thinned(100)
    kept.add(time_s, values)
    np.testing.assert_array_equal(kept.samples()[1], values)
    np.testing.assert_array_equal(thinned(time_s, values, 100)[1], values)
    assert len(thinned(time_s, values, 99)[1]) <= 99
    assert len(extremes(time_s[:0], values[:0], 4)[0]) == 0
