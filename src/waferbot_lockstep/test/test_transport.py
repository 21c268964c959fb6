# SPDX-License-Identifier: Apache-2.0
"""Which command lines of a node ask for real time."""

from pathlib import Path

import pytest

from waferbot_lockstep.transport import (
    BUILTIN_TRANSPORTS,
    DISCOVERY,
    PROFILES,
    asks_for_real_time,
    choose_transport,
)


@pytest.mark.parametrize(
    ('words', 'expected'),
    [
        ('plant --ros-args -p timekeeping:=realtime', True),
        ('plant --ros-args --param timekeeping:=realtime -p end_tick:=5', True),
        ('plant --ros-args -p timekeeping:=lockstep', False),
        ('plant --ros-args -p other:=realtime', False),
        ('plant timekeeping:=realtime', False),
        ('plant', False),
    ],
)
def test_on_the_command_line(words, expected):
    assert asks_for_real_time(words.split()) == expected


@pytest.mark.parametrize(('value', 'expected'), [('realtime', True), ('lockstep', False)])
def test_in_a_parameter_file(tmp_path, value, expected):
    file = tmp_path / 'own.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    timekeeping: {value}\n')
    assert asks_for_real_time(['plant', '--ros-args', '--params-file', str(file)]) == expected


def test_the_command_line_goes_before_an_earlier_file(tmp_path):
    file = tmp_path / 'own.yaml'
    file.write_text('/**: {ros__parameters: {timekeeping: realtime}}\n')
    words = ['--params-file', str(file), '-p', 'timekeeping:=lockstep']
    assert asks_for_real_time(words[:2])
    assert not asks_for_real_time(words)


def chosen(arguments, **environment):
    choose_transport(arguments, environment)
    return environment


REAL_TIME = ['-p', 'timekeeping:=realtime']


def test_lock_step_keeps_to_this_machine_and_to_what_the_user_says():
    environment = chosen([])
    settings = Path(environment[PROFILES]).read_text()
    assert '<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>' in settings
    assert '<type>SHM</type>' in settings
    assert '<useBuiltinTransports>false' in settings
    assert environment[DISCOVERY] == 'SYSTEM_DEFAULT'
    assert chosen([], **{DISCOVERY: 'SUBNET'}) == {DISCOVERY: 'SUBNET'}


def test_real_time_on_this_machine_has_settings_without_shared_memory():
    environment = chosen(REAL_TIME)
    settings = Path(environment[PROFILES]).read_text()
    assert '127.0.0.1' in settings
    assert 'SHM' not in settings
    assert '<useBuiltinTransports>false' in settings
    assert environment[DISCOVERY] == 'SYSTEM_DEFAULT'


def test_real_time_over_the_network_keeps_to_udp():
    environment = chosen(REAL_TIME, **{DISCOVERY: 'SUBNET'})
    assert environment == {DISCOVERY: 'SUBNET', BUILTIN_TRANSPORTS: 'UDPv4'}


def test_settings_of_the_user_stay():
    environment = chosen(REAL_TIME, **{PROFILES: 'mine.xml'})
    assert environment == {PROFILES: 'mine.xml', DISCOVERY: 'LOCALHOST'}
