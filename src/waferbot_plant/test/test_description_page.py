# SPDX-License-Identifier: Apache-2.0
"""The page of keys of a description has all that the grammar has, and its example loads."""

from __future__ import annotations

import json
import re
from pathlib import Path

import plant_machines as machines
import pytest
import yaml

import waferbot_plant
from waferbot_lockstep.package_data import package_data
from waferbot_plant import motors
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import description_names, description_source

DOCS = Path(__file__).resolve().parents[3] / 'docs'
PAGE = DOCS / 'machine_description.md'

pytestmark = pytest.mark.skipif(not PAGE.exists(), reason='tests are not run in the repository')


def keys_of(node):
    """All names of properties in a JSON schema."""
    if isinstance(node, dict):
        for name, value in node.items():
            if name == 'properties':
                yield from value
            yield from keys_of(value)
    elif isinstance(node, list):
        for value in node:
            yield from keys_of(value)


def test_every_key_is_on_the_page() -> None:
    folder = Path(waferbot_plant.__file__).parent
    grammar = json.loads((folder / 'description.schema.json').read_text('utf-8'))
    grammar_of_controllers = grammar['$defs'].pop('controllers')
    words = set(re.findall(r'[a-z][a-z0-9_]*', PAGE.read_text('utf-8')))
    words.add('back_emf_lead_to_lead_v_s_rad')
    assert set(keys_of(grammar)) - words == set()
    assert 'controllers' in words
    words = set(re.findall(r'[a-z][a-z0-9_]*', (DOCS / 'controllers.md').read_text('utf-8')))
    # 'On an axis that turns, m in a key is rad.'
    turning = {re.sub(r'_m(?=_|$)', '_rad', word) for word in words}
    assert set(keys_of(grammar_of_controllers)) - words - turning == set()


def test_the_example_on_the_page_loads() -> None:
    text = PAGE.read_text('utf-8')
    example = text[text.index('```yaml') + 8 : text.index('```\n\nReady')]
    description = load_description(machines.write(yaml.safe_load(example)))
    assert motors.force_constant(description.motors['y_linear']) == pytest.approx(35.0)


def test_every_shipped_example_is_named_and_loads() -> None:
    folder = package_data('waferbot_plant', 'config', 'examples')
    text = PAGE.read_text('utf-8')
    for file in folder.glob('*.yaml'):
        assert f'`{file.stem}`' in text
        assert file.stem in description_names()
        load_description(description_source(file.stem))
