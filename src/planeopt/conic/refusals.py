"""Points that are no ellipse: how they are told, and the sentence that says so."""

from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from planeopt.conic.ellipse import BoolArray, FloatArray, conic_matrix, is_ellipse
from planeopt.conic.estimators import chi_squared
from planeopt.conic.sample import EPS, Sample, Verdict, line_offsets
from planeopt.errors import InputError

LINE_PAIR_TOLERANCE = 1e-9
"""A conic whose determinant is below this, relative to its coefficients, is a pair of lines."""

PARABOLA_TOLERANCE = 1e-10
"""A quadratic part whose determinant is below this, relative to its coefficients, is a parabola's: beyond an axis ratio
of 1e5 rounding would decide whether the conic closes."""

_ON = {
    Verdict.LINE_PAIR: "a pair of straight lines",
    Verdict.HYPERBOLA: "a hyperbola",
    Verdict.PARABOLA: "a parabola",
    Verdict.IMAGINARY: "no real curve of second degree",
}


def verdict_of_shape(theta: FloatArray) -> np.ndarray:
    """Return what conics (K, 6), of any scale, in local coordinates are: `OK` for a real ellipse."""
    norm = np.linalg.norm(theta, axis=-1, keepdims=True)
    finite = np.isfinite(norm[:, 0])
    theta = np.where(finite[:, None], theta, 1.0) / np.where(finite[:, None], norm, 1.0)
    a, b, c = theta[:, 0], theta[:, 1], theta[:, 2]
    det = a * c - b * b / 4
    size = a * a + b * b / 2 + c * c
    b0 = np.where(a == 0, 1.0, a)
    with np.errstate(over="ignore", invalid="ignore"):
        real = is_ellipse(theta[:, 1:] / b0[:, None]) & (det > PARABOLA_TOLERANCE * size)
    if np.all(real):
        return np.zeros(len(theta), dtype=int)
    verdict = np.where(real, Verdict.OK, Verdict.IMAGINARY)
    verdict = np.where(det < 0, Verdict.HYPERBOLA, verdict)
    verdict = np.where(np.abs(det) <= PARABOLA_TOLERANCE * size, Verdict.PARABOLA, verdict)
    C = conic_matrix(theta[:, 1:])
    C[:, 0, 0] = a
    lines = (np.abs(np.linalg.det(C)) <= LINE_PAIR_TOLERANCE) & (verdict != Verdict.OK)
    verdict = np.where(lines, Verdict.LINE_PAIR, verdict)
    return np.where(finite, verdict, Verdict.NOT_CONVERGED)


def undetermined_verdict(u: FloatArray) -> np.ndarray:
    """Return why more than one conic passes through sets of points (K, N, 2)."""
    few = [len(np.unique(points, axis=0)) < 5 for points in u]
    return np.where(few, Verdict.TOO_FEW, Verdict.LINE_PAIR)


def line_explains(sample: Sample, B: FloatArray, scale_unknown: bool) -> BoolArray:
    """Tell, (K,), where a straight line fits the points within their noise, so that an ellipse would be invented.

    The mean square distance from the line, over the noise or, if that is unknown, over the residual of the conics B, is
    at most three standard deviations of that of pure noise above one.
    """
    n = sample.u.shape[1]
    offsets, normal = line_offsets(sample.u)
    nx, ny = normal[:, :1], normal[:, 1:]
    variance = nx * nx * sample.cxx + 2 * nx * ny * sample.cxy + ny * ny * sample.cyy
    level = np.sum(offsets * offsets / variance, axis=-1) / (n - 2)
    expected = 1 + 3 * np.sqrt(2 / (n - 2))
    if not scale_unknown:
        return level <= expected
    rounding = 1 + np.max(np.abs(sample.origin), axis=-1) / sample.unit
    residual = chi_squared(sample, B) / (n - 5) if n > 5 else np.zeros(len(B))
    return level <= expected * np.maximum(residual, (EPS * rounding * sample.unit) ** 2)


def raise_for(index: int, verdicts: np.ndarray, points: ArrayLike, noise: ArrayLike | None) -> NoReturn:
    """Raise the refusal of one set of points.

    Raises
    ------
    InputError
        Always: one line with the set's index if there are several, the counts, and the first row at fault.
    """
    array = np.asarray(points, dtype=float)
    n = array.shape[-2]
    rows = array.reshape(-1, n, 2)[index]
    where = f"set {index} of {len(verdicts)}: " if len(verdicts) > 1 else ""
    raise InputError(where + _sentence(Verdict(int(verdicts[index])), rows, index, array.shape[:-2], noise))


def _sentence(verdict: Verdict, rows: FloatArray, index: int, lead: tuple[int, ...], noise: ArrayLike | None) -> str:
    n = len(rows)
    if verdict is Verdict.NOT_FINITE:
        bad = np.flatnonzero(~np.all(np.isfinite(rows), axis=-1))
        return f"{len(bad)} of {n} points have a coordinate that is not finite, first in row {bad[0]}"
    if verdict is Verdict.BAD_NOISE:
        return _noise_sentence(np.asarray(noise, dtype=float), index, lead, n)
    distinct = len(np.unique(rows, axis=0))
    if distinct < 5:
        return f"only {distinct} of the {n} points are distinct; an ellipse needs at least 5"
    if verdict is Verdict.LINE:
        return f"the {n} points lie on a straight line (within their noise), not on an ellipse"
    if verdict is Verdict.NOT_CONVERGED:
        return f"the ellipse fit to {n} points did not converge: too much noise for so thin an ellipse, or for so few"
    return f"the {n} points lie on {_ON[verdict]}, not on an ellipse"


def _noise_sentence(noise: FloatArray, index: int, lead: tuple[int, ...], n: int) -> str:
    if noise.ndim >= 3 and noise.shape[-2:] == (2, 2):
        V = np.broadcast_to(noise, (*lead, n, 2, 2)).reshape(-1, n, 2, 2)[index]
        det = V[:, 0, 0] * V[:, 1, 1] - V[:, 0, 1] ** 2
        good = (V[:, 0, 0] > 0) & (V[:, 1, 1] > 0) & (det > 4 * EPS * V[:, 0, 0] * V[:, 1, 1]) & np.isfinite(det)
        bad = np.flatnonzero(~good)
        return f"{len(bad)} of {n} point covariances are not positive definite, first in row {bad[0]}"
    if noise.ndim == 0:
        return f"sigma must be positive and finite; it is {float(noise):g}"
    sigma = np.broadcast_to(noise, (*lead, n)).reshape(-1, n)[index]
    bad = np.flatnonzero(~((sigma > 0) & np.isfinite(sigma)))
    return f"{len(bad)} of {n} sigmas are not positive and finite, first in row {bad[0]} ({sigma[bad[0]]:g})"
