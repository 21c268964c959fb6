# SPDX-License-Identifier: Apache-2.0
"""
The library of effects: physical causes that a nominal model leaves out or has wrong.

Each module of this package that has a constant `EFFECT` is one effect, and has its name. Adding an
effect is adding such a file; nothing else lists them.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Mapping

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.effects.effect import Effect


@functools.cache
def library() -> Mapping[str, Effect]:
    """Return every effect by its name, in alphabetical order."""
    found = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda item: item.name):
        effect = getattr(importlib.import_module(f'{__name__}.{module.name}'), 'EFFECT', None)
        if effect is None:
            continue
        if effect.name != module.name:
            raise RuntimeError(f'effect {effect.name!r} is in the file {module.name}.py')
        found[effect.name] = effect
    return found


def find(name: str) -> Effect:
    """Return an effect by its name; raises `UserError` that proposes a similar one."""
    known = library()
    if name not in known:
        raise UserError(
            f'there is no effect {name!r}{did_you_mean(name, known)} '
            f'(see `waferbot synthesize --list`; there are {len(known)})'
        )
    return known[name]
