# SPDX-License-Identifier: Apache-2.0
"""
YAML that remembers where every key stands, so that an error can name file, line and key.

Every file that a user writes is read through here: machine descriptions, models, experiments,
settings. It is YAML's safe subset, with five differences:

- `1e-3` is a number, as in YAML 1.2 (YAML 1.1 takes it for text);
- a key given twice is an error, not a silent replacement;
- aliases (`*name`) are refused: they can expand without bound, and would blur whose line it was;
- a key is a plain word, and nesting has a bound;
- whole numbers have one too.
"""

from __future__ import annotations

import contextlib
import pickle
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from waferbot_lockstep.errors import UserError

SAFE_DUMPER: Any = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
"""
Writes plain data. That of libyaml, where it is there, takes a fifth of the time; its text may differ (of
an empty key), the data that are read from it do not.
"""

LARGEST = 2**64
"""Whole numbers beyond it are refused: no setting needs them, and arithmetic would fail on them."""

Key = tuple[Any, ...]
"""Path of a value in a document: keys and list places from the root."""


class _WithoutAliases(Composer):
    """Composes nodes out of a parser's events; an alias is refused."""

    check_event: Any  # of the parser beside it
    peek_event: Any

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise UserError(
                f'{mark.name}, line {mark.line + 1}: aliases (*name) are not used here; '
                'write the value out'
            )
        return super().compose_node(parent, index)


class _Loader(_WithoutAliases, yaml.SafeLoader):
    """YAML's safe loader with the differences that the module tells."""


_LOADERS: list[type[Any]] = [_Loader]
"""Those that read a text in turn, until one takes it. What the last one says of it is told."""

