# SPDX-License-Identifier: Apache-2.0
"""
The same machine, prepared so that effects can be switched on without compiling it anew.

What makes two machines differ in memory is the number of coordinates, springs, cables and
frictions. `host` gives every connection that is rigid its coordinate back, held, and adds an empty
slot for each friction of the library. Nothing moves differently, but for rounding; a tick takes
longer. As long as no effect has let one go, `compact` takes the held connections out again.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import assemble
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine
from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.variant import Itself, Overlay, Variant, with_rigid


def host(variant: Variant) -> Variant:
    """Return a variant with the same motion that has room for the effects of the library."""
    description = variant.description
    machine: dict[str, Any] = {
        'connections': {
            name: {'state': 'held'}
            for name, part in description.connections.items()
            if not part.flexible and not part.held
        },
        'frictions': {},
        'dampers': {},
    }
    for axis in places.motor_axes(variant):
        dry, viscous = frictions.slots_of(variant, axis)
        for effect in dry:
            if f'{axis}_{effect}' not in description.frictions:
                machine['frictions'] |= frictions.slot(variant, axis, effect, [0.0], [0.0])[
                    'frictions'
                ]
        for effect in viscous:
            if f'{axis}_{effect}' not in description.dampers:
                machine['dampers'] |= frictions.damper(variant, axis, effect, 0.0)['dampers']
    roomy = variant.with_overlay(Overlay({name: part for name, part in machine.items() if part}))
    return replace(roomy, origin=None)


def compact(variant: Variant) -> Description:
    """
    Return a variant's machine with its held connections rigid, if none of those of its host was let go.

    It moves alike, in fewer coordinates. That of one that lets go of anything is returned as it is: not
    to compile a machine for every choice of what gives.
    """
    held = _held(variant)
    if not held or held != _held(variant.base):
        return variant.description
    return with_rigid(variant.description, held)


def built(variant: Variant, timing: Timing) -> Machine:
    """Return the machine of a variant, compact; the last few are kept: a variant meets several logs."""
    return _built(Itself(variant), timing)


@functools.lru_cache(maxsize=4)
def _built(variant: Itself, timing: Timing) -> Machine:
    description = compact(variant.variant)
    return Machine(description, assemble(description), timing)


def _held(variant: Variant) -> list[str]:
    connections = variant.machine.get('connections', {})
    return [name for name, entry in connections.items() if entry.get('state') == 'held']
