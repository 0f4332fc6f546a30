"""Grey profiles across the boundary, and the model that is fitted to all of them at once.

Every normal has its own position, background and brightness; one width is shared round the spot. The parameters of one
normal meet those of another only through that width, so the normal equations have an arrow's shape and the width is
eliminated last (variable projection in its Gauss-Newton form).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import ndtr

from planeopt.spot.points import Kind

Array = NDArray[np.float64]

STEP = 0.5
"""Distance between the samples of a profile, px: half a pixel, so that nothing of the image is lost."""


class Sampler:
    """Cubic spline interpolation of the part of an image that matters.

    Parameters
    ----------
    values : (H, W) array
        The image.
    box : tuple of int
        ``x0, y0, x1, y1`` of the part, upper ends excluded.
    """

    def __init__(self, values: NDArray[np.float32], box: tuple[int, int, int, int]) -> None:
        x0, y0, x1, y1 = box
        self._origin = np.array([x0, y0])
        self._size = np.array([x1 - x0, y1 - y0])
        self._coefficients = spline_filter(values[y0:y1, x0:x1].astype(np.float64), order=3, mode="mirror")

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points (..., 2) lie on the part."""
        local = points - self._origin
        return np.asarray(((local >= 0) & (local <= self._size - 1)).all(axis=-1))

    def __call__(self, points: Array) -> Array:
        """Return the grey values at points (..., 2), px."""
        local = points - self._origin
        return map_coordinates(
            self._coefficients, [local[..., 1], local[..., 0]], order=3, mode="mirror", prefilter=False
        )


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """What the profiles say; N normals.

    Parameters
    ----------
    position : (N,) array
        Place of the half height (of the ridge) along the normal, px, outwards.
    variance : (N,) array
        Of `position` for white noise of unit variance in the pixels, px^2.
    height : (N,) array
        Of the edge (the ridge) over its background.
    background : (N,) array
        Level outside a disc; either side of a ring.
    rms : (N,) array
        Of the samples about the model.
    width : float
        Standard deviation of the profile, px, shared.
    """

    position: Array
    variance: Array
    height: Array
    background: Array
    rms: Array
    width: float


