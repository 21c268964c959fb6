# SPDX-License-Identifier: Apache-2.0
"""Layouts for Foxglove, PlotJuggler and RViz: they open, and name only what a recording holds."""

from __future__ import annotations

import importlib
import json
import numbers
import re
from itertools import chain
from xml.etree import ElementTree

import pytest
import yaml
from rclpy.serialization import deserialize_message

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.package_data import package_data
from waferbot_twin.cli.main import main
from waferbot_twin.engines import inprocess
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.reader import read_content, recording_file

LAYOUTS = package_data('waferbot_twin', 'config', 'layouts')
POSITION_ENCODER = (0, 1, 2)
"""Place in `encoders.counts` of the encoder that each axis is positioned by (Ixx03)."""


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    """The first message of every topic of a recording but for transforms, which no plot shows."""
    out = tmp_path_factory.mktemp('layouts') / 'run'
    inprocess.run(make_plan('rigid', 'step', 0.01, 0), out, False, lambda done, total: None)
    content = read_content([recording_file(out)])
    return {
        topic: deserialize_message(data[0], message_type(content.types[topic]))
        for topic, data in content.messages.items()
        if data and topic not in ('/tf', '/tf_static')
    }


@pytest.fixture(scope='module')
def overlay(tmp_path_factory):
    """The topics of an overlay: a log of the machine beside its replay."""
    folder = tmp_path_factory.mktemp('overlay')
    log, model = str(folder / 'log'), ('--model', 'rigid')
    assert main(['synthesize', '--experiment', 'step', *model, '--out', log]) == 0
    assert main(['import', log, *model, '--out', str(folder / 'imported')]) == 0
    out = str(folder / 'overlay')
    assert main(['replay', str(folder / 'imported'), *model, '--out', out]) == 0
    content = read_content([recording_file(folder / 'overlay')])
    return {
        topic: deserialize_message(data[0], message_type(content.types[topic]))
        for topic, data in content.messages.items()
    }


def message_type(name):
    """Return the class of `package/msg/Name`."""
    package, kind, message = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), message)


def value_at(messages, topic, fields):
    """Follow `field`, `field[index]` through the recorded message of a topic; a number must be there."""
    assert topic in messages, f'{topic} is not recorded; there are {sorted(messages)}'
    value = messages[topic]
    for field in fields:
        name, index = re.fullmatch(r'(\w+)(?:\[(\d+)\])?', field).groups()
        value = getattr(value, name)
        value = value if index is None else value[int(index)]
    assert isinstance(value, numbers.Real)
    return value


def of_foxglove(path):
    """Return topic and fields of Foxglove's `/topic.field[index]`."""
    topic, *fields = path.split('.')
    return topic, fields


def of_plotjuggler(messages, path):
    """Return topic and fields of PlotJuggler's `/topic/field[index]`, or `/topic/JOINT/position`."""
    _, topic, *fields = path.split('/')
    if topic == 'joint_states':
        joint, field = fields
        return '/' + topic, [f'{field}[{list(messages["/joint_states"].name).index(joint)}]']
    return '/' + topic, fields


def curves_of_foxglove(layout='foxglove.json'):
    """Return the paths of every plot of the layout."""
    panels = json.loads((LAYOUTS / layout).read_text('utf-8'))['configById']
    return [
        [path['value'] for path in panel['paths']]
        for name, panel in panels.items()
        if name.startswith('Plot!')
    ]


def curves_of_plotjuggler(layout='plotjuggler.xml'):
    """Return the paths of every plot of the layout."""
    root = ElementTree.parse(LAYOUTS / layout).getroot()
    return [[curve.get('name') for curve in plot.iter('curve')] for plot in root.iter('plot')]


def test_foxglove_names_what_is_recorded(messages):
    plots = curves_of_foxglove()
    for path in chain(*plots):
        value_at(messages, *of_foxglove(path))
    assert_all_is_shown([[of_foxglove(path) for path in plot] for plot in plots])


def test_plotjuggler_names_what_is_recorded(messages):
    plots = [[of_plotjuggler(messages, path) for path in plot] for plot in curves_of_plotjuggler()]
    for topic, fields in chain(*plots):
        value_at(messages, topic, fields)
    assert_all_is_shown(plots)


