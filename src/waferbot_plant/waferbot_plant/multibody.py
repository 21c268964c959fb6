# SPDX-License-Identifier: Apache-2.0
"""
Rigid-body dynamics of any tree mechanism, compiled: mass matrix and bias.

The equations of motion in the minimal coordinates z (n of them; m or rad) are

    M(z) z'' + h(z, z') = generalised forces

with the mass matrix M from the composite-rigid-body algorithm and the bias h (Coriolis,
centrifugal, gravity) from the recursive Newton-Euler algorithm at zero acceleration. Every link
has one freedom q = ratio * z, so that a gear, a belt or an inextensible cable only shares a
coordinate between links (q = B z, M_z = B' M B, h_z = B' h).

Everything is written in the base frame, with moments taken about the base origin. A spatial vector
is (moment or angular part, force or linear part). Seen so, the inertia of a composite body is the
plain sum of its parts, and no vector has to be carried from frame to frame. Body and joint data
are those of the home pose, where all link frames are parallel to the base frame.

Source of the algorithms: R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, chapters
5 and 6. Assumption: joints without friction and give; both are added by `elements`. Limit: with
moments about one origin, digits are lost as (distance / size)^2 of a body; harmless within metres.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled


def workspace_fields(links: int, coordinates: int) -> list[tuple]:
    """Return the dtype fields of the workspace; place 0 of a link array is the base."""
    return [
        ('rotation', 'f8', (links + 1, 9)),
        ('point', 'f8', (links + 1, 3)),
        ('motion', 'f8', (links + 1, 6)),
        ('twist', 'f8', (links + 1, 6)),
        ('drift', 'f8', (links + 1, 6)),
        ('wrench', 'f8', (links + 1, 6)),
        ('composite', 'f8', (links + 1, 10)),
        ('mass_matrix', 'f8', (coordinates, coordinates)),
        ('bias', 'f8', (coordinates,)),
    ]


def parameter_fields(links: int, coordinates: int) -> list[tuple]:
    """
    Return the dtype fields of a mechanism.

    `parent` counts links from 1, 0 is the base. `offset` leads from the parent's point to the
    link's, m; `first_moment` is mass times centre of gravity from the link's point, kg m;
    `inertia` is the tensor about that point (xx, yy, zz, xy, xz, yz), kg m2; `rotor_inertia` is
    what spins with a coordinate and nothing else, kg m2.
    """
    return [
        ('gravity', 'f8', (3,)),
        ('parent', 'i8', (links,)),
        ('revolute', 'i8', (links,)),
        ('axis', 'f8', (links, 3)),
        ('offset', 'f8', (links, 3)),
        ('mass', 'f8', (links,)),
        ('first_moment', 'f8', (links, 3)),
        ('inertia', 'f8', (links, 6)),
        ('coordinate', 'i8', (links,)),
        ('ratio', 'f8', (links,)),
        ('rotor_inertia', 'f8', (coordinates,)),
    ]


@compiled
def sine_and_cosine(angle):
    """
    Return sin and cos of an angle in rad, to the last bit or next to it.

    Angles of a part that merely gives are tiny; a short Taylor series, exact there to double
    precision (the first term left out is below 1e-17 of the sum), saves half of the time.
    """
    if abs(angle) < 0.03:
        square = angle * angle
        sine = angle * (
            1.0
            - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
        )
        cosine = 1.0 - square / 2.0 * (
            1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
        )
        return sine, cosine
    return math.sin(angle), math.cos(angle)


@compiled
def mass_matrix_and_bias(s, p, position, velocity):
    """
    Compute M and h at `position` and `velocity` (n,) into the workspace of `s`.

    `s` and `p` are records with the fields above. `mass_matrix` (n, n) is filled in its lower
    triangle; h has the sign of a force on the left-hand side: holding still takes the force h.
    """
    motion = s['motion']
    wrench = s['wrench']
    composite = s['composite']
    links = p['links']

    _place_base(s, p)
    for link in range(links):
        _place_link(s, p, link, position, velocity)
        _weigh_link(s, p, link)

    mass_matrix = s['mass_matrix']
    bias = s['bias']
    coordinates = p['coordinates']
    for row in range(coordinates):
        bias[row] = 0.0
        for column in range(row):
            mass_matrix[row, column] = 0.0
        mass_matrix[row, row] = p['rotor_inertia'][row]

    for link in range(links - 1, -1, -1):
        own = link + 1
        parent = p['parent'][link]
        row = p['coordinate'][link]
        ratio = p['ratio'][link]

        for entry in range(10):
            composite[parent, entry] += composite[own, entry]
        for entry in range(6):
            wrench[parent, entry] += wrench[own, entry]

        s0, s1, s2 = motion[own, 0], motion[own, 1], motion[own, 2]
        s3, s4, s5 = motion[own, 3], motion[own, 4], motion[own, 5]
        bias[row] += ratio * (
            s0 * wrench[own, 0]
            + s1 * wrench[own, 1]
            + s2 * wrench[own, 2]
            + s3 * wrench[own, 3]
            + s4 * wrench[own, 4]
            + s5 * wrench[own, 5]
        )

        # momentum of everything that this link carries, when its own joint moves at unit rate
        mass = composite[own, 0]
        cx, cy, cz = composite[own, 1], composite[own, 2], composite[own, 3]
        xx, yy, zz = composite[own, 4], composite[own, 5], composite[own, 6]
        xy, xz, yz = composite[own, 7], composite[own, 8], composite[own, 9]
        f0 = xx * s0 + xy * s1 + xz * s2 + cy * s5 - cz * s4
        f1 = xy * s0 + yy * s1 + yz * s2 + cz * s3 - cx * s5
        f2 = xz * s0 + yz * s1 + zz * s2 + cx * s4 - cy * s3
        f3 = mass * s3 + s1 * cz - s2 * cy
        f4 = mass * s4 + s2 * cx - s0 * cz
        f5 = mass * s5 + s0 * cy - s1 * cx

        mass_matrix[row, row] += (
            ratio * ratio * (s0 * f0 + s1 * f1 + s2 * f2 + s3 * f3 + s4 * f4 + s5 * f5)
        )
        above = parent
        while above > 0:
            column = p['coordinate'][above - 1]
            entry = (
                ratio
                * p['ratio'][above - 1]
                * (
                    motion[above, 0] * f0
                    + motion[above, 1] * f1
                    + motion[above, 2] * f2
                    + motion[above, 3] * f3
                    + motion[above, 4] * f4
                    + motion[above, 5] * f5
                )
            )
            if column == row:
                mass_matrix[row, row] += 2.0 * entry
            else:
                mass_matrix[max(row, column), min(row, column)] += entry
            above = p['parent'][above - 1]


@compiled
def place_links(s, p, position, velocity):
    """
    Set pose, axis, twist and velocity-product acceleration of all links, gravity taken as the base's.

    Uses the workspace that `mass_matrix_and_bias` uses, which fills it anew.
    """
    _place_base(s, p)
    for link in range(p['links']):
        _place_link(s, p, link, position, velocity)


@compiled
def _place_base(s, p):
    """Set the base, which stands still and accelerates against gravity."""
    rotation = s['rotation']
    for row in range(9):
        rotation[0, row] = 0.0
    rotation[0, 0] = rotation[0, 4] = rotation[0, 8] = 1.0
    for row in range(3):
        s['point'][0, row] = 0.0
        s['twist'][0, row] = s['twist'][0, row + 3] = 0.0
        s['drift'][0, row] = 0.0
        s['drift'][0, row + 3] = -p['gravity'][row]


@compiled
def _place_link(s, p, link, position, velocity):
    """Set pose, axis, twist and velocity-product acceleration of a link from its parent's."""
    rotation = s['rotation']
    point = s['point']
    motion = s['motion']
    twist = s['twist']
    drift = s['drift']
    own = link + 1
    parent = p['parent'][link]
    q = p['ratio'][link] * position[p['coordinate'][link]]
    rate = p['ratio'][link] * velocity[p['coordinate'][link]]

    r0, r1, r2 = rotation[parent, 0], rotation[parent, 1], rotation[parent, 2]
    r3, r4, r5 = rotation[parent, 3], rotation[parent, 4], rotation[parent, 5]
    r6, r7, r8 = rotation[parent, 6], rotation[parent, 7], rotation[parent, 8]
    ox, oy, oz = p['offset'][link, 0], p['offset'][link, 1], p['offset'][link, 2]
    px = point[parent, 0] + r0 * ox + r1 * oy + r2 * oz
    py = point[parent, 1] + r3 * ox + r4 * oy + r5 * oz
    pz = point[parent, 2] + r6 * ox + r7 * oy + r8 * oz
    ux, uy, uz = p['axis'][link, 0], p['axis'][link, 1], p['axis'][link, 2]
    ax = r0 * ux + r1 * uy + r2 * uz
    ay = r3 * ux + r4 * uy + r5 * uz
    az = r6 * ux + r7 * uy + r8 * uz
    wx, wy, wz = twist[parent, 0], twist[parent, 1], twist[parent, 2]
    vx, vy, vz = twist[parent, 3], twist[parent, 4], twist[parent, 5]

    if p['revolute'][link]:
        sine, cosine = sine_and_cosine(q)
        rest = 1.0 - cosine
        # rotation about the unit vector u (Rodrigues), times the parent's rotation from the left
        t0, t1, t2 = (
            cosine + rest * ux * ux,
            rest * ux * uy - sine * uz,
            rest * ux * uz + sine * uy,
        )
        t3, t4, t5 = (
            rest * uy * ux + sine * uz,
            cosine + rest * uy * uy,
            rest * uy * uz - sine * ux,
        )
        t6, t7, t8 = (
            rest * uz * ux - sine * uy,
            rest * uz * uy + sine * ux,
            cosine + rest * uz * uz,
        )
        rotation[own, 0] = r0 * t0 + r1 * t3 + r2 * t6
        rotation[own, 1] = r0 * t1 + r1 * t4 + r2 * t7
        rotation[own, 2] = r0 * t2 + r1 * t5 + r2 * t8
        rotation[own, 3] = r3 * t0 + r4 * t3 + r5 * t6
        rotation[own, 4] = r3 * t1 + r4 * t4 + r5 * t7
        rotation[own, 5] = r3 * t2 + r4 * t5 + r5 * t8
        rotation[own, 6] = r6 * t0 + r7 * t3 + r8 * t6
        rotation[own, 7] = r6 * t1 + r7 * t4 + r8 * t7
        rotation[own, 8] = r6 * t2 + r7 * t5 + r8 * t8
        mx, my, mz = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
        motion[own, 0], motion[own, 1], motion[own, 2] = ax, ay, az
        motion[own, 3], motion[own, 4], motion[own, 5] = mx, my, mz
        twist[own, 0] = wx + ax * rate
        twist[own, 1] = wy + ay * rate
        twist[own, 2] = wz + az * rate
        twist[own, 3] = vx + mx * rate
        twist[own, 4] = vy + my * rate
        twist[own, 5] = vz + mz * rate
        drift[own, 0] = drift[parent, 0] + (wy * az - wz * ay) * rate
        drift[own, 1] = drift[parent, 1] + (wz * ax - wx * az) * rate
        drift[own, 2] = drift[parent, 2] + (wx * ay - wy * ax) * rate
        drift[own, 3] = drift[parent, 3] + (wy * mz - wz * my + vy * az - vz * ay) * rate
        drift[own, 4] = drift[parent, 4] + (wz * mx - wx * mz + vz * ax - vx * az) * rate
        drift[own, 5] = drift[parent, 5] + (wx * my - wy * mx + vx * ay - vy * ax) * rate
        point[own, 0], point[own, 1], point[own, 2] = px, py, pz
    else:
        rotation[own, 0], rotation[own, 1], rotation[own, 2] = r0, r1, r2
        rotation[own, 3], rotation[own, 4], rotation[own, 5] = r3, r4, r5
        rotation[own, 6], rotation[own, 7], rotation[own, 8] = r6, r7, r8
        motion[own, 0] = motion[own, 1] = motion[own, 2] = 0.0
        motion[own, 3], motion[own, 4], motion[own, 5] = ax, ay, az
        twist[own, 0], twist[own, 1], twist[own, 2] = wx, wy, wz
        twist[own, 3] = vx + ax * rate
        twist[own, 4] = vy + ay * rate
        twist[own, 5] = vz + az * rate
        drift[own, 0] = drift[parent, 0]
        drift[own, 1] = drift[parent, 1]
        drift[own, 2] = drift[parent, 2]
        drift[own, 3] = drift[parent, 3] + (wy * az - wz * ay) * rate
        drift[own, 4] = drift[parent, 4] + (wz * ax - wx * az) * rate
        drift[own, 5] = drift[parent, 5] + (wx * ay - wy * ax) * rate
        point[own, 0], point[own, 1], point[own, 2] = px + ax * q, py + ay * q, pz + az * q


