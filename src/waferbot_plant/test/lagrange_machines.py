# SPDX-License-Identifier: Apache-2.0
"""Random machines and states for the tests of the mathematical plant; physical by construction."""

from dataclasses import dataclass

import numpy as np

from waferbot_plant import lagrange
from waferbot_plant.lagrange import CableGeometry, RigidBody, YRotateDrive


@dataclass(frozen=True)
class Machine:
    """A machine in its base frame, as a designer gives it, with a Y-Rotate rotor of its own."""

    carriage: RigidBody
    x_rotate: RigidBody  # without the rotor
    y_rotate: RigidBody
    rotor: RigidBody  # spins about an axis parallel to y
    counterweight_mass_kg: float
    x_rotate_at_m: np.ndarray
    y_rotate_at_m: np.ndarray
    payload_origin_m: np.ndarray
    drive: YRotateDrive
    cable: CableGeometry
    gravity_m_s2: float = 9.81

    @property
    def drive_ratio(self) -> float:
        """Turns of the motor per turn of the payload."""
        drive = self.drive
        return drive.gear_ratio * drive.driven_pulley_radius_m / drive.drive_pulley_radius_m

    def parameters(self) -> np.ndarray:
        """Return the record of the mathematical plant: the rotor as if locked to its carrier."""
        return lagrange.parameters_from_base_frame(
            carriage=self.carriage,
            x_rotate=lagrange.combine([self.x_rotate, self.rotor]),
            y_rotate=self.y_rotate,
            counterweight_mass_kg=self.counterweight_mass_kg,
            drive=self.drive,
            cable=self.cable,
            x_rotate_at_m=self.x_rotate_at_m,
            y_rotate_at_m=self.y_rotate_at_m,
            payload_origin_m=self.payload_origin_m,
            gravity_m_s2=self.gravity_m_s2,
        )


def random_body(random: np.random.Generator) -> RigidBody:
    """Weigh out a cloud of six particles: any such inertia tensor is that of a real body."""
    masses = random.uniform(0.2, 5.0, 6)
    particles = random.normal(0.0, 0.2, 3) + random.normal(0.0, 0.15, (6, 3))
    particles += random.uniform(-0.2, 0.2, 3)
    centre = masses @ particles / masses.sum()
    offsets = particles - centre
    inertia = sum(
        m * (s @ s * np.eye(3) - np.outer(s, s)) for m, s in zip(masses, offsets, strict=True)
    )
    return RigidBody(float(masses.sum()), tuple(centre), tuple(map(tuple, inertia)))


def random_machine(random: np.random.Generator) -> Machine:
    """Draw masses, centres of gravity, inertia tensors, drive (ratio 0.7 to 600) and cable."""
    axial = random.uniform(1e-5, 1e-3)
    transverse = random.uniform(0.5, 5.0) * axial
    rotor = RigidBody(
        random.uniform(0.1, 2.0),
        tuple(random.normal(0.0, 0.3, 3)),
        ((transverse, 0.0, 0.0), (0.0, axial, 0.0), (0.0, 0.0, transverse)),
    )
    return Machine(
        carriage=random_body(random),
        x_rotate=random_body(random),
        y_rotate=random_body(random),
        rotor=rotor,
        counterweight_mass_kg=random.uniform(0.0, 60.0),
        x_rotate_at_m=random.normal(0.0, 0.3, 3),
        y_rotate_at_m=random.normal(0.0, 0.3, 3),
        payload_origin_m=random.normal(0.0, 0.3, 3),
        drive=YRotateDrive(
            axial, random.uniform(1.0, 60.0), random.uniform(0.01, 0.03), random.uniform(0.02, 0.1)
        ),
        cable=CableGeometry(*random.uniform(0.05, 1.0, 5)),
        gravity_m_s2=random.uniform(0.0, 20.0),
    )


def random_state(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw position (any angle), velocity and generalised force."""
    position = random.uniform([-1.0, -np.pi, -np.pi], [1.0, np.pi, np.pi])
    velocity = random.normal(0.0, [1.0, 4.0, 4.0])
    force = random.normal(0.0, [500.0, 50.0, 50.0])
    return position, velocity, force