if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _FastLoader(_WithoutAliases, CParser, SafeConstructor, Resolver):
        """The same with the scanner of libyaml, which takes a quarter of the time."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

    _LOADERS.insert(0, _FastLoader)

for _loader in _LOADERS:
    _loader.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'^[-+]?(\d[\d_]*(\.[\d_]*)?|\.\d[\d_]*)[eE][-+]?\d+$'),
        list('-+.0123456789'),
    )


@dataclass
class Document:
    """
    What was read: plain `data`, and for every key (file, line from 1) where it stands.

    `places` always has the root `()`. Several files may have gone into one document; see `merge`.
    """

    data: Any
    places: dict[Key, tuple[str, int]] = field(default_factory=dict)

    def place(self, key: Key = ()) -> str:
        """Return `file, line n` of a key, or of the nearest thing around it."""
        for length in range(len(key), -1, -1):
            if key[:length] in self.places:
                source, line = self.places[key[:length]]
                return f'{source}, line {line}'
        return 'text'

    def where(self, key: Key) -> str:
        """Return `file, line n: a.b[2].c` for a key."""
        return f'{self.place(key)}: {key_text(key)}' if key else self.place()

    def error(self, key: Key, message: str) -> UserError:
        """Return the error for the user: where it is, then what is wrong."""
        return UserError(f'{self.where(key)}: {message}')


def key_text(key: Key) -> str:
    """Return a key as text: `motion.y_linear.kind`, `program[2].dwell_s`."""
    text = ''
    for part in key:
        text += f'[{part}]' if isinstance(part, int) else f'.{part}' if text else str(part)
    return text


def read(path: Path) -> Document:
    """Read one file whose root is a mapping (or nothing); raises `UserError`."""
    try:
        text = path.read_text(encoding='utf-8')
    except OSError as error:
        raise UserError(f'{path}: cannot be read ({error.strerror})') from None
    except UnicodeDecodeError as error:
        raise UserError(f'{path}: is not UTF-8 text ({error.reason})') from None
    document = parse(text, str(path))
    if document.data is None:
        document.data = {}
    if not isinstance(document.data, dict):
        raise UserError(f'{path}, line 1: must be a mapping of keys to values')
    return document


def parse(text: str, source: str) -> Document:
    """
    Read one document from `text`; `source` stands for the file in messages.

    Raises `UserError` with source and line for text that is no YAML, a key given twice, an alias,
    or a tag that plain data does not have. Empty text is the document None.
    """
    document: Document = pickle.loads(_parsed(text, source))
    return document


@lru_cache(maxsize=32)
def _parsed(text: str, source: str) -> bytes:
    """
    Return the document in `text`, pickled: each caller gets one of its own, which it may change.

    A run reads the description of its machine three times; a copy takes a tenth of the time.
    """
    for loader in _LOADERS[:-1]:
        with contextlib.suppress(UserError, yaml.YAMLError, ValueError, RecursionError):
            return pickle.dumps(_document(loader(text), source))
    try:
        return pickle.dumps(_document(_LOADERS[-1](text), source))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f', line {mark.line + 1}, column {mark.column + 1}' if mark else ''
        problem = error.problem or error.context
        raise UserError(f'{source}{place}: not valid YAML: {problem}') from None
    except RecursionError:
        raise UserError(f'{source}: nested too deeply') from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2000-99-99
        raise UserError(f'{source}: not valid YAML: {" ".join(str(error).split())}') from None


def _document(loader: Any, source: str) -> Document:
    """Return what a loader reads; `source` is for its messages."""
    places: dict[Key, tuple[str, int]] = {(): (source, 1)}
    loader.name = source
    node = loader.get_single_node()
    if node is None:
        return Document(None, places)
    _mark(loader, node, (), source, places)
    return Document(loader.construct_document(node), places)


def _mark(
    loader: Any,
    node: yaml.Node,
    key: Key,
    source: str,
    places: dict[Key, tuple[str, int]],
) -> None:
    """Note the line of every key and list item below `node`; refuse a key given twice."""
    if isinstance(node, yaml.MappingNode):
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise UserError(f'{source}, line {line}: a key must be a plain word')
            name = loader.construct_object(key_node)
            if not isinstance(name, str):
                raise UserError(
                    f'{source}, line {line}: a key must be a plain word; {key_node.value!r} is read as '
                    f'{name!r}. Put it in quotes if it is meant as a word'
                )
            inner = (*key, name)
            if inner in places:
                raise UserError(
                    f'{source}, line {line}: {key_text(inner)} is given twice, '
                    f'first on line {places[inner][1]}'
                )
            places[inner] = source, line
            _mark(loader, value_node, inner, source, places)
    elif isinstance(node, yaml.SequenceNode):
        for place, item in enumerate(node.value):
            entry = (*key, place)
            places[entry] = source, item.start_mark.line + 1
            _mark(loader, item, entry, source, places)
    elif node.tag == 'tag:yaml.org,2002:int' and abs(loader.construct_object(node)) > LARGEST:
        line = node.start_mark.line + 1
        raise UserError(f'{source}, line {line}: {key_text(key)}: {node.value[:20]} is too large')


def first_complaint(errors: Iterable[Any]) -> Any:
    """
    Return the error of a JSON schema to tell first, None if there is none.

    The outermost. Of those of one mapping a key that is not known comes before one that is missing:
    the former is often the latter, misspelt.
    """
    return min(
        errors,
        key=lambda found: (
            len(found.absolute_path), found.validator == 'required', str(found.path),
        ),
        default=None,
    )  # fmt: skip


def merge(base: Document, overlay: Document) -> None:
    """
    Lay `overlay` over `base`: mappings are merged key by key, anything else is replaced.

    A mapping with the key `from` is one value with its provenance, and is replaced whole: where it
    came from does not hold for another value.

    A value of `null` in the overlay takes the key away; it must be there, else `UserError`. Places
    of replaced values are the overlay's. The root of both is a mapping.
    """
    replaced: list[Key] = []
    base.data = _merged(base.data, overlay, (), overlay.data, replaced)
    for inner in replaced:
        for place, where in overlay.places.items():
            if place[: len(inner)] == inner:
                base.places[place] = where


def merged(base: Mapping[Any, Any], overlay: Mapping[Any, Any], where: str) -> dict[Any, Any]:
    """
    Return plain data with `overlay` laid over it by the rules of `merge`; both stay as they are.

    What the overlay does not touch is shared with `base`, not copied. `where` is for messages.
    """
    return _merged(base, Document(overlay, {(): (where, 1)}), (), overlay, [])


def _merged(
    below: Mapping[Any, Any],
    overlay: Document,
    key: Key,
    above: Mapping[Any, Any],
    replaced: list[Key],
) -> dict[Any, Any]:
    """Return `above`, the part of `overlay` at `key`, laid over `below`; note what it replaces."""
    result = dict(below)
    for part, value in above.items():
        inner = (*key, part)
        old = result.get(part)
        if isinstance(value, dict) and isinstance(old, dict) and 'from' not in old:
            result[part] = _merged(old, overlay, inner, value, replaced)
            continue
        if value is None:
            if part not in result:
                raise overlay.error(inner, 'there is nothing of this name to take away')
            del result[part]
        else:
            result[part] = value
        replaced.append(inner)
    return result
