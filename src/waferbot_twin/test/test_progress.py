# SPDX-License-Identifier: Apache-2.0
"""Progress where there is no terminal: one line with the remaining time, of what takes long."""

from __future__ import annotations

import io

import pytest

from waferbot_twin.cli import console


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on when it is told to."""
    now = [100.0]
    monkeypatch.setattr(console.time, 'monotonic', lambda: now[0])
    monkeypatch.setattr(
        console, 'error_console', console.Console(stderr=True, force_terminal=False)
    )

    def wait(duration_s: float) -> None:
        now[0] += duration_s

    return wait


def lines_of(capsys, clock, reports):
    """Return what is said of reports, each (seconds since the one before, done, total)."""
    with console.progress_bar('searching') as progress:
        for duration_s, done, total in reports:
            clock(duration_s)
            progress(done, total)
    return capsys.readouterr().err.splitlines()


def test_what_is_short_is_quiet(capsys, clock):
    assert lines_of(capsys, clock, [(0.1, done, 10) for done in range(11)]) == []


def test_one_line_is_enough(capsys, clock):
    reports = [(1.0, done, 100) for done in range(101)]
    assert lines_of(capsys, clock, reports) == ['searching: about 90 s left']


def test_a_few_quick_steps_tell_nothing(capsys, clock):
    """Of 1000 steps the first thirty take 0.1 s each, the others 1 s."""
    reports = [(0.1 if done < 30 else 1.0, done, 1000) for done in range(101)]
    (told,) = lines_of(capsys, clock, reports)
    assert told == 'searching: about 8 min left'


def test_what_was_before_the_first_report_does_not_count(capsys, clock):
    """Half a minute of compiling, then 1 s for each of 100."""
    reports = [(30.0, 1, 100), *((1.0, done, 100) for done in range(2, 13))]
    assert lines_of(capsys, clock, reports) == ['searching: about 89 s left']


def test_waiting_for_nodes_does_not_count(capsys, clock):
    waiting = [(1.0, 0, 1000)] * 30
    assert lines_of(capsys, clock, [*waiting, (0.1, 1, 1000), (2.9, 100, 1000)]) == [
        'searching: about 27 s left'
    ]


def test_too_little_to_tell_from(capsys, clock):
    assert lines_of(capsys, clock, [(3.0, done, 1000) for done in range(10)]) == []


def test_what_takes_twice_as_long_as_was_said_is_said_anew(capsys, clock):
    """Steps of 1 s that become steps of 10 s: the second estimate is that of the long ones."""
    reports = [(1.0, done, 100) for done in range(11)]
    reports += [(10.0, done, 100) for done in range(11, 101)]
    assert lines_of(capsys, clock, reports) == [
        'searching: about 90 s left',
        'searching: about 12 min left',
    ]


def test_the_end_is_no_news(capsys, clock):
    assert lines_of(capsys, clock, [(5.0, 1, 2), (60.0, 2, 2)]) == []


def test_every_stage_has_its_line_once(capsys, clock):
    with console.progress_of_stages('diagnosis') as progress:
        for _ in range(3):  # rounds
            for stage in ('screening', 'fitting'):
                for done in range(11):
                    clock(1.0)
                    progress(stage, done, 10)
        progress('judging', 1, 1)
    assert capsys.readouterr().err.splitlines() == [
        'diagnosis, screening: about 8 s left of this stage',
        'diagnosis, fitting: about 8 s left of this stage',
    ]


def test_on_a_terminal_the_bar_names_its_stage(monkeypatch):
    written = io.StringIO()
    terminal = console.Console(file=written, force_terminal=True, width=100)
    monkeypatch.setattr(console, 'error_console', terminal)
    monkeypatch.setattr(console, 'QUIET_S', 0.0)
    with console.progress_of_stages('diagnosis') as progress:
        for stage in ('screening', 'fitting'):
            for done in range(3):
                progress(stage, done, 4)
                terminal.print(f'at {done}')
    assert 'diagnosis, screening' in written.getvalue()
    assert 'diagnosis, fitting' in written.getvalue()
    assert '50%' in written.getvalue()


@pytest.mark.parametrize(
    ('duration_s', 'words'),
    [(0.01, '1 s'), (7.2, '8 s'), (120.0, '120 s'), (121.0, '3 min'), (7200.0, '120 min'),
     (7201.0, '3 h')],
)  # fmt: skip
def test_durations_in_words(duration_s, words):
    assert console.in_words(duration_s) == words
