# SPDX-License-Identifier: Apache-2.0
"""YAML with places: what is read, what is refused, and who is blamed."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from waferbot_lockstep import marked_yaml
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import SAFE_DUMPER, key_text, merge, parse, read

PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text('abcdefgh xyz', max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text('abcxyz', min_size=1), inner)
    ),
    max_leaves=12,
)


@given(PLAIN)
def test_reads_what_yaml_wrote(data: object) -> None:
    # the writer must not use aliases for equal objects, which is no matter of meaning
    dumper = type('Dumper', (yaml.SafeDumper,), {'ignore_aliases': lambda self, data: True})
    assert parse(yaml.dump(data, Dumper=dumper), 'x').data == data


@pytest.mark.parametrize(
    ('text', 'number'),
    [
        ('1e-3', 1e-3), ('1.0e+7', 1e7), ('.5', 0.5), ('3', 3), ('-2E5', -2e5), ('.5e1', 5.0),
        ('1.e2', 100.0), ('+1e3', 1000.0), ('1_000e0', 1000.0), ('0x10', 16),
    ],
)  # fmt: skip
def test_numbers_in_every_spelling(text: str, number: float) -> None:
    found = parse(f'a: {text}', 'x').data['a']
    assert found == number
    assert isinstance(found, (int, float))
    assert type(parse('a: 3', 'x').data['a']) is int


def test_words_that_look_like_numbers_stay_words() -> None:
    data = parse("a: e5\nb: '1e3'\nc: 1e\nd: 0.1 m", 'x').data
    assert data == {'a': 'e5', 'b': '1e3', 'c': '1e', 'd': '0.1 m'}
    assert math.isinf(parse('a: .inf', 'x').data['a'])


def test_places_of_keys_and_items() -> None:
    document = parse('a: 1\nb:\n  - 2\n  - c: 3\n    d: [4,\n      5]\n', 'file.yaml')
    assert document.where(('b', 1, 'd')) == 'file.yaml, line 5: b[1].d'
    assert document.where(('b', 1, 'd', 1)) == 'file.yaml, line 6: b[1].d[1]'
    assert document.where(('b', 1, 'missing')) == 'file.yaml, line 4: b[1].missing'
    assert document.where(()) == 'file.yaml, line 1'
    assert str(document.error(('a',), 'is odd')) == 'file.yaml, line 1: a: is odd'
    assert key_text(('a', 0, 1, 'b')) == 'a[0][1].b'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: 1\nb: 2\na: 3', 'x, line 3: a is given twice, first on line 1'),
        ('a:\n  b: 1\n  "b": 2', r'x, line 3: a\.b is given twice, first on line 2'),
        ('a: &n 1\nb: *n', r'x, line 2: aliases \(\*name\) are not used here'),
        ('a: [1, 2\nb: 3', 'x, line 2, column 2: not valid YAML'),
        ('a: !!python/object:os.system 1', 'x, line 1.*not valid YAML'),
        ('? [a, b]\n: 1', 'x, line 1: a key must be a plain word'),
        ('a: 2000-99-99', 'x: not valid YAML: month must be in'),
        ('a: ' + '[' * 3000 + ']' * 3000, 'x: nested too deeply'),
        ('--- 1\n--- 2', 'x, line 2'),
        ('a: \x00', 'x: not valid YAML'),
    ],
)
def test_what_is_refused(text: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        parse(text, 'x')
    assert '\n' not in str(caught.value)


def test_a_bomb_of_aliases_is_refused_before_it_expands() -> None:
    lines = ['a0: &a0 [x, x]']
    lines += [f'a{n}: &a{n} [*a{n - 1}, *a{n - 1}]' for n in range(1, 40)]
    with pytest.raises(UserError, match='x, line 2: aliases'):
        parse('\n'.join(lines), 'x')


def test_files(tmp_path: Path) -> None:
    path = tmp_path / 'm.yaml'
    path.write_text('')
    assert read(path).data == {}
    path.write_text('- 1\n')
    with pytest.raises(UserError, match=r'm\.yaml, line 1: must be a mapping'):
        read(path)
    path.write_bytes(b'a: \xff')
    with pytest.raises(UserError, match='is not UTF-8 text'):
        read(path)
    with pytest.raises(UserError, match='cannot be read'):
        read(tmp_path / 'none.yaml')
    with pytest.raises(UserError, match='cannot be read'):
        read(tmp_path)
    assert parse('', 'x').data is None


def test_overlay_replaces_removes_and_takes_the_blame() -> None:
    base = parse('a: {b: 1, c: 2}\nd: [1, 2]\ne: 5', 'base')
    merge(base, parse('\na:\n  b: 10\n  f: {g: 1}\nd: [3]\ne: null', 'over'))
    assert base.data == {'a': {'b': 10, 'c': 2, 'f': {'g': 1}}, 'd': [3]}
    sourced = parse('m: {value: {x: 1}, from: thesis}\nn: {value: 1, from: thesis}', 'base')
    merge(sourced, parse('m: {x: 2}\nn: {value: 3}', 'over'))
    assert sourced.data == {'m': {'x': 2}, 'n': {'value': 3}}
    with pytest.raises(UserError, match=r'over, line 1: a\.q: there is nothing of this name'):
        merge(base, parse('a: {q: null}', 'over'))
    assert base.where(('a', 'b')) == 'over, line 3: a.b'
    assert base.where(('a', 'f', 'g')) == 'over, line 4: a.f.g'
    assert base.where(('a', 'c')) == 'base, line 1: a.c'
    assert base.where(('d', 0)) == 'over, line 5: d[0]'


def test_whoever_reads_the_same_text_again_gets_a_document_of_their_own():
    one, other = parse('a: {b: [1, 2]}', 'x'), parse('a: {b: [1, 2]}', 'x')
    one.data['a']['b'].append(3)
    one.places.clear()
    assert other.data == {'a': {'b': [1, 2]}}
    assert other.where(('a', 'b')) == 'x, line 1: a.b'
    assert parse('a: {b: [1, 2]}', 'y').where(('a', 'b')) == 'y, line 1: a.b'


def test_a_file_that_was_changed_is_read_anew(tmp_path):
    file = tmp_path / 'x.yaml'
    for value in (1, 2):
        file.write_text(f'a: {value}\n', 'utf-8')
        assert read(file).data == {'a': value}


SHIPPED = sorted(
    file
    for folder in ('config', 'experiments')
    for file in Path(__file__).parents[2].glob(f'waferbot_*/waferbot_*/{folder}/**/*.yaml')
)


@pytest.mark.parametrize('file', SHIPPED, ids=lambda file: file.name)
def test_with_and_without_libyaml_a_file_is_read_and_written_alike(file, monkeypatch):
    text = file.read_text('utf-8')
    monkeypatch.setattr(marked_yaml, '_LOADERS', marked_yaml._LOADERS[-1:])
    slow = marked_yaml._parsed.__wrapped__(text, file.name)
    monkeypatch.undo()
    assert marked_yaml._parsed.__wrapped__(text, file.name) == slow
    data = parse(text, file.name).data
    fast = yaml.dump(data, Dumper=SAFE_DUMPER, sort_keys=False)
    assert fast == yaml.safe_dump(data, sort_keys=False)


@given(PLAIN)
def test_what_is_written_with_libyaml_is_read_as_the_same_data(value):
    text = yaml.dump({'a': value}, Dumper=SAFE_DUMPER, sort_keys=False)
    assert yaml.safe_load(text) == {'a': value}


@given(PLAIN)
def test_with_and_without_libyaml_any_text_is_read_alike(value):
    text = yaml.safe_dump({'a': value})
    document = marked_yaml._document(marked_yaml._LOADERS[-1](text), 'x')
    assert parse(text, 'x') == document
