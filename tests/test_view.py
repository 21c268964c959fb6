# SPDX-License-Identifier: Apache-2.0
"""A recording in the browser: what is served, to whom, and the page itself in Chromium."""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import Browser, chromium
from harness import waferbot

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.drawing import moved_corners
from waferbot_plant.plant import load_machine
from waferbot_twin.engines import inprocess
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.validity import recorded_validity
from waferbot_twin.view.content import STRETCHES, ViewContent
from waferbot_twin.view.decimation import decimated
from waferbot_twin.view.server import ViewServer

PICTURE = 'WAFERBOT_VIEW_PICTURE'
"""Environment variable: file to which the picture of the page is written (docs/images/view.png)."""


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """The recording of a step on the rigid machine."""
    out = tmp_path_factory.mktemp('view') / 'a step'
    inprocess.run(make_plan('rigid', 'step', None, 0), out, False, lambda done, total: None)
    return out


@pytest.fixture(scope='module')
def served(run):
    """A server of the recording, and the recording."""
    recording = read_recording(run)
    with ViewServer(ViewContent(recording)) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server, recording
        server.shutdown()
        thread.join()


def fetch(server, path, host=None):
    """Return status and body of a request, as it is: no path is tidied up."""
    connection = http.client.HTTPConnection('127.0.0.1', server.server_port, timeout=30)
    try:
        connection.putrequest('GET', path, skip_host=True)
        connection.putheader('Host', host or f'127.0.0.1:{server.server_port}')
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


# ---- what is served -------------------------------------------------------------------------


def test_decimation_keeps_peaks_and_invents_nothing():
    seed = 5
    random = np.random.default_rng(seed)
    for count in (0, 1, 7, 199, 200, 201, 5000, 5003):
        time = np.cumsum(random.uniform(0.1, 1.0, count))
        values = random.normal(size=count)
        shown_time, shown = decimated(time, values, -np.inf, np.inf, 100)
        assert len(shown) <= 202, seed
        places = np.searchsorted(time, shown_time)
        np.testing.assert_array_equal(time[places], shown_time)
        np.testing.assert_array_equal(values[places], shown)
        assert np.all(np.diff(shown_time) > 0.0)
        if count:
            assert (shown.min(), shown.max()) == (values.min(), values.max())
            assert (shown_time[0], shown_time[-1]) == (time[0], time[-1])


def test_decimation_of_a_part_reaches_over_its_ends():
    time = np.arange(100.0)
    shown_time, shown = decimated(time, time**2, 10.5, 20.5, 100)
    np.testing.assert_array_equal(shown_time, np.arange(10.0, 22.0))
    np.testing.assert_array_equal(shown, shown_time**2)


def test_motion_is_that_of_the_encoders(served):
    server, recording = served
    sent = json.loads(fetch(server, '/recording.json')[1])
    assert [axis['name'] for axis in sent['axes']] == list(AXES)
    encoders = recording['encoders']
    # 1 µm, 1e6 counts per metre: the step is a whole number of counts, and held at the end
    rise = encoders['counts'][-1, 0] - encoders['counts'][0, 0]
    axis = sent['axes'][0]
    per_unit = rise / (axis['position'][-1] - axis['position'][0])
    moved = (encoders['counts'][:, 0] - encoders['counts'][0, 0]) / per_unit
    time = encoders['tick'] / 18000.0 - 1.0 / 9000.0  # counts are one reading old
    expected = np.interp(sent['time'], time, moved)
    np.testing.assert_allclose(
        np.array(axis['position']) - axis['position'][0], expected, atol=1e-12
    )


def test_torque_at_rest_holds_the_weight(served):
    """Before the step X-Rotate stands still; its motor holds the payload against gravity."""
    server, _ = served
    sent = json.loads(fetch(server, '/recording.json')[1])
    robot = ElementTree.fromstring(sent['urdf'])

    def place(link, tag='inertial'):
        return np.array(
            [float(x) for x in robot.find(f"link[@name='{link}']/{tag}/origin").get('xyz').split()]
        )

    def mass(link):
        return float(robot.find(f"link[@name='{link}']/inertial/mass").get('value'))

    # The axis is along x, gravity along -y: the moment about it is z m g of all that it carries.
    moment = sum(9.81 * mass(link) * place(link)[2] for link in ('x_rotate_load', 'y_rotate_load'))
    axis = sent['axes'][AXES.index('x_rotate')]
    before = np.array(sent['time']) < 0.015
    torque = np.mean(np.array(axis['force'])[before][1:])
    assert (axis['force_name'], axis['force_unit']) == ('motor torque', 'Nm')
    assert abs(torque) == pytest.approx(abs(moment), rel=1e-3)


