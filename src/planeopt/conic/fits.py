"""Fit the image ellipse (16) to boundary points, with its covariance; refuse what is no ellipse.

All fits compute in coordinates centred on the points and scaled by a power of two, and undo that exactly. Points come
in any number of leading dimensions: thousands of draws of a Monte Carlo study are one call.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from planeopt.conic import estimators
from planeopt.conic.ellipse import (
    BoolArray,
    Ellipse,
    FloatArray,
    conic_matrix,
    dual_conic,
    geometric_from_conic,
    is_ellipse,
)
from planeopt.conic.refusals import line_explains, raise_for, undetermined_verdict, verdict_of_shape
from planeopt.conic.sample import EPS, Sample, Verdict, prepare, replace_unusable
from planeopt.conic.transport import conic_from_local, local_jacobian
from planeopt.errors import InputError

Method = Literal["maximum_likelihood", "taubin", "direct", "least_squares"]

CHUNK = 1 << 14
"""Points worked on at once: the arrays of one piece stay in the processor's cache."""

UNIT_CIRCLE = (0.0, 1.0, 0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True)
class ConicFit:
    """Image ellipses fitted to points, one for each set of points; `...` are the leading dimensions of the points.

    Attributes
    ----------
    B : (..., 5) array
        Coefficients of (16); NaN where `ok` is false.
    sqrt_covariance : (..., 5, 5) array or None
        S with `S S'` the covariance of B, to first order in the noise; computed without squaring condition numbers.
        None if the noise was not given and 5 points leave nothing to estimate it from.
    method : str
        The estimator.
    n_points, dof : int
        N and N - 5.
    chi2 : (...) array or None
        Sum of squared Sampson distances over their own variance. None if the noise was estimated from them.
    scale : (...) array or None
        Square root of the sum of squared Sampson distances over `dof`: a pure number near 1 if the noise was given and
        right, else the estimated sigma in the unit of the points. Nothing is added to it: exact points give about 1e-16
        of their size. None if `dof` is 0.
    scale_estimated : bool
        Whether the covariance rests on `scale` because no noise was given.
    verdict : (...) array of int
        A `Verdict` for each set.
    origin, unit : (..., 2) and (...) arrays
        The local coordinates `u = (x - origin) / unit` in which the fit was made.
    B_local, sqrt_covariance_local : (..., 5) array, and (..., 5, 5) array or None
        The fit in local coordinates, where nothing cancels: B of a small ellipse far from the origin holds its size
        only in the last digits of B5.
    """

    B: FloatArray
    sqrt_covariance: FloatArray | None
    method: Method
    n_points: int
    dof: int
    chi2: FloatArray | None
    scale: FloatArray | None
    scale_estimated: bool
    verdict: np.ndarray
    origin: FloatArray
    unit: FloatArray
    B_local: FloatArray
    sqrt_covariance_local: FloatArray | None

    @property
    def ok(self) -> BoolArray:
        """Whether the points gave an ellipse, shape (...)."""
        return np.asarray(self.verdict == Verdict.OK)

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of B, shape (..., 5, 5), or None."""
        S = self.sqrt_covariance
        return None if S is None else S @ np.swapaxes(S, -1, -2)

    @property
    def whitener(self) -> FloatArray:
        """W, shape (..., 5, 5), with `W covariance W' = I`: the inverse of `sqrt_covariance`, by local coordinates.

        Raises
        ------
        planeopt.errors.InputError
            There is no covariance to whiten with: 5 points and no noise given, or exact points and no noise given.
        """
        S = self.sqrt_covariance_local
        if S is None:
            raise InputError("5 points leave nothing to estimate their noise from; give sigma")
        if np.any(S[..., 0, 0] == 0):
            raise InputError("the points lie on the ellipse exactly, so their noise cannot be estimated; give sigma")
        # The inverse of the map to local coordinates is such a map too.
        return np.linalg.solve(S, local_jacobian(-self.origin / self.unit[..., None], 1 / self.unit))

    @property
    def matrix(self) -> FloatArray:
        """Symmetric matrix of the conic, shape (..., 3, 3)."""
        return conic_matrix(self.B)

    @property
    def dual(self) -> FloatArray:
        """Dual conic, shape (..., 3, 3)."""
        return dual_conic(self.B)

    @property
    def ellipse(self) -> Ellipse:
        """Centre, semi-axes and angle, from the local coordinates.

        Raises
        ------
        planeopt.errors.InputError
            A fit is not ok.
        """
        local = geometric_from_conic(self.B_local)
        unit = self.unit[..., None]
        return Ellipse(self.origin + unit * local.centre, unit * local.semi_axes, local.angle)


def fit_conic(
    points: ArrayLike, noise: ArrayLike | None = None, method: Method = "maximum_likelihood", *, check: bool = True
) -> ConicFit:
    """Fit (16) to points.

    Parameters
    ----------
    points : (..., N, 2) array
        Boundary points, N >= 5, in one unit throughout (mm on the image plane).
    noise : float, (..., N) array or (..., N, 2, 2) array, optional
        Standard deviation of the points, isotropic, in their unit; or the covariance of each. Leading dimensions
        broadcast. Without it the noise is taken to be isotropic and equal, its size estimated from the residuals.
    method : {"maximum_likelihood", "taubin", "direct", "least_squares"}
        `maximum_likelihood` minimises the Sampson distances and reaches the bound; `taubin` is the best of the
        algebraic fits; `direct` always finds an ellipse, a far too small one on short arcs; `least_squares` is the
        paper's. The last two ignore the noise, except in the covariance.
    check : bool
        Raise for the first set of points that gives no ellipse. If false, such sets cost only themselves: `verdict`
        says what they are and their numbers are NaN.

    Returns
    -------
    ConicFit
        Coefficients, covariance and quality.

    Raises
    ------
    planeopt.errors.InputError
        A shape does not fit, N < 5, or (with `check`) values are not finite, the noise is not positive, fewer than 5
        points are distinct, they lie on one or two lines or on no ellipse, or the fit did not converge.
    """
    if method not in get_args(Method):
        raise InputError(f"unknown conic fit {method!r}; choose one of {', '.join(get_args(Method))}")
    sample, verdict, lead = prepare(points, noise)
    n = sample.u.shape[1]
    size = max(1, CHUNK // n)
    parts = [
        _fit_chunk(sample.take(slice(i, i + size)), verdict[i : i + size], method, noise is None)
        for i in range(0, len(verdict), size)
    ]
    joined = _Chunk(*(np.concatenate(values) for values in zip(*map(_values, parts), strict=True)))
    if check and np.any(joined.verdict):
        raise_for(int(np.flatnonzero(joined.verdict)[0]), joined.verdict, points, noise)
    return _assemble(joined, sample, lead, method, noise is None)


def maximum_likelihood(points: ArrayLike, noise: ArrayLike | None = None, *, check: bool = True) -> ConicFit:
    """Fit by maximum likelihood: the least sum of squared Sampson distances over their variance (see `fit_conic`)."""
    return fit_conic(points, noise, "maximum_likelihood", check=check)


def taubin(points: ArrayLike, noise: ArrayLike | None = None, *, check: bool = True) -> ConicFit:
    """Fit by Taubin's method (1991), the least bias of the one-step algebraic fits (see `fit_conic`)."""
    return fit_conic(points, noise, "taubin", check=check)


