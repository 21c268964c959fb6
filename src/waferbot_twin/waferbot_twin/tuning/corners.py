# SPDX-License-Identifier: Apache-2.0
"""
Machines at the corners of a range: what the same gains must suit if parameters are known to a range.

Of n parameters between low_i and high_i these are the 2^n machines with every one at one of its ends.
A margin that falls towards the middle of a range is not seen there.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.named_parameters import at_path
from waferbot_twin.library.entries import load
from waferbot_twin.library.ranges import seen
from waferbot_twin.sweep.variation import Variation, overlaid, parse_variations

MOST = 4
"""Parameters: 16 machines."""


def ranges(texts: Sequence[str], library: Path | None, variant: Variant) -> tuple[Variation, ...]:
    """
    Return the parameters that `PATH=low:high` names, or `PATH` alone with the range of a library.

    Raises `UserError` for a path that leads nowhere, and for one of which no range is known.
    """
    if not texts:
        return ()
    if len(texts) > MOST:
        raise UserError(f'--vary is given {len(texts)} times; at most {MOST} ranges have corners')
    entries = () if library is None else load(library)
    whole = []
    for text in texts:
        if '=' in text:
            whole.append(text)
            continue
        parameter = at_path(text.strip(), variant)
        known = seen(entries, parameter)
        if known is None:
            where = 'no --library is given' if library is None else f'{library} has nothing of it'
            raise UserError(f'--vary {text}: give PATH=low:high; {where}')
        low, high = max(known[0], parameter.low), min(known[1], parameter.high)
        if not low < high:
            raise UserError(
                f'--vary {text}: give PATH=low:high; {library} has one value of it, {low:g}'
            )
        whole.append(f'{text}={low!r}:{high!r}')
    return parse_variations(whole, variant)


def corners(variant: Variant, variations: Sequence[Variation]) -> list[Variant]:
    """Return the model at all combinations of ends, each with a name that says where it is."""
    parameters = [one.parameter for one in variations]
    found = []
    for ends in itertools.product(*((one.low, one.high) for one in variations)):
        if not ends:
            return []
        values = ', '.join(
            f'{one.path.partition(".")[2]} {end:.4g}'
            for one, end in zip(variations, ends, strict=True)
        )
        machine = overlaid(variant, parameters, np.array(ends))
        found.append(replace(machine, name=f'{variant.name}: {values}'))
    return found