@pytest.fixture(scope='module')
def flexible(tmp_path_factory):
    """The recording of the beginning of a step on the flexible machine."""
    out = tmp_path_factory.mktemp('view') / 'flexible'
    inprocess.run(make_plan('flexible', 'step', 0.1, 0), out, False, lambda done, total: None)
    return out


def content_of(path):
    told = []
    return ViewContent(read_recording(path, told.append), told)


def test_at_rest_a_rope_bears_the_counterweight_and_a_belt_its_pretension(flexible):
    sent = content_of(flexible).recording()
    rest = np.array(sent['load_ends']) < 0.015
    amounts = {(load['place'], load['what']): load for load in sent['loads']}
    description = load_machine('flexible').description
    belt = description.connections['belt'].part
    weight = 9.81 * description.bodies['counterweight'].mass
    for place, what, unit, expected in (
        ('cable', 'tension of a rope', 'N', weight / 2.0),  # on two ropes
        ('belt', 'tension of the slack span', 'N', belt.span_pretension_n),
    ):
        found = amounts[place, what]
        assert found['unit'] == unit
        for values in (found['least'], found['most']):
            assert np.array(values)[rest] == pytest.approx(expected, rel=1e-6)
    moved = amounts['cable', 'tension of a rope']
    assert moved['most'][-1] > moved['least'][-1]


def test_what_leaves_its_range_is_marked_from_when_the_run_says_it_did(flexible):
    sent = content_of(flexible).recording()
    marked = {
        (load['place'], load['what']): sent['load_ends'][load['outside'].index(True)]
        for load in sent['loads']
        if any(load['outside'])
    }
    said = {
        (row['place'], row['what']): row['first_s']
        for row in recorded_validity(flexible)
        if row['outside'] and row['what'] != 'current command'
    }
    assert marked
    assert marked == said


def test_a_long_recording_has_wider_stretches_and_keeps_the_peaks(flexible, monkeypatch):
    whole = content_of(flexible).recording()
    monkeypatch.setattr('waferbot_twin.view.loads.MOST_STRETCHES', 3)
    sent = content_of(flexible).recording()
    assert len(sent['load_ends']) == 3
    assert sent['load_ends'][-1] == whole['load_ends'][-1]
    for wide, narrow in zip(sent['loads'], whole['loads'], strict=True):
        assert min(wide['least']) == min(narrow['least'])
        assert max(wide['most']) == max(narrow['most'])
        assert any(wide['outside']) == any(narrow['outside'])


def test_of_rigid_connections_nothing_is_told(run):
    assert content_of(run).recording()['loads'] == []


def test_curves_are_the_samples_of_the_stretch(served):
    server, recording = served
    sent = json.loads(fetch(server, '/recording.json')[1])
    whole = json.loads(fetch(server, f'/curves.json?from=0&to={sent["duration"]}')[1])
    part = json.loads(fetch(server, '/curves.json?from=0.02&to=0.03')[1])
    titles = [(plot['axis'], plot['title'].split(' [')[0]) for plot in sent['plots']]
    assert titles == [
        (axis, title) for axis in AXES for title in ('position', 'following error', 'current')
    ]
    assert len(whole) == len(part) == len(titles)
    command = recording['current_command']
    for axis in range(len(AXES)):
        labels = [curve['label'] for curve in sent['plots'][3 * axis + 2]['curves']]
        time, values = part[3 * axis + 2][labels.index('command')]
        ticks = np.rint(np.array(time) * 18000.0).astype(int)
        rows = np.searchsorted(command['tick'], ticks)
        np.testing.assert_array_equal(command['tick'][rows], ticks)
        np.testing.assert_array_equal(command['current'][rows, axis], values)
        assert np.all(np.diff(rows) == 1)
    assert max(len(time) for plot in whole for time, _ in plot) <= 2 * STRETCHES + 2


# ---- to whom --------------------------------------------------------------------------------