def half_level_start(profiles: Array, t: Array) -> tuple[Array, Array, float]:
    """Return where each edge crosses half its height, its height, and the width of the typical edge.

    Parameters
    ----------
    profiles : (N, M) array
        Bright at the start, dark at the end.
    t : (M,) array
        Places of the samples along the normal, px.

    Returns
    -------
    position : (N,) array
        Linear interpolation at the crossing nearest to the middle; NaN where there is none.
    height : (N,) array
    width : float
        Standard deviation of the error function with the median edge's spread, px.
    """
    fifth = max(2, len(t) // 5)
    inner = np.median(profiles[:, :fifth], axis=1)
    outer = np.median(profiles[:, -fifth:], axis=1)
    height = inner - outer
    safe = np.where(height > 0, height, np.inf)
    relative = (profiles - outer[:, None]) / safe[:, None]
    crossings = {q: _falling_crossing(relative, t, q) for q in (0.25, 0.5, 0.75)}
    spread = crossings[0.25] - crossings[0.75]
    spread = spread[np.isfinite(spread) & (spread > 0)]
    # Between its quartiles an error function of unit standard deviation is 1.349 wide.
    width = float(np.median(spread)) / 1.349 if spread.size else 1.0
    return crossings[0.5], height, max(width, 0.4)


def ridge_start(profiles: Array, t: Array) -> tuple[Array, Array, float]:
    """Return where each ridge peaks, its height, and the width of the typical ridge (as `half_level_start`)."""
    fifth = max(2, len(t) // 5)
    base = (np.median(profiles[:, :fifth], axis=1) + np.median(profiles[:, -fifth:], axis=1)) / 2
    peak = profiles.argmax(axis=1)
    height = profiles.max(axis=1) - base
    above = (profiles - base[:, None]) > height[:, None] / 2
    # At half its height a Gaussian of unit standard deviation is 2.355 wide.
    width = float(np.median(above.sum(axis=1))) * (t[1] - t[0]) / 2.355
    return t[peak], height, max(width, 0.4)


def _falling_crossing(relative: Array, t: Array, level: float) -> Array:
    falls = (relative[:, :-1] >= level) & (relative[:, 1:] < level)
    distance = np.where(falls, np.abs(t[:-1] + t[1:]), np.inf)
    index = distance.argmin(axis=1)
    rows = np.arange(len(relative))
    before, after = relative[rows, index], relative[rows, index + 1]
    found = falls[rows, index]
    share = (before - level) / np.where(found, before - after, 1.0)
    return np.where(found, t[index] + share * (t[1] - t[0]), np.nan)


def fit_profiles(
    profiles: Array, t: Array, kind: Kind, position: Array, width: float, use: NDArray[np.bool_]
) -> ProfileFit:
    """Fit the model to all profiles by least squares.

    With ``x = t - position``, outwards. Disc: ``B + P Phi(-x/w) + S (x Phi(-x/w) - w phi(x/w))``, a background, and a
    plateau with a slope that ends at 0, both blurred by a Gaussian of standard deviation ``w``.
    Ring: ``B + D t + P exp(-x^2/2w^2)``.

    Parameters
    ----------
    profiles : (N, M) array
    t : (M,) array
        Places of the samples, px.
    kind : {"disc", "ring"}
    position : (N,) array
        Start, px; finite.
    width : float
        Start of the shared width, px.
    use : (N,) bool array
        Normals that have a say in the shared width.
    """
    terms = model_terms(kind)
    linear = np.zeros((len(profiles), 3))
    reach = 0.75 * np.abs(t).max()
    share = use.astype(np.float64)
    for step in range(8):
        basis, _, _ = terms(t, position, width, linear)
        linear = _solve(basis, profiles)
        basis, by_position, by_width = terms(t, position, width, linear)
        residual = profiles - np.einsum("nmk,nk->nm", basis, linear)
        jacobian = np.concatenate([basis, by_position[:, :, None]], axis=2)
        normal = _normal_matrix(jacobian)
        gradient = np.einsum("nmk,nm->nk", jacobian, residual)
        coupling = np.einsum("nmk,nm->nk", jacobian, by_width)
        solved = np.linalg.solve(normal, np.stack([gradient, coupling], axis=2))
        stiffness = share @ ((by_width**2).sum(axis=1) - (coupling * solved[:, :, 1]).sum(axis=1))
        pull = share @ ((by_width * residual).sum(axis=1) - (coupling * solved[:, :, 0]).sum(axis=1))
        change = float(np.clip(pull / max(stiffness, 1e-30), -0.3 * width, 0.5 * width))
        move = solved[:, 3, 0] - change * solved[:, 3, 1]
        # A start may be a pixel or two off; a longer step than the width leaves the region where the edge is seen.
        position = np.clip(position + np.clip(move, -width, width), -reach, reach)
        width = max(width + change, 0.2)
        if step > 1 and abs(change) < 1e-4 * width and np.abs(move[use]).max(initial=0.0) < 1e-3:
            break
    basis, by_position, _ = terms(t, position, width, linear)
    linear = _solve(basis, profiles)
    basis, by_position, _ = terms(t, position, width, linear)
    residual = profiles - np.einsum("nmk,nk->nm", basis, linear)
    inverse = np.linalg.inv(_normal_matrix(np.concatenate([basis, by_position[:, :, None]], axis=2)))
    degrees = max(len(t) - 4, 1)
    return ProfileFit(
        position=position,
        # Samples closer than a pixel share its noise: they count by the length they cover, not by their number.
        variance=inverse[:, 3, 3] / (t[1] - t[0]),
        height=linear[:, 1],
        background=linear[:, 0],
        rms=np.sqrt((residual**2).sum(axis=1) / degrees),
        width=width,
    )


def model_terms(kind: Kind) -> Callable[[Array, Array, float, Array], tuple[Array, Array, Array]]:
    """Return the model of `fit_profiles` as a function of places, positions, width and linear parameters (N, 3).

    It returns the basis (N, M, 3) of the linear parameters (background, height, slope) and the derivatives (N, M) by
    position and by width.
    """
    return _disc_terms if kind == "disc" else _ring_terms


def _disc_terms(t: Array, position: Array, width: float, linear: Array) -> tuple[Array, Array, Array]:
    x = t - position[:, None]
    step = ndtr(-x / width)
    density = np.exp(-((x / width) ** 2) / 2) / np.sqrt(2 * np.pi)
    plateau, slope = linear[:, 1, None], linear[:, 2, None]
    basis = np.stack([np.ones_like(x), step, x * step - width * density], axis=2)
    by_position = plateau * density / width - slope * step
    by_width = plateau * density * x / width**2 - slope * density
    return basis, by_position, by_width


def _ring_terms(t: Array, position: Array, width: float, linear: Array) -> tuple[Array, Array, Array]:
    x = t - position[:, None]
    bell = np.exp(-((x / width) ** 2) / 2)
    ridge = linear[:, 1, None] * bell
    basis = np.stack([np.ones_like(x), bell, np.broadcast_to(t, x.shape)], axis=2)
    return basis, ridge * x / width**2, ridge * x**2 / width**3


def _normal_matrix(jacobian: Array) -> Array:
    matrix = np.matmul(jacobian.transpose(0, 2, 1), jacobian)
    # A profile without an edge has no position: a ridge far below the noise keeps its equations solvable.
    trace = np.trace(matrix, axis1=1, axis2=2)
    size = matrix.shape[-1]
    return matrix + (1e-12 * trace + 1e-30)[:, None, None] * np.eye(size)


def _solve(basis: Array, profiles: Array) -> Array:
    right = np.einsum("nmk,nm->nk", basis, profiles)
    return np.linalg.solve(_normal_matrix(basis), right[:, :, None])[:, :, 0]
