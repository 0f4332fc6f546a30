"""Five coefficients from points, in local coordinates: the estimators themselves.

Each takes K sets of N points at once and answers with shape (K, 5) or (K, 6). Nothing here squares a condition number:
the coefficients come from QR and SVD of the design matrix, never from its scatter matrix, except in the steps of
Gauss-Newton, whose fixed point does not depend on how exactly a step is solved.

The monomials of a point are `xi = (x^2, x y, y^2, x, y, 1)`; `A` are the last five, so that `Q = x^2 + A B`.
"""

import numpy as np

from planeopt.conic.ellipse import BoolArray, FloatArray
from planeopt.conic.sample import EPS, Sample

MAX_STEPS = 100
"""Steps of Gauss-Newton; three to six are usual."""

STEP_TOLERANCE = 1e-7
"""A step below this many standard deviations ends the iteration. The step after it would be shorter by the noise over
the ellipse's size, so what is missing is far below 1e-9 standard deviations."""

VANISHED = 1e-200
"""Information about the coefficients, over that at the start, below which there is none."""


def monomials(u: FloatArray) -> FloatArray:
    """Return xi, shape (K, N, 6)."""
    x, y = u[..., 0], u[..., 1]
    D = np.empty((*x.shape, 6))
    D[..., 0], D[..., 1], D[..., 2] = x * x, x * y, y * y
    D[..., 3], D[..., 4], D[..., 5] = x, y, 1.0
    return D


def gradients(B: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the two components, (K, N) each, of the gradient of Q at the points."""
    x, y, b = u[..., 0], u[..., 1], B[:, None, :]
    return 2 * x + b[..., 0] * y + b[..., 2], b[..., 0] * x + 2 * b[..., 1] * y + b[..., 3]


def residual_variance(sample: Sample, B: FloatArray) -> FloatArray:
    """Return the first-order variance of Q at the points, (K, N): `g' V g`."""
    gx, gy = gradients(B, sample.u)
    return gx * (sample.cxx * gx + 2 * sample.cxy * gy) + sample.cyy * gy * gy


def chi_squared(sample: Sample, B: FloatArray) -> FloatArray:
    """Return the sum of squared Sampson distances over their variance, (K,)."""
    D = monomials(sample.u)
    value = D[..., 0] + (D[..., 1:] @ B[..., None])[..., 0]
    return np.sum(value * value / residual_variance(sample, B), axis=-1)


def _weights(sample: Sample) -> FloatArray:
    """Return the inverse mean variance of each point over its mean, (K, N) or (K, 1)."""
    weights = 1 / (sample.cxx + sample.cyy)
    return weights / np.mean(weights, axis=-1, keepdims=True)


def taubin(sample: Sample) -> tuple[FloatArray, FloatArray]:
    """Minimise `sum w Q^2 / sum w tr(J V J')` over all conics (Taubin 1991).

    With different noise from point to point, w is the inverse of its mean variance and V its covariance over that.

    Returns
    -------
    theta : (K, 6) array
        All six coefficients, scale and sign free: the best conic may be a hyperbola.
    spread : (K,) array
        How well the points determine one conic, 0 to 1: the RMS distance of the points from the second best conic over
        that from the worst. Rounding level means that a whole family of conics passes through the points.
    """
    x, y = sample.u[..., 0], sample.u[..., 1]
    weights = np.broadcast_to(_weights(sample), x.shape)
    D = monomials(sample.u)[..., :5]
    mean = np.mean(weights[..., None] * D, axis=1)
    R = _triangle(np.sqrt(weights)[..., None] * (D - mean[:, None, :]))
    zero, one = np.zeros_like(x), np.ones_like(x)
    Jx, Jy = np.stack([2 * x, y, zero, one, zero], axis=-1), np.stack([zero, x, 2 * y, zero, one], axis=-1)
    wxx, wxy, wyy = (weights * c for c in _shape(sample))
    N = _transpose(Jx) @ (wxx[..., None] * Jx + wxy[..., None] * Jy)
    N += _transpose(Jy) @ (wxy[..., None] * Jx + wyy[..., None] * Jy)
    L = np.linalg.cholesky(N)
    _, singular, Vt = np.linalg.svd(_transpose(np.linalg.solve(L, _transpose(R))))
    theta = np.linalg.solve(_transpose(L), Vt[:, -1, :, None])[..., 0]
    constant = -np.sum(mean * theta, axis=-1, keepdims=True)
    return np.concatenate([theta, constant], axis=-1), singular[:, 3] / singular[:, 0]


def _shape(sample: Sample) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the covariances over their mean variance: what is left of the noise once the weights carry its size."""
    mean = (sample.cxx + sample.cyy) / 2
    return sample.cxx / mean, sample.cxy / mean, sample.cyy / mean


def least_squares(sample: Sample) -> FloatArray:
    """Minimise `sum (x^2 + B1 x y + ... + B5)^2`, the paper's fit of (16).

    Shift and one common scale map B to B linearly and multiply every residual by the same number: the minimum in local
    coordinates is the minimum in the coordinates of the points.
    """
    D = monomials(sample.u)
    Q, R = np.linalg.qr(D[..., 1:])
    return np.linalg.solve(_invertible(R), -(_transpose(Q) @ D[..., :1]))[..., 0]


def direct(sample: Sample) -> FloatArray:
    """Minimise `sum Q^2` under `4 b0 b2 - b1^2 = 1` (Fitzgibbon et al. 1999, in the blocks of Halir & Flusser 1998)."""
    D = monomials(sample.u)
    Q2, R2 = np.linalg.qr(D[..., 3:])
    projected = _transpose(Q2) @ D[..., :3]
    _, singular, Vt = np.linalg.svd(_triangle(D[..., :3] - Q2 @ projected))
    # The pencil (constraint, scatter) in the singular basis, scaled by the singular values: exact points make it
    # graded, but its one positive eigenvalue dominates, and its vector is right to rounding where the plain problem
    # loses half the digits.
    singular = np.maximum(singular, EPS * singular[:, :1])
    constraint = np.array([[0.0, 0.0, 2.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0]])
    _, vectors = np.linalg.eigh((Vt @ constraint @ _transpose(Vt)) / (singular[:, :, None] * singular[:, None, :]))
    scaled = vectors[..., -1] / singular
    quadratic = _transpose(Vt) @ (scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))[..., None]
    theta = np.concatenate([quadratic, -np.linalg.solve(R2, projected @ quadratic)], axis=1)[..., 0]
    return theta[:, 1:] / theta[:, :1]