@compiled
def _weigh_link(s, p, link):
    """Set the inertia of a link's own body about the base origin and the wrench of its drift."""
    composite = s['composite']
    wrench = s['wrench']
    own = link + 1
    mass = p['mass'][link]
    if mass == 0.0:
        for entry in range(10):
            composite[own, entry] = 0.0
        for entry in range(6):
            wrench[own, entry] = 0.0
        return

    rotation = s['rotation']
    r0, r1, r2 = rotation[own, 0], rotation[own, 1], rotation[own, 2]
    r3, r4, r5 = rotation[own, 3], rotation[own, 4], rotation[own, 5]
    r6, r7, r8 = rotation[own, 6], rotation[own, 7], rotation[own, 8]
    px, py, pz = s['point'][own, 0], s['point'][own, 1], s['point'][own, 2]
    ox, oy, oz = p['first_moment'][link, 0], p['first_moment'][link, 1], p['first_moment'][link, 2]
    # first moment from the link's point, then from the base origin
    ox, oy, oz = (
        r0 * ox + r1 * oy + r2 * oz,
        r3 * ox + r4 * oy + r5 * oz,
        r6 * ox + r7 * oy + r8 * oz,
    )
    cx, cy, cz = ox + mass * px, oy + mass * py, oz + mass * pz

    ixx, iyy, izz = p['inertia'][link, 0], p['inertia'][link, 1], p['inertia'][link, 2]
    ixy, ixz, iyz = p['inertia'][link, 3], p['inertia'][link, 4], p['inertia'][link, 5]
    a0, a1, a2 = (
        r0 * ixx + r1 * ixy + r2 * ixz,
        r0 * ixy + r1 * iyy + r2 * iyz,
        r0 * ixz + r1 * iyz + r2 * izz,
    )
    a3, a4, a5 = (
        r3 * ixx + r4 * ixy + r5 * ixz,
        r3 * ixy + r4 * iyy + r5 * iyz,
        r3 * ixz + r4 * iyz + r5 * izz,
    )
    a6, a7, a8 = (
        r6 * ixx + r7 * ixy + r8 * ixz,
        r6 * ixy + r7 * iyy + r8 * iyz,
        r6 * ixz + r7 * iyz + r8 * izz,
    )
    # moving the reference from the link's point P to the origin adds
    # (2 P.o + m P.P) 1 - (P o' + o P' + m P P'), with o the first moment from P
    xs, ys, zs = px * (ox + cx), py * (oy + cy), pz * (oz + cz)
    xx = a0 * r0 + a1 * r1 + a2 * r2 + ys + zs
    yy = a3 * r3 + a4 * r4 + a5 * r5 + xs + zs
    zz = a6 * r6 + a7 * r7 + a8 * r8 + xs + ys
    xy = a0 * r3 + a1 * r4 + a2 * r5 - px * oy - cx * py
    xz = a0 * r6 + a1 * r7 + a2 * r8 - px * oz - cx * pz
    yz = a3 * r6 + a4 * r7 + a5 * r8 - py * oz - cy * pz
    composite[own, 0] = mass
    composite[own, 1], composite[own, 2], composite[own, 3] = cx, cy, cz
    composite[own, 4], composite[own, 5], composite[own, 6] = xx, yy, zz
    composite[own, 7], composite[own, 8], composite[own, 9] = xy, xz, yz

    wx, wy, wz = s['twist'][own, 0], s['twist'][own, 1], s['twist'][own, 2]
    vx, vy, vz = s['twist'][own, 3], s['twist'][own, 4], s['twist'][own, 5]
    ex, ey, ez = s['drift'][own, 0], s['drift'][own, 1], s['drift'][own, 2]
    gx, gy, gz = s['drift'][own, 3], s['drift'][own, 4], s['drift'][own, 5]
    # momentum about the origin: angular h, linear l
    hx = xx * wx + xy * wy + xz * wz + cy * vz - cz * vy
    hy = xy * wx + yy * wy + yz * wz + cz * vx - cx * vz
    hz = xz * wx + yz * wy + zz * wz + cx * vy - cy * vx
    lx = mass * vx + wy * cz - wz * cy
    ly = mass * vy + wz * cx - wx * cz
    lz = mass * vz + wx * cy - wy * cx
    wrench[own, 0] = (
        xx * ex + xy * ey + xz * ez + cy * gz - cz * gy + wy * hz - wz * hy + vy * lz - vz * ly
    )
    wrench[own, 1] = (
        xy * ex + yy * ey + yz * ez + cz * gx - cx * gz + wz * hx - wx * hz + vz * lx - vx * lz
    )
    wrench[own, 2] = (
        xz * ex + yz * ey + zz * ez + cx * gy - cy * gx + wx * hy - wy * hx + vx * ly - vy * lx
    )
    wrench[own, 3] = mass * gx + ey * cz - ez * cy + wy * lz - wz * ly
    wrench[own, 4] = mass * gy + ez * cx - ex * cz + wz * lx - wx * lz
    wrench[own, 5] = mass * gz + ex * cy - ey * cx + wx * ly - wy * lx