def direct(points: ArrayLike, noise: ArrayLike | None = None, *, check: bool = True) -> ConicFit:
    """Fit by Fitzgibbon's method as made stable by Halir & Flusser (1998).

    It answers with an ellipse whatever the points are, a hyperbola's included, and shrinks short arcs: semi-axes of
    100 and 60 px with 0.3 px of noise come out 0.5 and 0.8 px too small on 40 % of the arc, 21 and 15 px on 25 %, where
    maximum likelihood errs by 0.02, and by 0.5 and 0.2 px.
    """
    return fit_conic(points, noise, "direct", check=check)


def least_squares(points: ArrayLike, noise: ArrayLike | None = None, *, check: bool = True) -> ConicFit:
    """Fit by the paper's least squares: the least `sum (x^2 + B1 x y + ... + B5)^2` (see `fit_conic`)."""
    return fit_conic(points, noise, "least_squares", check=check)


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Fits of some sets in local coordinates."""

    B: FloatArray
    factor: FloatArray
    chi2: FloatArray
    verdict: np.ndarray


def _values(chunk: _Chunk) -> list[np.ndarray]:
    return [getattr(chunk, field.name) for field in fields(chunk)]


def _fit_chunk(sample: Sample, verdict: np.ndarray, method: Method, scale_unknown: bool) -> _Chunk:
    theta, spread = estimators.taubin(sample)
    reach = 1 + np.max(np.abs(sample.origin), axis=-1) / sample.unit
    undetermined = (spread <= 64 * EPS * reach) & (verdict == 0)
    line = line_explains(sample, scaled(theta), scale_unknown) & ~undetermined & (verdict == 0)
    if np.any(undetermined | line):
        verdict = np.where(line, Verdict.LINE, verdict)
        verdict = np.where(undetermined, undetermined_verdict(sample.u), verdict)
        sample = replace_unusable(sample, undetermined | line)
        theta, _ = estimators.taubin(sample)
    B, converged = _ESTIMATORS[method](sample, theta)
    shape = verdict_of_shape(np.concatenate([np.ones((len(B), 1)), B], axis=-1))
    if np.any((shape != 0) | ~converged):
        # What the points lie on shows best in the fit that may be any conic: others may have fled to infinity.
        any_shape = verdict_of_shape(theta)
        shape = np.where(converged, shape, Verdict.NOT_CONVERGED)
        shape = np.where((shape != 0) & (any_shape != 0), any_shape, shape)
    verdict = np.where(verdict == 0, shape, verdict)
    bad = verdict != 0
    if np.any(bad):
        B, sample = np.where(bad[:, None], UNIT_CIRCLE, B), replace_unusable(sample, bad)
    if method == "maximum_likelihood":
        factor = estimators.factor_maximum_likelihood(sample, B)
    else:
        factor = estimators.factor_algebraic(sample, B, weighted=method == "taubin")
    return _Chunk(B, factor, estimators.chi_squared(sample, B), verdict)


def scaled(theta: FloatArray) -> FloatArray:
    """Return B of six coefficients; a conic without x^2 gets coefficients so large that it is seen to be no ellipse."""
    b0 = theta[:, :1]
    tiny = EPS * EPS * np.max(np.abs(theta), axis=-1, keepdims=True)
    return theta[:, 1:] / np.where(np.abs(b0) > tiny, b0, tiny)


def _start_and_maximise(sample: Sample, theta: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Start from Taubin's fit, or from the direct one where Taubin's is no ellipse."""
    start = scaled(theta)
    real = is_ellipse(start)
    if not np.all(real):
        start = np.where(real[:, None], start, estimators.direct(sample))
    return estimators.maximum_likelihood(sample, start)


