# SPDX-License-Identifier: Apache-2.0
"""
How much room the parts of a machine have in memory.

Code is compiled for arrays of certain lengths. If those were a machine's own numbers of links,
coordinates, springs, cables and frictions, each change of a description would be compiled for half a
minute. So arrays have room for more, in steps, and the numbers in use are parameters: all machines
that fit into the first step of each, as those that come with the package do, share one compiled code.
Places for axes and encoders are as many as a machine has; another number of them is compiled anew.
Loops end at what is in use; what is beyond is zero and costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

STEPS = {'links': 24, 'coordinates': 20, 'springs': 24, 'cables': 4, 'frictions': 16}
"""
By how many the room of each grows. The full machine of the thesis has 14 links, 15 coordinates, 13
springs and dampers, a cable and 6 frictions.
"""

PARAMETER_FIELDS: list[tuple] = [(part, 'i8') for part in STEPS]
"""Numbers in use."""


def lengths(in_use: Mapping[str, int]) -> dict[str, int]:
    """Return the lengths of arrays with room for the numbers in use: whole steps, one at least."""
    return {part: step * max(1, -(-in_use[part] // step)) for part, step in STEPS.items()}
