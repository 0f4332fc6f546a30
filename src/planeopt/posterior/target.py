"""The density that is sampled, in the coordinates in which it is: log z_L, the slopes, and where needed the scale."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.posterior.likelihood import Likelihood, Scale
from planeopt.posterior.prior import PlanePrior, visible

Array = NDArray[np.float64]

SCALE_BOUNDS = (math.log(1e-2), math.log(1e3))
"""Of the noise's scale over the estimated one, where it is sampled: what one degree of freedom leaves out is 1e-3."""

_LARGEST_LOG = 700.0


@dataclass(frozen=True, eq=False)
class Target:
    """Log posterior of ``theta = (log z_L, p, q[, log scale])``.

    Attributes
    ----------
    likelihood : Likelihood
    prior : PlanePrior
    both_sides : bool
        The plane may show either side.
    """

    likelihood: Likelihood
    prior: PlanePrior
    both_sides: bool = False

    @property
    def dimension(self) -> int:
        return 4 if self.likelihood.scale is Scale.SAMPLED else 3

    def planes(self, theta: Array) -> Array:
        """``(z_L, p, q)`` (W, 3) as in the equations."""
        return np.column_stack([np.exp(np.minimum(theta[:, 0], _LARGEST_LOG)), theta[:, 1:3]])

    def log_scale(self, theta: Array) -> Array | None:
        return theta[:, 3] if self.dimension == 4 else None

    def log_likelihood(self, theta: Array) -> Array:
        """(W,), minus infinity where the plane cannot be seen or the scale is out of its bounds."""
        planes, log_scale = self.planes(theta), self.log_scale(theta)
        inside = visible(planes, self.likelihood.setup, both_sides=self.both_sides)
        if log_scale is not None:
            inside &= (log_scale >= SCALE_BOUNDS[0]) & (log_scale <= SCALE_BOUNDS[1])
            log_scale = np.clip(log_scale, *SCALE_BOUNDS)
        harmless = np.array([self.likelihood.setup.f * self.likelihood.setup.r, 0.0, 0.0])
        values = self.likelihood(np.where(inside[:, None], planes, harmless), log_scale)
        return np.where(inside & np.isfinite(values), values, -np.inf)

    def log_prior(self, theta: Array) -> Array:
        """(W,)."""
        return self.prior.log_density(self.planes(theta), self.likelihood.setup)

    def __call__(self, theta: Array) -> Array:
        """Log posterior (W,), up to a constant."""
        return self.log_likelihood(theta) + self.log_prior(theta)

    def lit(self, planes: Array) -> NDArray[np.bool_]:
        """Whether the camera sees the side of each plane (W, 3) that the laser lights, c > 0."""
        setup = self.likelihood.setup
        return planes[:, 0] - planes[:, 1] * setup.e_x - planes[:, 2] * setup.e_y > 0

    def mirrored(self, theta: Array) -> tuple[Array, Array]:
        """The second plane with the same image, and the log of the map's Jacobian determinant.

        In ``(z_L, p, q)`` the map is a reflection, along ``(r^2, e)`` onto the planes through the camera (c = 0): its
        determinant is -1. In the log of z_L it is ``z_L / z_L'``.
        """
        setup, planes = self.likelihood.setup, self.planes(theta)
        along = np.array([setup.r**2, setup.e_x, setup.e_y])
        k = setup.e_x**2 + setup.e_y**2 - setup.r**2
        c = planes[:, 0] - planes[:, 1] * setup.e_x - planes[:, 2] * setup.e_y
        other = planes + (2 * c / k)[:, None] * along
        with np.errstate(invalid="ignore", divide="ignore"):
            log_z = np.where(other[:, 0] > 0, np.log(np.abs(other[:, 0])), -_LARGEST_LOG)
        image = np.column_stack([log_z, other[:, 1:], theta[:, 3:]])
        return image, theta[:, 0] - log_z

    @property
    def has_mirror(self) -> bool:
        """Whether the second plane exists: for a camera outside the beam it is always in front."""
        setup = self.likelihood.setup
        return self.both_sides and setup.e_x**2 + setup.e_y**2 > setup.r**2 * (1 + 1e-9)