def test_it_is_bound_to_this_computer(served):
    assert served[0].server_address[0] == '127.0.0.1'


@pytest.mark.parametrize('host', ['evil.example', 'evil.example:80', '127.0.0.1', '127.0.0.1:1'])
def test_a_request_for_another_host_is_refused(served, host):
    status, body = fetch(served[0], '/recording.json', host)
    assert status == 403
    assert b'urdf' not in body


@pytest.mark.parametrize(
    ('path', 'status'),
    [
        ('/', 200),
        ('/view.js', 200),
        ('/vendor/three.module.min.js', 200),
        ('/nothing', 404),
        ('/../server.py', 404),
        ('/vendor/../../server.py', 404),
        ('/vendor/README.md', 404),
        ('//etc/passwd', 404),
        ('/curves.json', 400),
        ('/curves.json?from=1&to=0', 400),
        ('/curves.json?from=x&to=1', 400),
        ('/curves.json?from=nan&to=nan', 400),
    ],
)
def test_only_the_page_is_served(served, path, status):
    assert fetch(served[0], path)[0] == status


def test_libraries_are_the_published_files():
    vendor = files('waferbot_twin.view').joinpath('page', 'vendor')
    table = vendor.joinpath('README.md').read_text('utf-8')
    listed = dict(re.findall(r'^\| `([^`]+)` .* `([0-9a-f]{64})` \|$', table, re.MULTILINE))
    found = {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in vendor.iterdir()
        if file.name != 'README.md'
    }
    assert found == listed
    assert all(len(file.read_bytes()) < 2**20 for file in vendor.iterdir())


# ---- the command ----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_serves_until_it_is_interrupted(run):
    program = subprocess.Popen(
        [sys.executable, '-m', 'waferbot_twin', 'view', str(run), '--no-browser'],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        url = program.stdout.readline().strip()
        assert re.fullmatch(r'http://127\.0\.0\.1:\d+/', url), program.communicate()
        with urllib.request.urlopen(url + 'recording.json', timeout=30) as answer:
            assert json.load(answer)['name'] == 'a step'
        taken = waferbot('view', str(run), '--no-browser', '--port', url.split(':')[2].strip('/'))
        assert taken.returncode == 1
        assert 'leave --port away' in taken.stderr
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=60)
        assert program.returncode == 0, errors
        assert errors.splitlines() == ['Ctrl-C ends it']
    finally:
        program.kill()
        program.communicate()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url, timeout=5)


def test_a_recording_without_its_model_is_refused(served):
    _, recording = served
    for attachments, said in (
        ({}, 'does not hold the model'),
        ({**recording.attachments, 'machine.yaml': 'bodies: {\n}\n'}, 'joints missing'),
    ):
        with pytest.raises(UserError, match=said):
            ViewContent(replace(recording, attachments=attachments))


def test_a_recording_without_encoders_is_refused(served):
    _, recording = served
    topics = {**recording.topics, 'encoders': recording['encoders'][:0]}
    with pytest.raises(UserError, match='no encoder counts'):
        ViewContent(replace(recording, topics=topics))


def test_a_recording_of_which_the_servo_told_nothing_is_shown(served):
    """A foreign controller need not report commanded positions: an axis moves if its encoder says so."""
    _, recording = served
    topics = {**recording.topics, 'servo_state': recording['servo_state'][:0]}
    content = ViewContent(replace(recording, topics=topics))
    assert content.curves(0.0, 1.0)[0][0] == [[], []]
    assert content.recording()['axes'][0]['moves'] is True


# ---- the page -------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def page(served, tmp_path_factory):
    """The page, open in Chromium and loaded."""
    program = chromium()
    if program is None:
        pytest.skip('no Chromium on PATH: the page is not tested')
    browser = Browser(program, tmp_path_factory.mktemp('chromium'))
    try:
        browser.open(served[0].url)
        browser.wait_for("document.body?.dataset.state === 'ready'")
        yield browser
    finally:
        browser.end()


@pytest.fixture
def fresh(page):
    """The page at time 0, standing still, showing all of Y-Linear."""
    page.value('waferbotView.play(false)')
    page.value('waferbotView.look(0, waferbotView.recording.duration)')
    page.value("waferbotView.choose('y_linear'); waferbotView.seek(0)")
    return page


