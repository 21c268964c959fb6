# SPDX-License-Identifier: Apache-2.0
"""
The payload (wafer) frame: where it is, how it moves, and what the machine's give does to it.

Frame 4 of the thesis (2.9, 2.12, 2.13, 2.17), in any tree of bodies: a point r fixed to a link with the
twist (w, v_O) and the spatial acceleration (alpha, a_O), both about the base origin:

    v = v_O + w x r        a = a_O + alpha x r + w x v

The error from flexibility is the distance to where r would be with the coordinates of the axes as they
are and all that gives at rest in the home pose; the tilt is the rotation vector between the two. It is
what no encoder sees. Of a rigid machine both are zero. All in the base frame (y up).
"""

from __future__ import annotations

import math

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_plant.multibody import place_links

WIDTH = 22
"""Values: position, quaternion (x, y, z, w), velocity, angular velocity, acceleration, error, tilt."""


def parameter_fields(axes: int) -> list[tuple]:
    """
    Return the parameters of the frame, of a machine with room for so many axes.

    Place of the link from 1, 0 for none; of the frame from the link's point at home, m; the coordinates
    of the axes, -1 where there is none.
    """
    return [
        ('payload_link', 'i8'),
        ('payload_offset', 'f8', (3,)),
        ('payload_axes', 'i8', (axes,)),
    ]


@compiled
def payload_frame(s, p, row):
    """Fill `row` (WIDTH,) with the payload frame at the present state; zero where there is none."""
    row[:] = 0.0
    link = p['payload_link']
    if link == 0:
        return
    position = s['position']
    still = np.zeros(len(position))
    held = np.zeros(len(position))
    for axis in range(len(p['payload_axes'])):
        coordinate = p['payload_axes'][axis]
        if coordinate >= 0:
            held[coordinate] = position[coordinate]
    point, turned = np.zeros(3), np.zeros(9)
    place_links(s, p, held, still)
    _locate(s, p, link, row[:3])
    for entry in range(9):
        turned[entry] = s['rotation'][link, entry]
    for entry in range(3):
        point[entry] = row[entry]
    place_links(s, p, position, s['velocity'])
    _locate(s, p, link, row[:3])
    for entry in range(3):
        row[16 + entry] = row[entry] - point[entry]
    _quaternion(s['rotation'][link], row[3:7])
    _tilt(s['rotation'][link], turned, row[19:22])
    twist = s['twist'][link]
    _cross(twist[:3], row[:3], row[7:10])
    for entry in range(3):
        row[7 + entry] += twist[3 + entry]
        row[10 + entry] = twist[entry]
    acceleration = np.zeros(6)
    for entry in range(6):
        acceleration[entry] = s['drift'][link, entry]
        if entry > 2:
            acceleration[entry] += p['gravity'][entry - 3]
    above = link
    while above > 0:
        coordinate = p['coordinate'][above - 1]
        rate = p['ratio'][above - 1] * s['velocity_change'][coordinate] / p['step']
        for entry in range(6):
            acceleration[entry] += s['motion'][above, entry] * rate
        above = p['parent'][above - 1]
    turning = np.zeros(3)
    _cross(acceleration[:3], row[:3], turning)
    _cross(row[10:13], row[7:10], row[13:16])
    for entry in range(3):
        row[13 + entry] += acceleration[3 + entry] + turning[entry]


@compiled
def _locate(s, p, link, place):
    """Write where the frame's origin is, with the links placed."""
    for entry in range(3):
        place[entry] = s['point'][link, entry]
        for column in range(3):
            place[entry] += s['rotation'][link, 3 * entry + column] * p['payload_offset'][column]


@compiled
def _cross(first, second, result):
    """Write the vector product."""
    result[0] = first[1] * second[2] - first[2] * second[1]
    result[1] = first[2] * second[0] - first[0] * second[2]
    result[2] = first[0] * second[1] - first[1] * second[0]


@compiled
def _quaternion(rotation, result):
    """Write the unit quaternion (x, y, z, w) with w >= 0 of a rotation matrix by rows (9,)."""
    trace = rotation[0] + rotation[4] + rotation[8]
    squares = np.empty(4)
    for axis in range(3):
        squares[axis] = 0.25 * (1.0 + 2.0 * rotation[4 * axis] - trace)
    squares[3] = 0.25 * (1.0 + trace)
    largest = np.argmax(squares)
    root = math.sqrt(squares[largest])
    if largest == 3:
        result[0] = (rotation[7] - rotation[5]) / (4.0 * root)
        result[1] = (rotation[2] - rotation[6]) / (4.0 * root)
        result[2] = (rotation[3] - rotation[1]) / (4.0 * root)
        result[3] = root
        return
    one, two = (largest + 1) % 3, (largest + 2) % 3
    result[largest] = root
    result[one] = (rotation[3 * largest + one] + rotation[3 * one + largest]) / (4.0 * root)
    result[two] = (rotation[3 * largest + two] + rotation[3 * two + largest]) / (4.0 * root)
    result[3] = (rotation[3 * two + one] - rotation[3 * one + two]) / (4.0 * root)
    if result[3] < 0.0:
        for entry in range(4):
            result[entry] = -result[entry]


@compiled
def _tilt(rotation, reference, result):
    """Write the rotation vector of rotation times reference transposed, in the base frame, rad."""
    relative = np.zeros(9)
    for row in range(3):
        for column in range(3):
            for inner in range(3):
                relative[3 * row + column] += (
                    rotation[3 * row + inner] * reference[3 * column + inner]
                )
    quaternion = np.zeros(4)
    _quaternion(relative, quaternion)
    sine = math.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
    factor = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, quaternion[3]) / sine
    for entry in range(3):
        result[entry] = factor * quaternion[entry]