def _always(B: FloatArray) -> tuple[FloatArray, BoolArray]:
    return B, np.ones(len(B), dtype=bool)


_ESTIMATORS: dict[Method, Callable[[Sample, FloatArray], tuple[FloatArray, BoolArray]]] = {
    "maximum_likelihood": _start_and_maximise,
    "taubin": lambda _, theta: _always(scaled(theta)),
    "direct": lambda sample, _: _always(estimators.direct(sample)),
    "least_squares": lambda sample, _: _always(estimators.least_squares(sample)),
}
"""Each takes sets of points and Taubin's fit of them, and returns B and where it converged."""


def _assemble(chunk: _Chunk, sample: Sample, lead: tuple[int, ...], method: Method, scale_unknown: bool) -> ConicFit:
    n = sample.u.shape[1]
    dof = n - 5
    bad = chunk.verdict != 0
    if np.any(bad):
        B, factor, chi2 = (np.where(_like(bad, v), np.nan, v) for v in (chunk.B, chunk.factor, chunk.chi2))
        chunk = _Chunk(B, factor, chi2, chunk.verdict)
    scale = np.sqrt(chunk.chi2 / dof) if dof else None
    factor = chunk.factor
    if scale_unknown:
        factor = None if scale is None else factor * scale[:, None, None]
    raw_factor = None if factor is None else local_jacobian(sample.origin, sample.unit) @ factor

    def shaped(values: np.ndarray) -> np.ndarray:
        return values.reshape((*lead, *values.shape[1:]))

    return ConicFit(
        B=shaped(conic_from_local(chunk.B, sample.origin, sample.unit)),
        sqrt_covariance=None if raw_factor is None else shaped(raw_factor),
        method=method,
        n_points=n,
        dof=dof,
        chi2=None if scale_unknown else shaped(chunk.chi2),
        scale=None if scale is None else shaped(scale),
        scale_estimated=scale_unknown and dof > 0,
        verdict=shaped(chunk.verdict),
        origin=shaped(sample.origin),
        unit=shaped(sample.unit),
        B_local=shaped(chunk.B),
        sqrt_covariance_local=None if factor is None else shaped(factor),
    )


def _like(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    return mask.reshape(-1, *([1] * (values.ndim - 1)))
