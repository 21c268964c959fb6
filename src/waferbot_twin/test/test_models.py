# SPDX-License-Identifier: Apache-2.0
"""Models: shipped ones load; mistakes in a file are told with file, line and key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import parse
from waferbot_twin.models import NODES, load_model, model_names


@pytest.mark.parametrize('name', model_names())
def test_shipped_model_holds_the_settings_of_all_nodes(name: str) -> None:
    model = load_model(name)
    assert set(model.parameters) == set(NODES)
    assert all(model.parameters[node] for node in NODES)
    again = parse(model.text, 'text').data  # plain YAML, without aliases
    assert {key.rsplit('/', 1)[-1]: value['ros__parameters'] for key, value in again.items()} == (
        model.parameters
    )


def test_model_is_laid_over_the_settings_of_the_packages(tmp_path: Path) -> None:
    path = tmp_path / 'own.yaml'
    path.write_text('/**/pmac:\n  ros__parameters:\n    y_linear: {Ixx30: 1e3}\n')
    model, shipped = load_model(str(path)), load_model('rigid')
    assert model.name == 'own'
    changed = model.parameters['pmac']['y_linear']
    assert changed['Ixx30'] == 1000.0
    assert changed['Ixx31'] == shipped.parameters['pmac']['y_linear']['Ixx31']
    assert model.parameters['copley'] == shipped.parameters['copley']


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            '/**/plnt:\n  ros__parameters: {}',
            "own.yaml, line 1: section '/**/plnt' is for no node",
        ),
        ('\n/**/plant:\n  parameters: {}', 'own.yaml, line 2: section'),
        ('plant:\n  ros__parameters: 5', 'line 2: plant.ros__parameters: must be a mapping'),
        ('plant:\n  ros__parameters: {}\nplant: {}', 'line 3: plant is given twice'),
        ('plant: [1', 'not valid YAML'),
        (
            'plant:\n  ros__parameters: {descripton: flexible}',
            "line 2: plant.ros__parameters.descripton: plant has no such parameter; did you mean 'desc",
        ),
        (
            'pmac:\n  ros__parameters:\n    y_linear:\n      Ixx3O: 5',
            "line 4: pmac.ros__parameters.y_linear.Ixx3O: pmac has no setting 'Ixx3O' of an axis; did",
        ),
        (
            'pmac:\n  ros__parameters: {y_linear.Ixx3O: 5}',
            'line 2: pmac.ros__parameters.y_linear.Ixx3O',
        ),
        ('pmac: {ros__parameters: {y_liner: {}}}', "did you mean 'y_linear'?"),
        ('copley: {ros__parameters: {y_linear: {bus_volts: 48}}}', "did you mean 'bus_voltage'?"),
        ('copley: {ros__parameters: {y_linear: 48}}', 'must be a mapping of names to values'),
        ('- plant', 'line 1: must be a mapping'),
        ('/**/pmak: {ros__parameters: {}}', "did you mean 'pmac'?"),
        (
            'descripton: flexible',
            "did you mean 'description'? It stands below /**/plant: ros__parameters:",
        ),
        ('damping: improved', 'copley); It stands below /**/plant: ros__parameters:'),
        (
            'name: mine\nbodies: {}\njoints: {}',
            'line 1: this describes a machine alone; a model says which one with',
        ),
    ],
)
def test_mistakes_are_told_with_file_and_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'own.yaml'
    path.write_text(text)
    with pytest.raises(UserError, match=re.escape(message)) as caught:
        load_model(str(path))
    assert '\n' not in str(caught.value)


def test_a_dotted_name_is_the_same_as_a_mapping(tmp_path: Path) -> None:
    path = tmp_path / 'own.yaml'
    path.write_text('/**/pmac:\n  ros__parameters: {y_linear.Ixx30: 1234, y_linear: {Ixx31: 7}}\n')
    changed = load_model(str(path)).parameters['pmac']['y_linear']
    assert (changed['Ixx30'], changed['Ixx31']) == (1234, 7)


def test_what_every_node_has_may_stand_in_a_model(tmp_path: Path) -> None:
    path = tmp_path / 'own.yaml'
    path.write_text('plant: {ros__parameters: {peer_timeout_s: 9.0, realtime_factor: 0.5}}\n')
    assert load_model(str(path)).parameters['plant']['peer_timeout_s'] == 9.0


def test_unknown_model_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UserError, match=r"did you mean 'rigid'.*flexible"):
        load_model('rigit')