@pytest.mark.slow
def test_the_page_loads_only_from_its_server(fresh, served):
    assert fresh.requests()
    assert all(url.startswith((served[0].url, 'data:')) for url in fresh.requests())
    assert fresh.troubles() == []


CORNERS = """(link => {
  const robot = waferbotView.machine.robot;
  robot.root.updateMatrixWorld(true);
  const toBase = robot.links.base.matrixWorld.clone().invert();
  const mesh = robot.links[link].children.find((child) => child.isMesh);
  const all = mesh.geometry.getAttribute('position');
  return Array.from({ length: all.count }, (_, i) => mesh.position.clone()
    .fromBufferAttribute(all, i).applyMatrix4(mesh.matrixWorld).applyMatrix4(toBase).toArray());
})"""
"""JavaScript: the corners of a link as they are drawn, in the frame `base`."""


@pytest.mark.slow
def test_the_machine_stands_as_the_plant_says(fresh):
    """The corners of every link in the browser against the plant's own kinematics."""
    assert fresh.value('waferbotView.machine !== undefined')
    machine = load_machine('rigid')
    for positions in ({}, {'y_linear': 0.13, 'x_rotate': 0.5, 'y_rotate': -0.7}):
        fresh.value(f'waferbotView.machine.robot.set({json.dumps(positions)})')
        state = machine.initial_state(machine.parameters(), positions)
        for name, expected in moved_corners(machine, state, machine.parameters()).items():
            drawn = np.array(fresh.value(f'{CORNERS}({json.dumps(name)})'))
            distance = np.linalg.norm(drawn[:, None] - expected[None], axis=2)
            assert distance.min(axis=0).max() < 1e-6, (name, positions)
            assert distance.min(axis=1).max() < 1e-6, (name, positions)


@pytest.mark.slow
def test_the_machine_is_drawn_and_moves(fresh):
    def drawn():
        return fresh.value('document.querySelector("#machine canvas").toDataURL()')

    fresh.value("waferbotView.machine.show([{name: 'y_linear', position: 0, force: 0}])")
    home = drawn()
    fresh.value("waferbotView.machine.show([{name: 'y_linear', position: 0.2, force: 0}])")
    moved = drawn()
    fresh.value("waferbotView.machine.show([{name: 'y_linear', position: 0.2, force: 1e9}])")
    assert len({home, moved, drawn()}) == 3


@pytest.mark.slow
def test_play_goes_on_and_pause_stops(fresh):
    # The page itself pauses in the first frame that has moved: on a busy machine the recording would
    # be at its end before a test has looked.
    stopped = fresh.value(
        """new Promise(done => {
            const play = document.getElementById('play');
            play.click();
            const look = () => {
                if (waferbotView.time === 0) return requestAnimationFrame(look);
                play.click();
                done(waferbotView.time);
            };
            look();
        })"""
    )
    assert stopped > 0.0
    assert (
        fresh.value('new Promise(r => requestAnimationFrame(() => r(waferbotView.time)))')
        == stopped
    )
    assert fresh.value('document.getElementById("now").textContent') == f'{stopped:.4f} s'
    fresh.value('waferbotView.seek(waferbotView.recording.duration - 0.01)')
    fresh.press('#play')
    fresh.wait_for('!waferbotView.playing')
    assert fresh.value('waferbotView.time === waferbotView.recording.duration')


@pytest.mark.slow
def test_the_cursor_is_one_for_all_plots(fresh):
    left, top, width, height = fresh.place_of('.u-over')
    fresh.mouse('mouseMoved', left + 0.4 * width, top + 0.5 * height)
    fresh.wait_for('document.querySelector(".u-legend .u-value").textContent.endsWith(" s")')
    times = fresh.value(
        'Array.from(document.querySelectorAll(".u-legend .u-series:first-child .u-value"), '
        'cell => cell.textContent)'
    )
    duration = fresh.value('waferbotView.recording.duration')
    assert len(times) == 3
    for text in times:
        assert float(text.removesuffix(' s')) == pytest.approx(0.4 * duration, abs=2e-3)


