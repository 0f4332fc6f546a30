"""The ellipse through a spot's boundary points, in the terms of someone who looks at the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.conic import maximum_likelihood
from planeopt.spot.points import Spot

Array = NDArray[np.float64]

_NO_DIRECTION = np.radians(10)
"""Standard deviation from which on a direction says nothing: to first order that is an ellipse less than 3 standard
deviations from a circle, which noise makes of one circle in a hundred."""


@dataclass(frozen=True, eq=False)
class FittedEllipse:
    """An ellipse with the standard deviations that the points' sigma gives it, to first order.

    Parameters
    ----------
    centre : (2,) array
        ``(x, y)``, px.
    semi_axes : (2,) array
        Major and minor, px.
    angle : float
        Direction of the major axis from +x to +y, rad, in (-pi/2, pi/2].
    sigma_centre, sigma_semi_axes : (2,) array, or None
        px; ``None`` if the points have no sigma.
    sigma_angle : float or None
        rad; ``None`` also where the ellipse is too round to have a direction.
    """

    centre: Array
    semi_axes: Array
    angle: float
    sigma_centre: Array | None = None
    sigma_semi_axes: Array | None = None
    sigma_angle: float | None = None

    @property
    def axes(self) -> Array:
        """(2, 2) array whose columns are the unit vectors of the major and of the minor axis."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def curve(self, count: int) -> Array:
        """Return points (count, 2) round the ellipse, the last one the first, px."""
        theta = np.linspace(0, 2 * np.pi, count)
        return self.centre + (np.stack([np.cos(theta), np.sin(theta)], axis=1) * self.semi_axes) @ self.axes.T

    def distances(self, points: Array) -> Array:
        """Return the signed distances (N,) of points (N, 2), px, positive outside (first order: Sampson's)."""
        q = self._scaled(points)
        return ((q**2).sum(axis=1) - 1) / np.maximum(2 * np.hypot(*(q / self.semi_axes).T), 1e-12)

    def normals(self, points: Array) -> Array:
        """Return the outward unit normals (N, 2) at points (N, 2) on or near the ellipse."""
        return self._local_normals(self._scaled(points)) @ self.axes.T

    def _scaled(self, points: Array) -> Array:
        return (points - self.centre) @ self.axes / self.semi_axes

    def _local_normals(self, scaled: Array) -> Array:
        outward = scaled / self.semi_axes
        return outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)

    def derivatives(self, points: Array) -> Array:
        """Return the derivatives (N, 5) of the distances by centre (x, y), semi-axes and angle."""
        scaled = self._scaled(points)
        on = scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-12)
        normal = self._local_normals(on)
        place = on * self.semi_axes
        turned = normal[:, 1] * place[:, 0] - normal[:, 0] * place[:, 1]
        return -np.column_stack([normal @ self.axes.T, normal * on, turned])


def fit_ellipse(points: Array, sigma: Array | None = None) -> FittedEllipse | None:
    """Fit by maximum likelihood; None where the points do not lie on an ellipse.

    Parameters
    ----------
    points : (N, 2) array
        px.
    sigma : (N,) array, optional
        Standard deviation across the boundary, px; equal where it is not given.
    """
    found = maximum_likelihood(points, sigma, check=False)
    if not bool(found.ok):
        return None
    shape = found.ellipse
    centre, semi_axes = (np.asarray(value, dtype=np.float64) for value in (shape.centre, shape.semi_axes))
    fitted = FittedEllipse(centre, semi_axes, float(shape.angle))
    if sigma is None:
        return fitted
    deviations = _deviations(fitted.derivatives(points) / sigma[:, None])
    if deviations is None:
        return fitted
    angle = float(deviations[4])
    return FittedEllipse(
        centre,
        semi_axes,
        fitted.angle,
        sigma_centre=deviations[:2],
        sigma_semi_axes=deviations[2:4],
        sigma_angle=angle if angle < _NO_DIRECTION else None,
    )


def ellipse_of(spot: Spot) -> FittedEllipse | None:
    """Return the ellipse through a spot's points in raw pixels, the lens's distortion left in."""
    return fit_ellipse(spot.points, spot.sigma)


def _deviations(weighted: Array) -> Array | None:
    """Return the standard deviations (5,) from derivatives (N, 5) in units of sigma; None where nothing fixes them."""
    size = np.linalg.norm(weighted, axis=0)
    if not np.all(size[:4] > 0):
        return None
    # A circle has no direction: its column is rounding, or nothing.
    round_ = size[4] <= 1e-9 * size[:4].max() * np.sqrt(len(weighted))
    known = 4 if round_ else 5
    inverse = np.linalg.pinv(weighted[:, :known] / size[:known])
    deviations = np.full(5, np.inf)
    deviations[:known] = np.linalg.norm(inverse, axis=1) / size[:known]
    return deviations
