# SPDX-License-Identifier: Apache-2.0
"""No damaged input of any kind brings a traceback; `make bench-fuzz` tries many more."""

from __future__ import annotations

import pytest
from fuzzing.categories import CATEGORIES, tracebacks

SEED = 20261125
COUNT = 300

pytestmark = [pytest.mark.slow, pytest.mark.long(150)]


@pytest.mark.parametrize('name', CATEGORIES)
def test_damaged_input_is_used_or_refused(name, tmp_path):
    folder = tmp_path / 'fuzz'
    folder.mkdir()
    found = list(tracebacks(CATEGORIES[name], COUNT, SEED, folder))
    print(f'{COUNT} inputs of seed {SEED}')
    assert not found, f'seed {SEED}, {len(found)} tracebacks; the first: {found[0]}'
