"""The beam's irradiance over its cross-section, before any blur."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from planeopt.simulation.tables import BeamProfile

Array = NDArray[np.float64]

_NOTHING = 1e-7
"""Share of the plateau below which light counts as none."""
_WAVES = 48


def reach(beam: BeamProfile, radius: float) -> tuple[float, float]:
    """Return the range of `rho` in which the irradiance is neither (to 1e-7) zero nor the plateau's.

    Parameters
    ----------
    beam : BeamProfile
    radius : float
        Of the beam, mm.
    """
    tail = -float(ndtri(_NOTHING))
    if beam.kind == "ring":
        half = tail * beam.line_mm / radius
        return max(0.0, 1 - half), 1 + half
    if beam.kind == "gaussian":
        outside = (math.log(_NOTHING) / math.log(beam.level)) ** (1 / beam.order)
        return 0.0, outside / (1 - beam.astigmatism)
    soft, shift = beam.edge_mm / radius, float(ndtri(beam.level))
    inner = 1 - soft * (tail - shift)
    outer = 1 + soft * (tail + shift)
    return max(0.0, inner * (1 - beam.astigmatism)), outer / (1 - beam.astigmatism)


def softness(beam: BeamProfile, radius: float) -> float:
    """Return the scale over which the irradiance changes where it does so fastest, mm; 0 for a sharp disc.

    A ring's or a soft edge's standard deviation; of a Gaussian beam that of an edge as steep as it is at its radius, or
    of its core if that is less.
    """
    if beam.kind == "ring":
        return beam.line_mm
    if beam.kind == "disc":
        return beam.edge_mm
    depth = -math.log(beam.level)
    edge = 1 / (math.sqrt(math.tau) * beam.level * depth * beam.order)
    return 0.5 * radius * min(edge, 1 / math.sqrt(2 * depth))


def irradiance(beam: BeamProfile, radius: float, x: Array, y: Array) -> Array:
    """Return the irradiance (...) at places of the cross-section, share of the plateau; smooth profiles only.

    Parameters
    ----------
    beam : BeamProfile
        Not a sharp disc.
    radius : float
        Of the beam, mm.
    x, y : ndarray, shape (...)
        In radii.
    """
    rho = np.hypot(x, y)
    if beam.astigmatism > 0:
        direction = math.radians(beam.astigmatism_deg)
        squares = np.maximum(rho * rho, 1e-300)
        # cos and sin of twice the angle from the axes, without the angle.
        c2, s2 = (x * x - y * y) / squares, 2 * x * y / squares
        turn = c2 * math.cos(2 * direction) + s2 * math.sin(2 * direction)
        # At this level the contour stays the circle; a ring's ridge stays where it is.
        still = 1.0 if beam.kind == "ring" else beam.level
        rho = rho / (1 + beam.astigmatism * (_radial(beam, radius, rho) - still) * turn)
    return _radial(beam, radius, rho)


def _radial(beam: BeamProfile, radius: float, rho: Array) -> Array:
    if beam.kind == "ring":
        return np.exp(-0.5 * ((rho - 1) * (radius / beam.line_mm)) ** 2)
    if beam.kind == "gaussian":
        # Beyond any light the power would overflow.
        return np.exp(math.log(beam.level) * np.minimum(rho, 1e3) ** beam.order)
    return ndtr((1 - rho) * (radius / beam.edge_mm) + float(ndtri(beam.level)))


def is_even(beam: BeamProfile) -> bool:
    """Whether the plateau has one brightness."""
    return beam.slope == (0.0, 0.0) and beam.bowl == 0 and beam.unevenness == 0 and beam.fringes == 0


def plateau(beam: BeamProfile, radius: float, x: Array, y: Array, random_part: Array | float) -> Array:
    """Return the relative brightness (...), not negative, at places of the cross-section (in radii).

    Parameters
    ----------
    beam : BeamProfile
    radius : float
        Of the beam, mm.
    x, y : ndarray, shape (...)
    random_part : ndarray or float
        See `unevenness`.
    """
    value = 1 + beam.slope[0] * x + beam.slope[1] * y + beam.bowl * (x * x + y * y) + random_part
    if beam.fringes > 0:
        direction = math.radians(beam.fringe_deg)
        phase = math.tau * radius / beam.fringe_mm * (x * math.cos(direction) + y * math.sin(direction))
        value = value * (1 + beam.fringes * np.cos(phase))
    return np.maximum(value, 0.0)


def unevenness(beam: BeamProfile, x: Array, y: Array, rng: np.random.Generator) -> Array:
    """Return the random part (...) of the plateau's relative brightness at places of the cross-section (in radii)."""
    total = np.zeros_like(x)
    if beam.unevenness == 0:
        return total
    # A sum of plane waves with normal wave vectors has a Gaussian autocorrelation of that correlation length.
    waves = rng.normal(0, 1 / beam.unevenness_radii, (_WAVES, 2))
    phases = rng.uniform(0, math.tau, _WAVES)
    for (kx, ky), phase in zip(waves, phases, strict=True):
        total += np.cos(kx * x + ky * y + phase)
    return beam.unevenness * math.sqrt(2 / _WAVES) * total