@compiled
def kinetic_energy(s, p, velocity):
    """Return the kinetic energy z' M z / 2 in J, after `mass_matrix_and_bias` at that pose."""
    mass_matrix = s['mass_matrix']
    twice = 0.0
    for row in range(p['coordinates']):
        twice += mass_matrix[row, row] * velocity[row] * velocity[row]
        for column in range(row):
            twice += 2.0 * mass_matrix[row, column] * velocity[row] * velocity[column]
    return 0.5 * twice


@compiled
def gravity_energy(s, p):
    """
    Return the potential energy of gravity, -m g . r (2.24), in J, zero with everything at the
    origin.

    Uses the poses that `mass_matrix_and_bias` left in the workspace.
    """
    energy = 0.0
    for link in range(p['links']):
        for row in range(3):
            moment = p['mass'][link] * s['point'][link + 1, row]
            for column in range(3):
                moment += (
                    s['rotation'][link + 1, 3 * row + column] * p['first_moment'][link, column]
                )
            energy -= p['gravity'][row] * moment
    return energy


@compiled
def factorise(matrix, size):
    """
    Factorise a symmetric positive definite matrix in place, A = L' D L, lower triangle.

    That of its first `size` rows and columns; the rest is room.

    Eliminates from the last row up, children before parents: the zeros between branches of the
    tree then stay zeros, and rows that a link does not touch are skipped (Featherstone, section
    6.5).
    """
    for pivot in range(size - 1, 0, -1):
        inverse = 1.0 / matrix[pivot, pivot]
        for row in range(pivot):
            factor = matrix[pivot, row] * inverse
            if factor != 0.0:
                for column in range(row + 1):
                    matrix[row, column] -= factor * matrix[pivot, column]
        for row in range(pivot):
            matrix[pivot, row] *= inverse


@compiled
def solve(factors, vector, size):
    """Solve A x = vector in place with the factors of A (`size`, `size`) from `factorise`."""
    for row in range(size - 1, 0, -1):
        value = vector[row]
        for column in range(row):
            vector[column] -= factors[row, column] * value
    for row in range(size):
        value = vector[row] / factors[row, row]
        for column in range(row):
            value -= factors[row, column] * vector[column]
        vector[row] = value