def maximum_likelihood(sample: Sample, start: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Minimise the sum of squared Sampson distances over their variance, by damped Gauss-Newton from `start`.

    Returns
    -------
    B : (K, 5) array
        The minima; a local one may be reached from a bad start.
    converged : (K,) array of bool
        Where the last step was below `STEP_TOLERANCE`, or below what rounding of the points moves.
    """
    B, converged = start.copy(), np.zeros(len(start), dtype=bool)
    D = monomials(sample.u)
    index, damping = np.arange(len(start)), np.zeros(len(start))
    spread = np.sqrt(residual_variance(sample, B))
    # A fixed triangular preconditioner: the steps are solved in coordinates where the information starts as identity.
    P = np.linalg.inv(_invertible(_triangle(D[..., 1:] / spread[..., None])))
    floor = _rounding(sample, D, B, spread)
    current = B
    residual, J = _sampson(sample, D, current, P)
    cost = np.sum(residual * residual, axis=-1)
    for _ in range(MAX_STEPS):
        gradient = (_transpose(J) @ residual[..., None])[..., 0]
        H = _transpose(J) @ J
        diagonal = np.einsum("kii->ki", H)
        # A fit that ran off to endless coefficients has no derivatives left to come back by.
        lost = np.sum(diagonal, axis=-1) < VANISHED
        H[lost] = np.eye(5)
        # The constant part keeps H invertible; it slows a step by 1e-14 and does not move the minimum.
        diagonal += damping[:, None] * diagonal + 1e-14 * np.sum(diagonal, axis=-1, keepdims=True)
        step = -np.linalg.solve(H, gradient[..., None])[..., 0]
        gain = -np.sum(step * gradient, axis=-1)
        trial = current + (P @ step[..., None])[..., 0]
        done = ~lost & (gain <= STEP_TOLERANCE**2 * cost / D.shape[1] + floor)
        if np.all(done):
            B[index], converged[index] = trial, True
            break
        with np.errstate(all="ignore"):  # a step too far is refused below, not reported
            trial_residual, trial_J = _sampson(sample, D, trial, P)
            trial_cost = np.sum(trial_residual * trial_residual, axis=-1)
        # The residuals are known to rounding only; false for NaN.
        better = np.sqrt(trial_cost) <= np.sqrt(cost) * (1 + 1e-13) + np.sqrt(floor)
        damping = np.where(better, np.where(damping > 1e-6, damping / 10, 0.0), np.maximum(10 * damping, 1e-3))
        current = np.where((better | done)[:, None], trial, current)
        B[index], converged[index] = current, done
        go = ~(done | lost)
        residual = np.where(better[:, None], trial_residual, residual)
        J = np.where(better[:, None, None], trial_J, J)
        cost = np.where(better, trial_cost, cost)
        if not np.all(go):
            sample, index, damping = sample.take(go), index[go], damping[go]
            D, P, floor, current = D[go], P[go], floor[go], current[go]
            residual, J, cost = residual[go], J[go], cost[go]
    return B, converged


def _rounding(sample: Sample, D: FloatArray, B: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the cost, (K,), that rounding of the points and of Q alone would leave."""
    gx, gy = gradients(B, sample.u)
    offset = np.abs(sample.origin / sample.unit[:, None])
    terms = D[..., 0] + (np.abs(D[..., 1:]) @ np.abs(B)[..., None])[..., 0]
    moved = np.abs(gx) * offset[:, :1] + np.abs(gy) * offset[:, 1:]
    return EPS**2 * np.sum(((terms + moved) / spread) ** 2, axis=-1)


def _on_curve(sample: Sample, D: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Q (K, N), its variance (K, N), and A (K, N, 5) carried to the nearest point of the curve.

    The nearest point, in the metric of the noise, is `x - V g Q / (g' V g)` to first order. The carried monomials make
    exactly zero with the coefficients, so that it does not matter which coefficient was set to one; and they are the
    derivative of the Sampson distance times the root of its variance.
    """
    A, (gx, gy) = D[..., 1:], gradients(B, sample.u)
    hx, hy = sample.cxx * gx + sample.cxy * gy, sample.cxy * gx + sample.cyy * gy
    variance = gx * hx + gy * hy
    value = D[..., 0] + (A @ B[..., None])[..., 0]
    ratio = value / variance
    hx, hy = ratio * hx, ratio * hy
    carried = A.copy()
    x, y = sample.u[..., 0], sample.u[..., 1]
    carried[..., 0] -= hx * y + hy * x
    carried[..., 1] -= 2 * hy * y
    carried[..., 2] -= hx
    carried[..., 3] -= hy
    return value, variance, carried


def _sampson(sample: Sample, D: FloatArray, B: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residuals (K, N) and their derivative (K, N, 5) by preconditioned coefficients (`B = P phi`)."""
    value, variance, carried = _on_curve(sample, D, B)
    root = np.sqrt(variance)
    return value / root, (carried / root[..., None]) @ P


def factor_maximum_likelihood(sample: Sample, B: FloatArray) -> FloatArray:
    """Return S, (K, 5, 5), with `S S'` the inverse of the Fisher information `sum A' A / (g' V g)`, A on the curve."""
    _, variance, A = _on_curve(sample, monomials(sample.u), B)
    return np.linalg.inv(_invertible(_triangle(A / np.sqrt(variance)[..., None])))


def factor_algebraic(sample: Sample, B: FloatArray, weighted: bool) -> FloatArray:
    """Return S, (K, 5, 5), with `S S'` the covariance of an algebraic fit to first order.

    Near exact points all of them move by `dB = -(A' W A)^-1 A' W (g dx)`, whatever their normalisation (Kanatani 2008),
    and so share one covariance; W are the weights of `taubin` if `weighted`, else the identity; A is on the curve.
    """
    _, variance, A = _on_curve(sample, monomials(sample.u), B)
    root = np.sqrt(_weights(sample)) if weighted else np.ones((len(B), 1))
    Q, R = np.linalg.qr(A * root[..., None])
    middle = _triangle((np.sqrt(variance) * root)[..., None] * Q)
    return np.linalg.solve(_invertible(R), _transpose(middle))


def _triangle(matrix: FloatArray) -> FloatArray:
    """Return the R of QR alone."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _invertible(triangle: FloatArray) -> FloatArray:
    """Return the triangles with zeros of the diagonal, to rounding, made as small as rounding.

    A zero means that a conic without `x^2` passes through the points: B is then huge, and seen to be no ellipse.
    """
    diagonal = np.abs(np.einsum("kii->ki", triangle))
    tiny = EPS * np.max(diagonal, axis=-1, keepdims=True)
    if np.all(diagonal > tiny):
        return triangle
    return triangle + np.where(diagonal > tiny, 0.0, tiny)[..., None] * np.eye(triangle.shape[-1])


def _transpose(matrix: FloatArray) -> FloatArray:
    return np.swapaxes(matrix, -1, -2)