@pytest.mark.slow
def test_a_click_sets_the_time_and_a_drag_looks_closer(fresh, served):
    left, top, width, height = fresh.place_of('.u-over')
    duration = fresh.value('waferbotView.recording.duration')
    fresh.click(left + 0.25 * width, top + 0.5 * height)
    fresh.wait_for('waferbotView.time > 0')
    assert fresh.value('waferbotView.time') == pytest.approx(0.25 * duration, abs=2e-3)
    fresh.click(left + 0.1 * width, top + 0.5 * height, left + 0.2 * width)
    fresh.wait_for('waferbotView.plots.range[0] > 0')
    assert fresh.value('waferbotView.plots.range') == pytest.approx(
        [0.1 * duration, 0.2 * duration], abs=2e-3
    )
    # more samples of the stretch than were drawn of the whole: each one that was recorded
    assert fresh.value('waferbotView.plots.curves[2][1][0].length') == pytest.approx(
        0.1 * duration * 18000.0, abs=0.004 * 18000.0
    )
    middle = {'button': 'left', 'buttons': 1}
    for count in (1, 2):
        for kind in ('mousePressed', 'mouseReleased'):
            fresh.mouse(kind, left + 0.5 * width, top + 0.5 * height, clickCount=count, **middle)
    fresh.wait_for('waferbotView.plots.range[0] === 0')
    assert fresh.value('waferbotView.plots.range[1]') == duration


@pytest.mark.slow
def test_the_values_beside_the_machine_are_those_of_the_time(fresh, served):
    sent = json.loads(fetch(served[0], '/recording.json')[1])
    place = 13
    fresh.value(f'waferbotView.seek({sent["time"][place]!r})')
    rows = fresh.value(
        'Array.from(document.querySelectorAll("#values tbody tr"), '
        'row => [row.cells[1].textContent, row.cells[3].textContent])'
    )
    for axis, (position, force) in zip(sent['axes'], rows, strict=True):
        scale, unit = (1e3, 'mm') if axis['unit'] == 'm' else (180.0 / np.pi, '°')
        number, shown = position.split()
        assert shown == unit
        assert float(number) == pytest.approx(scale * axis['position'][place], abs=6e-5)
        number, shown = force.split()
        assert shown == axis['force_unit']
        assert float(number) == pytest.approx(axis['force'][place], abs=6e-3)


@pytest.fixture
def flexible_page(page, served, flexible):
    """The page of the flexible machine in the same browser, and what is served to it."""
    content = content_of(flexible)
    with ViewServer(content) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        page.open(server.url)
        page.wait_for("document.body?.dataset.state === 'ready'")
        yield page, content.recording()
        server.shutdown()
        thread.join()
    page.open(served[0].url)
    page.wait_for("document.body?.dataset.state === 'ready'")


@pytest.mark.slow
def test_what_the_parts_bear_is_shown_of_the_stretch_of_the_time(flexible_page):
    page, sent = flexible_page
    for time, place in ((0.0, 0), (0.045, 5), (0.05, 5), (1.0, -1)):
        page.value(f'waferbotView.seek({time})')
        rows = page.value(
            'Array.from(document.querySelectorAll("#loads tbody tr"), row => '
            '[row.className, ...Array.from(row.cells, cell => cell.textContent)])'
        )
        for load, (marked, *cells) in zip(sent['loads'], rows, strict=True):
            assert [cells[0], cells[1], cells[3]] == [load['place'], load['what'], load['range']]
            amounts, unit = cells[2].rsplit(' ', 1)
            least, most = (amounts.split(' to ') * 2)[:2]
            assert unit == load['unit']
            assert float(least) == pytest.approx(load['least'][place], rel=6e-4)
            assert float(most) == pytest.approx(load['most'][place], rel=6e-4)
            assert (marked == 'outside') is load['outside'][place]
    assert page.troubles() == []


@pytest.mark.slow
def test_where_all_is_rigid_there_is_no_table_of_what_parts_bear(fresh):
    assert fresh.value('document.getElementById("loads").hidden') is True


@pytest.mark.slow
def test_a_picture_of_the_page(flexible_page, tmp_path):
    page, _ = flexible_page
    page.value("waferbotView.choose('y_linear'); waferbotView.seek(0.06)")
    left, top, width, height = page.place_of('.u-over')
    page.mouse('mouseMoved', left + 0.3 * width, top + 0.5 * height)
    picture = page.picture()
    assert picture.startswith(b'\x89PNG')
    Path(os.environ.get(PICTURE, tmp_path / 'view.png')).write_bytes(picture)
    assert page.troubles() == []
