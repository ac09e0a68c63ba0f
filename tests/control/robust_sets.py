"""The arms, references and sets of section 1 of the verified mathematics, which tests of robust control share."""

import dataclasses

import numpy as np

import taut

SHAPES = {
    "planar2": ((0.8, -0.6), (0.5, 0.7)),
    "panda": ((0.5, 0.4, -0.5, 0.6, 0.5, -0.6, 0.8), (0.5, 0.4, 0.6, 0.5, 0.7, 0.6, 0.5)),
    "ur10": ((0.5, 0.4, -0.5, 0.6, 0.5, 0.6), (0.5, 0.4, 0.6, 0.5, 0.7, 0.6)),
    "kinova": ((0.5, 0.4, -0.5, 0.6, 0.5, 0.6), (0.5, 0.4, 0.6, 0.5, 0.7, 0.6)),
    "xarm7": ((0.5, 0.4, -0.5, 0.6, 0.5, -0.6, 0.8), (0.5, 0.4, 0.6, 0.5, 0.7, 0.6, 0.5)),
}
"""Amplitudes [rad] and frequencies [Hz] of reference R: home + A/2 (1 - cos 2 pi f t)."""


def reference(arm: taut.Arm) -> taut.trajectories.Sine:
    amplitude, frequency = (np.array(x) for x in SHAPES[arm.name])
    center = arm.home + 0.5 * amplitude
    return taut.trajectories.Sine(center=center, amplitude=-0.5 * amplitude, frequency=frequency, phase=0.5 * np.pi)


def planar_set(**others: object) -> taut.laws.Uncertainty:
    """Section 1's set for planar2, without Coulomb friction."""
    return taut.laws.Uncertainty(links=0.2, payload=(0.0, 1.0), viscous=(0.05, 0.15), **others)


def with_links(arm: taut.Arm, factors: object) -> taut.Arm:
    """The arm with the mass and inertia of each body times a factor."""
    bodies = zip(arm.bodies, np.broadcast_to(factors, (arm.n,)).tolist(), strict=True)
    return dataclasses.replace(
        arm, bodies=tuple(dataclasses.replace(x, mass=f * x.mass, inertia=f * x.inertia) for x, f in bodies)
    )
