# SPDX-License-Identifier: Apache-2.0
"""YAML that remembers the line of every key, so that an error can say where it is."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import yaml

from waferbot_lockstep.errors import UserError

Path = tuple[str | int, ...]


class _Loader(yaml.SafeLoader):
    """
    Safe loader that also reads 1e7 and 2.5e-4 as numbers, as YAML 1.2 does.

    It takes plain mappings, lists and scalars: no aliases, which could expand without bound.
    """

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.MarkedYAMLError(
                problem='aliases (*name) are not used here', problem_mark=mark
            )
        return super().compose_node(parent, index)


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)


@dataclass(frozen=True)
class MarkedYaml:
    """
    A YAML document: its data, and the line (from 1) of every key and list item by its path.

    `source` is the file's name, for messages.
    """

    source: str
    data: Any
    lines: dict[Path, int]

    def where(self, path: Path) -> str:
        """Return `file, line n: key.key` for the path, or for the nearest thing around it."""
        known = path
        while known and known not in self.lines:
            known = known[:-1]
        place = f'{self.source}, line {self.lines.get(known, 1)}'
        return f'{place}: {key_text(path)}' if path else place


def key_text(path: Path) -> str:
    """Return a path as text: `motion.y_linear.kind`, `program[2].dwell_s`."""
    text = ''
    for key in path:
        text += f'[{key}]' if isinstance(key, int) else f'.{key}' if text else str(key)
    return text


def parse(text: str, source: str) -> MarkedYaml:
    """
    Parse one YAML document.

    Raises `UserError` with source and line for text that is no YAML, a key given twice, or a tag
    that plain data does not have.
    """
    lines: dict[Path, int] = {}
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is not None:
            _mark(loader, node, (), lines, source)
        data = loader.construct_document(node) if node is not None else None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f', line {mark.line + 1}, column {mark.column + 1}' if mark else ''
        raise UserError(f'{source}{place}: {error.problem or error.context}') from error
    except RecursionError as error:
        raise UserError(f'{source}: nested too deeply') from error
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2000-99-99
        raise UserError(f'{source}: {" ".join(str(error).split())}') from error
    return MarkedYaml(source, data, lines)


def _mark(
    loader: _Loader, node: yaml.Node, path: Path, lines: dict[Path, int], source: str
) -> None:
    if isinstance(node, yaml.MappingNode):
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise UserError(f'{source}, line {line}: a key must be a plain word')
            key = loader.construct_object(key_node)
            inner = (*path, key)
            if inner in lines:
                raise UserError(
                    f'{source}, line {line}: {key_text(inner)} was given before, '
                    f'on line {lines[inner]}'
                )
            lines[inner] = line
            _mark(loader, value_node, inner, lines, source)
    elif isinstance(node, yaml.SequenceNode):
        for place, item in enumerate(node.value):
            lines[(*path, place)] = item.start_mark.line + 1
            _mark(loader, item, (*path, place), lines, source)
