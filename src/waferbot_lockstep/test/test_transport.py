# SPDX-License-Identifier: Apache-2.0
"""Whom a node talks to, and how, as far as the user has not said."""

from pathlib import Path

from waferbot_lockstep.transport import (
    BUILTIN_TRANSPORTS,
    DISCOVERY,
    PROFILES,
    choose_transport,
)


def chosen(**environment):
    choose_transport(environment)
    return environment


def test_nodes_keep_to_the_loopback_interface_and_to_udp():
    environment = chosen()
    settings = Path(environment[PROFILES]).read_text()
    assert '<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>' in settings
    assert '<useBuiltinTransports>false' in settings
    assert 'SHM' not in settings
    assert environment[DISCOVERY] == 'SYSTEM_DEFAULT'


def test_over_the_network_nodes_keep_to_udp():
    environment = chosen(**{DISCOVERY: 'SUBNET'})
    settings = Path(environment.pop(PROFILES)).read_text()
    assert environment == {DISCOVERY: 'SUBNET', BUILTIN_TRANSPORTS: 'UDPv4'}
    assert 'interfaceWhiteList' not in settings


def test_a_child_keeps_what_its_parent_chose():
    for parent in (chosen(), chosen(**{DISCOVERY: 'SUBNET'})):
        assert chosen(**parent) == parent


def test_who_opens_the_network_after_having_kept_to_this_machine_gets_it():
    assert chosen(**{**chosen(), DISCOVERY: 'SUBNET'}) == chosen(**{DISCOVERY: 'SUBNET'})


def test_settings_of_the_user_stay():
    environment = chosen(**{PROFILES: 'mine.xml'})
    assert environment == {PROFILES: 'mine.xml', DISCOVERY: 'LOCALHOST'}