def assert_all_is_shown(plots):
    """Every axis: commanded beside measured position, following error, currents and voltages."""
    shown = [{(topic, *fields) for topic, fields in plot} for plot in plots]
    for axis in range(len(AXES)):
        wanted = (
            {
                ('/servo_state', f'commanded_position[{axis}]'),
                ('/encoders', f'counts[{POSITION_ENCODER[axis]}]'),
            },
            {('/servo_state', f'following_error[{axis}]')},
            {('/current_command', f'current[{axis}]')}
            | {('/phase_currents', f'current[{2 * axis + line}]') for line in range(2)},
            {('/phase_voltages', f'voltage[{3 * axis + terminal}]') for terminal in range(3)},
            {('/joint_states', f'position[{axis}]')},
        )
        for curves in wanted:
            assert curves in shown


def test_layouts_of_overlays_name_what_is_in_one(overlay):
    wanted = {
        axis: [
            curves
            for signal in ('position', 'current')
            for curves in (
                {f'/measured/{axis}/{signal}', f'/simulated/{axis}/{signal}'},
                {f'/residual/{axis}/{signal}'},
            )
        ]
        for axis in AXES
    }
    in_foxglove = [
        [of_foxglove(path) for path in plot]
        for plot in curves_of_foxglove('overlay_foxglove.json')
    ]
    in_plotjuggler = [
        [(path.rsplit('/', 1)[0], [path.rsplit('/', 1)[1]]) for path in plot]
        for plot in curves_of_plotjuggler('overlay_plotjuggler.xml')
    ]
    for plots in (in_foxglove, in_plotjuggler):
        for topic, fields in chain(*plots):
            value_at(overlay, topic, fields)
        assert [{topic for topic, _ in plot} for plot in plots] == list(chain(*wanted.values()))


@pytest.mark.parametrize('file', ['foxglove.json', 'overlay_foxglove.json'])
def test_foxglove_places_every_panel_once(file):
    layout = json.loads((LAYOUTS / file).read_text('utf-8'))
    panels = layout['configById']

    def placed(node):
        if isinstance(node, str):
            inner = [tab['layout'] for tab in panels[node].get('tabs', ())]
            return [node, *(name for tab in inner for name in placed(tab))]
        assert node['direction'] in ('row', 'column')
        assert 0 < node['splitPercentage'] < 100
        return placed(node['first']) + placed(node['second'])

    names = placed(layout['layout'])
    assert sorted(names) == sorted(panels)


def test_foxglove_shows_the_machine_moving(messages):
    panels = json.loads((LAYOUTS / 'foxglove.json').read_text('utf-8'))['configById']
    topics = panels['3D!machine']['topics']
    assert set(topics) == {'/robot_description', '/joint_states'}
    assert set(topics) <= set(messages)
    assert all(topic['visible'] for topic in topics.values())
    assert panels['3D!machine']['followTf'] in links(messages)


@pytest.mark.parametrize('file', ['plotjuggler.xml', 'overlay_plotjuggler.xml'])
def test_plotjuggler_counts_its_splits(file):
    root = ElementTree.parse(LAYOUTS / file).getroot()
    splitters = list(root.iter('DockSplitter'))
    assert splitters
    for splitter in splitters:
        count = len(splitter.findall('DockArea'))
        assert int(splitter.get('count')) == count
        sizes = [float(size) for size in splitter.get('sizes').split(';')]
        assert len(sizes) == count
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)


def test_rviz_shows_the_recorded_machine(messages):
    layout = yaml.safe_load((LAYOUTS / 'machine.rviz').read_text('utf-8'))
    manager = layout['Visualization Manager']
    displays = {display['Class'].split('/')[1]: display for display in manager['Displays']}
    topic = displays['RobotModel']['Description Topic']
    assert topic['Value'] in messages
    assert topic['Durability Policy'] == 'Transient Local'  # it is sent once, before RViz starts
    frames = (
        manager['Global Options']['Fixed Frame'],
        displays['Grid']['Reference Frame'],
        manager['Views']['Current']['Target Frame'],
    )
    assert set(frames) <= links(messages)


def links(messages):
    """Return the names of the links of the recorded robot."""
    robot = ElementTree.fromstring(messages['/robot_description'].data)
    return {link.get('name') for link in robot.findall('link')}
