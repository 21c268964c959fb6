# SPDX-License-Identifier: Apache-2.0
"""
What a supplier's data sheet says about a part, and the stiffness, damping and friction it makes.

One module for each kind of part, after chapter 5 of the thesis. Part data are frozen dataclasses
that check themselves; the equations are pure functions of floats, in SI units, that run once when
a description is loaded. Nothing here knows of the simulation; `part_library` builds the parts that
a description names.

Axes are those of the base frame at the zero pose: x out of the guide plane towards the payload,
y up, z along the horizontal spacing of the guides.
"""
