"""The least noise that a boundary measured in pixels can have: the Cramer-Rao bound of its position.

A piece of boundary one pixel long is crossed by a profile ``I(x) = B + C g((x - s)/w)``: background B, height C, a
shape g of width w, position s along the normal. Pixels of unit area with independent noise of variance V sample it;
where the profile is wide against a pixel their sum is an integral, and the Fisher information of s per pixel of the
boundary's length is

    J = (C^2 / w) int g'(t)^2 / V(g(t)) dt .

With constant noise, V = noise^2, and nothing clipped,

- a step blurred by a Gaussian, ``g = Phi(-t)``: ``int g'^2 = 1 / (2 sqrt(pi))``, so
  ``sigma_s = (noise / C) sqrt(2 sqrt(pi) w)``;
- a Gaussian ridge, ``g = exp(-t^2/2)``: ``int g'^2 = sqrt(pi) / 2``, so ``sigma_s = (noise / C) sqrt(2 w / sqrt(pi))``.

A clipped pixel says only that its light was above the clipping level, which is known anyhow but for the few pixels at
that level: it counts as carrying no information, and the integral leaves it out. Clipped at the share q of its height,

- the step keeps the share ``Phi(sqrt(2) Phi^-1(q))`` of its information;
- the ridge keeps ``(2/sqrt(pi)) tau exp(-tau^2) + erfc(tau)``, with ``tau^2 = -2 ln q``.

Background, height and width cost little where they are shared round the spot: hundreds of pixels inside and outside
tell them. A disc's size alone is known worse, by the factor `size_cost`, which is large where the plateau is clipped.
Where each normal has its own plateau they cost more.

Points that stand for d pixels of boundary each have ``sigma_s / sqrt(d)``, and parameters that move the boundary along
its normal by j(l) at arc length l per unit are known with the covariance ``sigma_s^2 inv(int j j' dl)``.

The width w is that of the whole profile: the optics' blur, the pixel's own area (variance 1/12 px^2) and the beam's own
softness add in squares. Rounding to whole grey levels adds 1/12 to the noise's variance. What noise that depends on the
level says about the level is left out: this is the information in the means. `docs/measurement.md` has the derivation.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfc, i0e, ndtr, ndtri
from scipy.stats import ncx2

from planeopt.spot.points import Kind

Array = NDArray[np.float64]

_REACH = 7.0  # widths: g' is 1e-11 of its peak there
_NODES = 257


def boundary_sigma(
    kind: Kind,
    contrast: ArrayLike,
    noise: ArrayLike,
    blur: ArrayLike,
    *,
    clip: ArrayLike = np.inf,
    noise_bright: ArrayLike | None = None,
) -> Array:
    """Return the least standard deviation of the position across one pixel of boundary; arguments broadcast.

    Parameters
    ----------
    kind : {"disc", "ring"}
        A blurred step, or a ridge.
    contrast : array_like
        Height over the background, in any unit of grey.
    noise : array_like
        Standard deviation of a pixel, in the same unit; at the background if `noise_bright` is given.
    blur : array_like
        Standard deviation of the profile, px: the step's blur or the ridge's width.
    clip : array_like
        Share of the height above which pixels are clipped; at or above 1 none is.
    noise_bright : array_like, optional
        Standard deviation of a pixel at the plateau (on the ridge); the variance is linear in the level between, as
        shot noise is.

    Returns
    -------
    ndarray
        px. A boundary `d` pixels long has it over the square root of `d`. Infinite where all is clipped.
    """
    contrast, noise, blur = (np.asarray(value, dtype=np.float64) for value in (contrast, noise, blur))
    clip = np.asarray(clip, dtype=np.float64)
    if noise_bright is None:
        shape = _step(clip) if kind == "disc" else _ridge(clip)
    else:
        shape = _between(kind, clip, (np.asarray(noise_bright, dtype=np.float64) / noise) ** 2)
    with np.errstate(divide="ignore"):
        return noise / contrast * np.sqrt(blur / shape)


def point_sigma(per_pixel: ArrayLike, spacing: ArrayLike) -> Array:
    """Return the least standard deviation of independent points, each of which stands for a piece of boundary.

    Parameters
    ----------
    per_pixel : array_like
        Of `boundary_sigma`, px.
    spacing : array_like
        Length of the piece, px.
    """
    return np.asarray(per_pixel, dtype=np.float64) / np.sqrt(np.asarray(spacing, dtype=np.float64))


def size_cost(radius: float, blur: float, *, clip: float = np.inf) -> float:
    """Return by what factor a disc's size is known worse because its height and its blur have to be measured as well.

    A circle blurred by a Gaussian, exactly: a point at the distance r from its centre sees the share
    ``P(|r + blur n| < radius)`` of the height, n a standard normal vector of two components; its derivative by the
    radius is a blurred thin ring. What is known worse is the mean position of the boundary alone: centre and axes lose
    nothing. A ring's ridge is symmetric: its height and width cost it nothing to first order, if the camera's part of
    the width is known.

    Parameters
    ----------
    radius, blur : float
        px; `blur` is that of the profile.
    clip : float
        As in `boundary_sigma`. Clipped below its height an edge's place, height and width are all but one thing: the
        cost is about 15 at 0.5.
    """
    r = np.arange(max(radius - _REACH * blur, 0.0), radius + _REACH * blur, blur / 50) + blur / 100

    def seen(width: float) -> Array:
        return np.asarray(ncx2.cdf((radius / width) ** 2, 2, (r / width) ** 2), dtype=np.float64)

    by_radius = radius / blur**2 * np.exp(-(((r - radius) / blur) ** 2) / 2) * i0e(r * radius / blur**2)
    step = 1e-3 * blur
    design = np.stack([by_radius, seen(blur), (seen(blur + step) - seen(blur - step)) / (2 * step)])
    weights = np.where(seen(blur) < clip, r, 0.0)
    # The plateau inside of what is sampled tells the height as well.
    inside = (r[0] - blur / 100) ** 2 / 2 if clip > 1 else 0.0
    information = (design * weights) @ design.T * (blur / 50) + inside * np.diag([0.0, 1.0, 0.0])
    return float(np.sqrt(np.linalg.inv(information)[0, 0] * information[0, 0]))


def least_covariance(moves: Array, lengths: Array, per_pixel: ArrayLike, *, size_cost: float = 1.0) -> Array:
    """Return the least covariance (M, M) of parameters that move a boundary.

    Parameters
    ----------
    moves : (N, M) array
        Movement of N places on the boundary along its normal, px per unit of each parameter.
    lengths : (N,) array
        Length of boundary for which each place stands, px.
    per_pixel : array_like, scalar or (N,)
        Of `boundary_sigma`, px.
    size_cost : float
        Of `size_cost`: by what factor the mean position is known worse than the rest.
    """
    weights = lengths / np.broadcast_to(np.asarray(per_pixel, dtype=np.float64), lengths.shape) ** 2
    together = weights @ moves
    lost = (1 - size_cost**-2) * np.outer(together, together) / weights.sum()
    return np.asarray(np.linalg.inv((moves * weights[:, None]).T @ moves - lost), dtype=np.float64)


def _step(clip: Array) -> Array:
    share = np.clip(clip, 0.0, 1.0)
    return ndtr(np.sqrt(2) * ndtri(share)) / (2 * np.sqrt(np.pi))


def _ridge(clip: Array) -> Array:
    with np.errstate(divide="ignore"):
        tau = np.sqrt(-2 * np.log(np.clip(clip, 0.0, 1.0)))
    # At clip = 0 tau is infinite and nothing is left.
    finite = np.where(np.isfinite(tau), tau, 0.0)
    return np.where(np.isfinite(tau), finite * np.exp(-(finite**2)) + np.sqrt(np.pi) / 2 * erfc(finite), 0.0)


def _between(kind: Kind, clip: Array, ratio: Array) -> Array:
    """Integrate by Gauss and Legendre over what is not clipped, with a variance of 1 at the background."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    share = np.clip(clip, 0.0, 1.0)
    with np.errstate(divide="ignore"):
        start = -ndtri(share) if kind == "disc" else np.sqrt(-2 * np.log(share))
    start = np.clip(start, -_REACH, _REACH)[..., None]
    t = start + (_REACH - start) * (nodes + 1) / 2
    density = np.exp(-(t**2) / 2)
    level, slope = (ndtr(-t), density / np.sqrt(2 * np.pi)) if kind == "disc" else (density, t * density)
    both_sides = 1.0 if kind == "disc" else 2.0
    variance = 1 + (np.asarray(ratio)[..., None] - 1) * level
    return both_sides * np.sum(weights * slope**2 / variance, axis=-1) * (_REACH - start[..., 0]) / 2
