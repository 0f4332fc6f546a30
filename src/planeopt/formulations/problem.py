"""One case to solve: the boundary points or their ellipse, the rig in the laser-parallel frame, and the noise."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.conic import arc_fraction, fit_conic, geometric_from_conic, is_ellipse
from planeopt.equations import Setup
from planeopt.errors import InputError
from planeopt.rig import Rig
from planeopt.solution import Flag
from planeopt.spot import Spot

Array = NDArray[np.float64]

NOISE_FLOOR = 1e-7
"""Smallest noise standard deviation, as a fraction of the points' RMS distance from their mean.

Below it exact points would be weighted by their rounding: a coordinate 40 radii from the origin is rounded at 1e-14
of the radius, which leaves the residuals, in standard deviations, seven digits. No camera measures a boundary so
well: it is 1e-5 px for a spot of 100 px.
"""


@dataclass(frozen=True)
class Problem:
    """Everything a formulation may use.

    Attributes
    ----------
    setup : Setup
        ``f, e_x, e_y, r`` of the laser-parallel frame, mm.
    B : (5,)
        Coefficients of (16).
    B_factor : (5, 5)
        ``S`` with ``S S'`` the covariance of ``B``.
    points : (N, 2) or None
        Boundary points on the laser-parallel image plane, mm; None where only an ellipse is known.
    noise : (N, 2, 2) or None
        Their covariances, mm^2, the estimated scale included.
    scale_dof : int or None
        Degrees of freedom behind an estimated noise scale; None where sigma was given, 0 where it cannot be estimated.
    arc : float or None
        Covered fraction of the ellipse.
    rig : Rig or None
        Where the points came from; None for points given in mm.
    pixels : (N, 2) or None
        The points before undistortion.
    flags : tuple of Flag
    """

    setup: Setup
    B: Array
    B_factor: Array
    points: Array | None = None
    noise: Array | None = None
    scale_dof: int | None = None
    arc: float | None = None
    rig: Rig | None = None
    pixels: Array | None = None
    flags: tuple[Flag, ...] = ()

    @classmethod
    def from_spot(cls, spot: Spot, rig: Rig) -> "Problem":
        """Carry the spot's boundary points, and their noise, to the laser-parallel image plane and fit (16) there.

        Raises
        ------
        InputError
            If the rig has no beam, or the points determine no ellipse.
        """
        beam = rig.require_beam()
        e_x, e_y = rig.laser_offset
        points, jacobian = rig.to_laser_plane(spot.points)
        sigma = np.ones(len(points)) if spot.sigma is None else spot.sigma
        noise = (jacobian @ np.swapaxes(jacobian, 1, 2)) * (sigma**2)[:, None, None]
        setup = Setup(rig.focal_length, e_x, e_y, beam.radius)
        problem = cls.from_points(points, setup, noise, scale_known=spot.sigma is not None)
        doubts = {Flag.RIG_WITHOUT_COVARIANCE: rig.covariance is None, Flag.RIG_REFUSED: rig.refused is not None}
        flags = (*problem.flags, *(flag for flag, holds in doubts.items() if holds))
        return replace(problem, rig=rig, pixels=np.asarray(spot.points, dtype=float), flags=flags)

    @classmethod
    def from_points(
        cls, points: ArrayLike, setup: Setup, noise: ArrayLike | None = None, *, scale_known: bool = True
    ) -> "Problem":
        """Boundary points on the laser-parallel image plane.

        Parameters
        ----------
        points : (N, 2)
            mm.
        setup : Setup
        noise : float, (N,) or (N, 2, 2), optional
            Standard deviation (mm) for all or each, or covariances (mm^2). Left out: equal, with an unknown scale.
        scale_known : bool
            False where ``noise`` is right only up to a common factor, to be estimated from the residuals.

        Raises
        ------
        InputError
            If the points determine no ellipse.
        """
        _check_setup(setup)
        xy = _numbers("boundary points", points)
        known = scale_known and noise is not None
        if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
            raise InputError(f"boundary points must be finite and of shape (N, 2), mm, not of shape {xy.shape}")
        covariances = _covariances(len(xy), 1.0 if noise is None else noise)
        # The floor: an unknown scale is sought from there upwards, a given one is not believed below it.
        typical2 = float(np.median(np.trace(covariances, axis1=1, axis2=2))) / 2
        floor2 = NOISE_FLOOR**2 * float(np.sum(np.var(xy, axis=0))) / typical2
        if not known:
            covariances = covariances * floor2
        fit = fit_conic(xy, covariances)
        if known:
            flags, scale_dof, scale2 = [], None, max(1.0, floor2)
        else:
            flags, scale_dof, scale2 = [Flag.SCALE_ESTIMATED], len(xy) - 5, 1.0
            if scale_dof:
                scale2 = max(1.0, float(np.asarray(fit.chi2)) / scale_dof)
        if scale_dof != 0 and scale2 == (floor2 if known else 1.0):
            flags.append(Flag.SCALE_AT_FLOOR)
        return cls(
            setup,
            np.asarray(fit.B, dtype=float),
            np.asarray(fit.sqrt_covariance, dtype=float) * np.sqrt(scale2),
            xy,
            covariances * scale2,
            scale_dof,
            float(arc_fraction(fit.B, xy)),
            flags=tuple(flags),
        )

    @classmethod
    def from_conic(cls, B: ArrayLike, covariance: ArrayLike, setup: Setup) -> "Problem":
        """Only the ellipse (16) with the covariance of its coefficients (5, 5).

        Raises
        ------
        InputError
            If ``B`` is not finite or the covariance is not positive definite.
        """
        _check_setup(setup)
        coefficients, sigma = _numbers("B", B), _numbers("the covariance of B", covariance)
        if coefficients.shape != (5,) or sigma.shape != (5, 5):
            raise InputError(f"B must be (5,) and its covariance (5, 5), not {coefficients.shape} and {sigma.shape}")
        if not (np.isfinite(coefficients).all() and np.isfinite(sigma).all()):
            raise InputError("B and its covariance must be finite")
        scale = np.sqrt(np.maximum(np.diag(sigma), 0.0))
        if not scale.all():
            raise InputError("the covariance of B is not positive definite: a variance is not positive")
        if not np.allclose(sigma / np.outer(scale, scale), sigma.T / np.outer(scale, scale), rtol=0, atol=1e-9):
            raise InputError("the covariance of B is not symmetric")
        try:
            factor = np.asarray(scale[:, None] * np.linalg.cholesky(sigma / np.outer(scale, scale)), dtype=float)
        except np.linalg.LinAlgError as error:
            raise InputError("the covariance of B is not positive definite") from error
        return cls(setup, coefficients, factor)

    @property
    def n_points(self) -> int:
        return 0 if self.points is None else len(self.points)

    @property
    def axial_shift(self) -> float:
        """(Q e)_z: what the spot centre's z has over the distance along the beam; 0 without a rig."""
        return 0.0 if self.rig is None else self.rig.axial_shift

    @property
    def minor_axis(self) -> float:
        """Shorter semi-axis of the image ellipse, mm; of a B that is no ellipse (a gross error), its natural length."""
        if is_ellipse(self.B):
            return float(np.min(geometric_from_conic(self.B).semi_axes))
        return float(self.natural_B[2])

    @property
    def natural_B(self) -> Array:
        """Sizes (5,) of B_1 ... B_5 of an ellipse as far from the origin as this one: 1, 1, L, L, L^2."""
        length = float(np.sqrt(np.sum(self.B[2:4] ** 2) / 4 + abs(self.B[4])))
        return np.array([1.0, 1.0, length, length, length**2])


def _numbers(what: str, values: ArrayLike) -> Array:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be numbers, not {type(values).__name__} of something else") from error


def _check_setup(setup: Setup) -> None:
    """Refuse a setup that is no camera and beam."""
    values = _numbers("the setup (f, e_x, e_y, r)", setup)
    if values.shape != (4,) or not np.isfinite(values).all() or values[0] <= 0 or values[3] <= 0:
        raise InputError(f"the setup needs finite f > 0, e_x, e_y and r > 0 in mm, not {tuple(values.tolist())}")


def _covariances(n: int, noise: ArrayLike) -> Array:
    """Covariances (n, 2, 2) from a sigma for all, a sigma for each, or covariances."""
    given = _numbers("noise", noise)
    if given.shape not in ((), (n,), (n, 2, 2)):
        raise InputError(f"noise must be one sigma, {n} sigmas or {n} 2x2 covariances (mm), not of shape {given.shape}")
    usable = np.isfinite(given).all() and (given.ndim == 3 or (given > 0).all())
    if not usable:
        raise InputError("noise must be finite, and a sigma positive (mm)")
    if given.ndim == 3:
        return given
    return np.broadcast_to(given, (n,))[:, None, None] ** 2 * np.eye(2)
