"""What is believed of the plane before the image is seen."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.equations import Setup
from planeopt.errors import InputError

Array = NDArray[np.float64]


class Random(Protocol):
    """What `numpy.random.Generator` and `numpy.random.RandomState`, which emcee uses, have in common."""

    def uniform(self, low: float, high: float, size: int, /) -> Array: ...

    def standard_normal(self, size: tuple[int, int], /) -> Array: ...

    def chisquare(self, df: float, size: int, /) -> Array: ...


class PlanePrior(Protocol):
    """What `sample_posterior` asks of a prior."""

    def sentence(self, radius: float) -> str:
        """Say what is assumed, for the report; the radius is the beam's, mm."""
        ...

    def log_density(self, planes: Array, setup: Setup) -> Array:
        """Return the log density (...) of planes (..., 3) by ``(log z_L, p, q)``, up to a constant.

        Minus infinity where it excludes a plane. Planes are as the equations have them: ``z_L`` is the z of the spot's
        centre in the laser-parallel frame. What cannot be seen at all (`visible`) is left out by the sampler.
        """
        ...


@dataclass(frozen=True)
class Prior:
    """Plane directions uniform on the hemisphere, depth log-uniform.

    ``pi(log z_L, p, q) ~ (1 + p^2 + q^2)^(-3/2)``: a uniform direction of the normal, written in slopes.

    Parameters
    ----------
    depth_radii : (float, float)
        Bounds of ``z_L``, in radii of the beam.
    max_tilt : float
        Largest angle between the normal and the beam, rad.

    Raises
    ------
    InputError
        If the bounds are not ``0 < least < most``, or the tilt is not between 0 and a right angle.
    """

    depth_radii: tuple[float, float] = (20.0, 1000.0)
    max_tilt: float = math.radians(85.0)

    def __post_init__(self) -> None:
        least, most = (float(bound) for bound in self.depth_radii)
        if not 0 < least < most < math.inf:
            raise InputError(
                f"the prior's depths must be 0 < least < most, in radii of the beam, not ({least}, {most})"
            )
        if not 0 < self.max_tilt < math.pi / 2:
            raise InputError(f"the prior's largest tilt must be above 0 and below pi/2 rad, not {self.max_tilt}")
        object.__setattr__(self, "depth_radii", (least, most))

    def sentence(self, radius: float) -> str:
        least, most = (f"{bound * radius:.6g}" for bound in self.depth_radii)
        return (
            f"Before the image is seen, the plane's normal is taken as uniform over all directions within "
            f"{math.degrees(self.max_tilt):.4g} deg of the beam and log z_L as uniform from {least} to {most} mm "
            f"({self.depth_radii[0]:g} to {self.depth_radii[1]:g} radii of the beam)."
        )

    def log_density(self, planes: Array, setup: Setup) -> Array:
        z_L, slope2 = planes[..., 0], planes[..., 1] ** 2 + planes[..., 2] ** 2
        least, most = self.depth_radii
        inside = (z_L >= least * setup.r) & (z_L <= most * setup.r) & (slope2 <= math.tan(self.max_tilt) ** 2)
        norm = math.log(2 * math.pi * (1 - math.cos(self.max_tilt)) * math.log(most / least))
        return np.where(inside, -1.5 * np.log1p(slope2) - norm, -np.inf)

    def draw(self, rng: np.random.Generator, n: int, setup: Setup, *, both_sides: bool = False) -> Array:
        """Draw planes that can be seen.

        Parameters
        ----------
        rng : numpy.random.Generator
        n : int
        setup : Setup
            ``f, e_x, e_y, r`` in mm.
        both_sides : bool
            As in `visible`.

        Returns
        -------
        (n, 3)
            ``(z_L, p, q)`` as in the equations: ``z_L`` less `Rig.axial_shift` is the distance along the beam.

        Raises
        ------
        InputError
            If hardly any plane of this prior can be seen.
        """
        kept: list[Array] = []
        missing = n
        for _ in range(_ROUNDS):
            planes = self.draw_unseen(rng, 2 * n + 64, setup)
            kept.append(planes[visible(planes, setup, both_sides=both_sides)][:missing])
            missing -= len(kept[-1])
            if not missing:
                return np.concatenate(kept)
        raise InputError("hardly any plane that the prior allows can be seen by this camera: widen its bounds")

    def draw_unseen(self, rng: Random, n: int, setup: Setup) -> Array:
        """As `draw`, planes that cannot be seen among them: `log_density` is theirs, normalised."""
        # In a box of logs and areas everything is uniform: on the sphere the cosine is, as Archimedes found.
        least, most = np.log(self.depth_radii)
        z_L = setup.r * np.exp(rng.uniform(least, most, n))
        cosine = 1 - rng.uniform(0.0, 1.0, n) * (1 - math.cos(self.max_tilt))
        slope = np.sqrt((1 - cosine) * (1 + cosine)) / cosine
        azimuth = rng.uniform(-math.pi, math.pi, n)
        return np.stack([z_L, slope * np.cos(azimuth), slope * np.sin(azimuth)], axis=-1)


_ROUNDS = 1000


def visible(planes: ArrayLike, setup: Setup, *, both_sides: bool = False) -> NDArray[np.bool_]:
    """Whether the camera sees the whole spot, and on its lit side.

    ``z_L > r |n|``: all of the spot is in front of the camera. ``c > 0``: camera and laser are on one side of the
    plane.

    Parameters
    ----------
    planes : (..., 3)
        ``(z_L, p, q)`` as in the equations.
    setup : Setup
    both_sides : bool
        The plane is translucent: its spot is seen from both sides, and ``c > 0`` is not asked for.
    """
    planes = np.asarray(planes, dtype=float)
    z_L, p, q = planes[..., 0], planes[..., 1], planes[..., 2]
    in_front = (z_L > 0) & (z_L * z_L > setup.r**2 * (p * p + q * q))
    return in_front if both_sides else in_front & (z_L - p * setup.e_x - q * setup.e_y > 0)
