"""Where two edges of a chessboard cross: a model fitted to all pixels along both, for many corners at once.

Round a corner the light is ``black (1 - C) + white C`` with ``C`` the share of white, a chessboard blurred across each
of its two edges, and black and white planes that may slope. With the distances ``u``, ``v`` of a pixel from the edges
in their blurs' standard deviations, ``2 C - 1 = erf(u / sqrt 2) erf(v / sqrt 2)`` where the edges cross at a right
angle; where they do not, the blurs of the two are correlated and the sign of ``u v`` has the mean that Price's theorem
(IRE Transactions on Information Theory 4, 1958) gives. What is free: the crossing, the two directions, the two blurs,
the two planes. How the edges bend is taken from the map of the whole board.

Half-turned about the crossing the model, and the board, are the same: neither blur, nor a response that is not linear,
nor over-exposure moves the crossing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ARM = 0.42  # of a square: so far along the edges, and not into the next corner's blur
_WIDE = 4.0, 2.0  # blurs and px to each side of an edge: beyond, there is nothing but black or white
_GUARD = 2.5  # blurs from something else: a marker, the window
_BLUR_RANGE = 0.5, 12.0  # px: a sharper edge is told by the one pixel that it falls on
_STEPS = 8, 3  # of Gauss-Newton at most: with all pixels alike, and weighted by their noise
_LONGEST_STEP, _TURN_STEP, _BLUR_STEP = 1.0, 0.1, 0.4  # px, rad, and of the logarithm
_SETTLED, _CONVERGED = 5e-4, 0.01  # px: no more steps; good enough
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_OBLIQUE = 6.0  # blurs from both edges: beyond, they do not meet
_MOST_OBLIQUE = 0.97  # of the cosine between the edges
_FREE = 12
_FEWEST = 40  # pixels
_AT_ONCE = 32  # corners: their arrays stay in the processor's cache
_EDGE = 0.02  # of the way from black to white: nearer to one of them is no edge
_QUIETEST = 0.1  # of the noisier one's variance: clipped white seems to have no noise


@dataclass(frozen=True, eq=False)
class Crossings:
    """Corners to be measured, and what is known of them; K of them.

    Parameters
    ----------
    place : (K, 2) array
        mm, on the board.
    pixel : (K, 2) array
        Where they are to a pixel or two.
    first : (K, 2, 2) array
        Derivatives of the pixel by the place, px/mm.
    second : (K, 2, 2, 2) array
        Second derivatives, px/mm^2.
    white : (K,) bool array
        Whether the square right and below of the corner, as printed, is white.
    blur : (K, 2) array
        About the standard deviation of the blur across its edges, px.
    """

    place: Array
    pixel: Array
    first: Array
    second: Array
    white: Mask
    blur: Array

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, which: slice | Mask) -> "Crossings":
        return Crossings(*(values[which] for values in vars(self).values()))


@dataclass(frozen=True)
class Print:
    """What a pixel near a corner may see besides two edges, board frame, mm.

    Parameters
    ----------
    square : tuple of float
        Sides of a square.
    margin : float
        From a square's edge to its marker, the smaller one.
    window : tuple of float, optional
        x, y, width and height of a blank part.
    """

    square: tuple[float, float]
    margin: float
    window: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class CornerFits:
    """What was measured; K corners.

    Parameters
    ----------
    pixel : (K, 2) array
    sigma : (K,) array
        Standard deviation of each coordinate as the pixels' noise explains it, px.
    blur : (K, 2) array
        Standard deviation across the two edges, px.
    contrast : (K,) array
        White less black, share of full scale; negative where they are exchanged.
    misfit : (K,) array
        Root mean square of what is left over what the view's noise explains.
    residual : (K,) array
        Root mean square of what is left, share of full scale.
    covered : (K,) array
        Of the four arms' pixels, the least share that is there to be seen.
    converged : (K,) bool array
    """

    pixel: Array
    sigma: Array
    blur: Array
    contrast: Array
    misfit: Array
    residual: Array
    covered: Array
    converged: Mask

    def __getitem__(self, which: Mask) -> "CornerFits":
        return CornerFits(*(values[which] for values in vars(self).values()))

    @staticmethod
    def joined(parts: list["CornerFits"]) -> "CornerFits":
        """Return several as one."""
        return CornerFits(*(np.concatenate(values) for values in zip(*(vars(p).values() for p in parts), strict=True)))


def fit_corners(image: NDArray[np.float32], crossings: Crossings, printed: Print, longest: float) -> CornerFits:
    """Measure corners.

    Parameters
    ----------
    image : (H, W) array
        Grey values, share of full scale.
    crossings : Crossings
        At least one.
    printed : Print
    longest : float
        Of the pieces of the edges that are looked at to each side of a corner, px.
    """
    parts = [crossings[first : first + _AT_ONCE] for first in range(0, len(crossings), _AT_ONCE)]
    fits = [_gauss_newton(_Corners(image, part, printed, longest)) for part in parts]
    noise = _noise_of(fits)
    return CornerFits.joined([_measured(_gauss_newton(fit.model, fit.state, noise), noise) for fit in fits])


@dataclass(frozen=True, eq=False)
class _State:
    """What is free, but for the planes: crossing relative to the anchor, turn of the edges, their blurs."""

    shift: Array
    turn: Array
    blur: Array

    def after(self, step: Array) -> "_State":
        longest = np.maximum(np.linalg.norm(step[:, :2], axis=1, keepdims=True) / _LONGEST_STEP, 1.0)
        return _State(
            self.shift + step[:, :2] / longest,
            np.clip(self.turn + np.clip(step[:, 2:4], -_TURN_STEP, _TURN_STEP), -0.5, 0.5),
            np.clip(self.blur * np.exp(np.clip(step[:, 4:6], -_BLUR_STEP, _BLUR_STEP)), *_BLUR_RANGE),
        )


class _Corners:
    """The model of K corners, and the P pixels along the arms of each; where there are fewer the rest has no weight."""

    def __init__(self, image: NDArray[np.float32], crossings: Crossings, printed: Print, longest: float) -> None:
        self.crossings, self.printed = crossings, printed
        self.anchor = np.rint(crossings.pixel)
        self.inverse = np.linalg.inv(crossings.first)  # mm per px
        self.steepness = np.linalg.norm(self.inverse, axis=2)  # mm per px across the lines of equal x and y
        self.normals = self.inverse / self.steepness[:, :, None]
        cosine = np.clip(np.sum(self.normals[:, 0] * self.normals[:, 1], axis=1), -_MOST_OBLIQUE, _MOST_OBLIQUE)
        half = np.arcsin(cosine) / 2
        self.angles = half[:, None] * (1 + _NODES)
        self.angle_weights = half[:, None] * _WEIGHTS * 2 / np.pi
        self.sign = np.where(crossings.white, 1.0, -1.0)
        self.arm = np.minimum(np.min(_ARM * np.array(printed.square) / self.steepness, axis=1), longest)
        self.start = _State(crossings.pixel - self.anchor, np.zeros((len(crossings), 2)), crossings.blur)
        self._choose(image)

    def _choose(self, image: NDArray[np.float32]) -> None:
        """Choose the pixels."""
        height, width = image.shape
        # A rhombus of that height reaches further along its sides, the more oblique the more.
        slant = np.maximum(np.abs(np.linalg.det(self.normals)), 0.5)
        reach = int(np.ceil(np.max(self.arm / slant) + 1))
        line = np.arange(-reach, reach + 1, dtype=np.float64)
        x, y = (values.ravel() for values in np.meshgrid(line, line))
        distance = self._distances(x, y, self.start.shift)
        across, along = np.abs(distance)
        blur = self.start.blur.max(axis=1)[:, None]
        wide = _WIDE[0] * blur + _WIDE[1]
        margin = (self.printed.margin / self.steepness.max(axis=1))[:, None]
        # Where the margin is narrower than the blur the marker is seen too, but the same on both sides of the corner.
        in_white = np.minimum(np.maximum(margin - _GUARD * blur, margin / 2), wide)
        is_white = distance[0] * distance[1] * self.sign[:, None] > 0
        wanted = (np.maximum(across, along) <= self.arm[:, None]) & (
            np.minimum(across, along) <= np.where(is_white, in_white, wide)
        )
        left, top = self.anchor.T[:, :, None]
        there = wanted & (x >= -left) & (x < width - left) & (y >= -top) & (y < height - top)
        there &= ~self._blank(distance, blur)
        self.covered = _covered(distance, wanted, there)
        corner, pixel = np.nonzero(there)
        count = there.sum(axis=1)
        column = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
        shape = len(count), max(int(count.max()), 1)
        self.use = np.zeros(shape)
        self.use[corner, column] = 1.0
        self.value = np.zeros(shape)
        places = (self.anchor[corner] + np.stack([x[pixel], y[pixel]], axis=1)).astype(np.intp)
        self.value[corner, column] = image[places[:, 1], places[:, 0]]
        self.base = np.zeros((2, *shape))
        self.base[:, corner, column] = distance[:, corner, pixel]

    def _distances(self, x: Array, y: Array, shift: Array) -> Array:
        """Return the distances (2, K, P) of pixels (P,) from the two edges as the map has them run, px."""
        x, y = x - shift[:, :1], y - shift[:, 1:]
        inverse, second = self.inverse[..., None], self.crossings.second[..., None]
        first = [inverse[:, i, 0] * x + inverse[:, i, 1] * y for i in range(2)]
        squares = first[0] ** 2 / 2, first[0] * first[1], first[1] ** 2 / 2
        bends = [
            second[:, a, 0, 0] * squares[0] + second[:, a, 0, 1] * squares[1] + second[:, a, 1, 1] * squares[2]
            for a in range(2)
        ]
        return np.stack(
            [
                (first[i] - inverse[:, i, 0] * bends[0] - inverse[:, i, 1] * bends[1]) / self.steepness[:, i, None]
                for i in range(2)
            ]
        )

    def _blank(self, distance: Array, blur: Array) -> Mask:
        """Return which pixels (K, P) see the blank window, or its blurred edge."""
        if self.printed.window is None:
            return np.zeros(distance.shape[1:], dtype=np.bool_)
        x, y, width, height = self.printed.window
        blank = np.ones(distance.shape[1:], dtype=np.bool_)
        for axis, (low, high) in enumerate(((x, x + width), (y, y + height))):
            steepness = self.steepness[:, axis]
            near = (low - self.crossings.place[:, axis]) / steepness
            far = (high - self.crossings.place[:, axis]) / steepness
            blank &= (distance[axis] > near[:, None] - _GUARD * blur) & (distance[axis] < far[:, None] + _GUARD * blur)
        return blank

    def terms(self, state: _State) -> tuple[Array, Array]:
        """Return the share of white (K, P), and its derivatives (K, 6, P) by the state."""
        moved = state.shift - self.start.shift
        straight = self.base - np.einsum("kij,kj->ik", self.normals, moved)[:, :, None]
        turn, blur = state.turn.T[:, :, None], state.blur.T[:, :, None]
        distance = straight + turn * straight[::-1]
        scaled = distance / blur
        steps = erf(scaled / np.sqrt(2.0))
        share = (1 + self.sign[:, None] * (steps[0] * steps[1] + self._oblique(scaled))) / 2
        # By the two distances; what the oblique angle adds is small and even about the corner.
        heights = np.sqrt(0.5 / np.pi) * self.sign[:, None] / blur
        by_distance = heights * np.exp(-scaled * scaled / 2) * steps[::-1]
        towards = self.normals + state.turn[:, :, None] * self.normals[:, ::-1]
        slopes = np.empty((len(self.use), 6, self.use.shape[1]))
        for axis in range(2):
            slopes[:, axis] = -(by_distance[0] * towards[:, 0, axis, None] + by_distance[1] * towards[:, 1, axis, None])
        for edge in range(2):
            slopes[:, 2 + edge] = by_distance[edge] * straight[1 - edge]
            slopes[:, 4 + edge] = -by_distance[edge] * distance[edge]
        return share, slopes

    def _oblique(self, scaled: Array) -> Array:
        """Return by how much (K, P) the mean sign is more than the product of the two edges' own."""
        found = np.zeros(scaled.shape[1:])
        k, p = np.nonzero((np.abs(scaled) < _OBLIQUE).all(axis=0) & (self.use > 0))
        u, v = scaled[:, k, p]
        angles, weights = self.angles[k], self.angle_weights[k]
        both, product = (u * u + v * v)[:, None], (2 * u * v)[:, None]
        powers = (both - product * np.sin(angles)) / (2 * np.cos(angles) ** 2)
        found[k, p] = np.sum(weights * np.exp(-powers), axis=1)
        return found

    def planes(self, share: Array) -> Array:
        """Return the terms (K, 6, P) of the black and of the white plane."""
        levers = self.base / self.arm[:, None]
        terms = np.empty((len(share), 6, share.shape[1]))
        for first, part in ((0, 1 - share), (3, share)):
            terms[:, first], terms[:, first + 1], terms[:, first + 2] = part, part * levers[0], part * levers[1]
        return terms


@dataclass(frozen=True, eq=False)
class _Fit:
    """The state that fits best, and what is left."""

    model: _Corners
    state: _State
    share: Array
    left: Array
    contrast: Array
    normal: Array
    gradient: Array
    last: Array


def _gauss_newton(model: _Corners, state: _State | None = None, noise: tuple[float, float] | None = None) -> _Fit:
    """Fit by Gauss-Newton, the planes and the rest together; all pixels alike, or weighted by their noise."""
    fit = _at(model, model.start if state is None else state, noise, np.full(len(model.use), np.inf))
    for _ in range(_STEPS[0] if noise is None else _STEPS[1]):
        if float(fit.last.max()) < _SETTLED:
            break
        step = _solve(fit.normal, fit.gradient[:, :, None])
        fit = _at(model, fit.state.after(step), noise, np.linalg.norm(step[:, :2], axis=1))
    return fit


def _at(model: _Corners, state: _State, noise: tuple[float, float] | None, last: Array) -> _Fit:
    """Return the planes that fit best in a state, what is left, and the normal equations of what is free."""
    share, slopes = model.terms(state)
    weight = model.use if noise is None else model.use / np.sqrt(_variance(noise, share))
    planes = model.planes(share)
    jacobian = np.empty((len(share), _FREE, share.shape[1]))
    weighed = np.multiply(planes, weight[:, None], out=jacobian[:, 6:])
    levels = _solve(weighed @ weighed.mT, weighed @ (model.value * weight)[:, :, None])
    left = (model.value - (levels[:, None] @ planes)[:, 0]) * model.use
    # At a corner the two planes differ by the contrast.
    contrast = levels[:, 3] - levels[:, 0]
    np.multiply(slopes, (contrast[:, None] * weight)[:, None], out=jacobian[:, :6])
    gradient = (jacobian @ (left * weight)[:, :, None])[..., 0]
    return _Fit(model, state, share, left, contrast, jacobian @ jacobian.mT, gradient, last)


def _measured(fit: _Fit, noise: tuple[float, float]) -> CornerFits:
    count = fit.model.use.sum(axis=1)
    freedom = np.maximum(count - _FREE, 1.0)
    covariance = np.linalg.inv(_regular(fit.normal))[:, :2, :2]
    sigma = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0) / 2)
    return CornerFits(
        pixel=fit.model.anchor + fit.state.shift,
        sigma=sigma,
        blur=fit.state.blur,
        contrast=fit.contrast,
        misfit=np.sqrt(np.sum(fit.left**2 / _variance(noise, fit.share), axis=1) / freedom),
        residual=np.sqrt(np.sum(fit.left**2, axis=1) / freedom),
        covered=fit.model.covered,
        converged=(fit.last < _CONVERGED) & (count >= _FEWEST) & np.isfinite(sigma),
    )


def _variance(noise: tuple[float, float], share: Array) -> Array:
    return noise[0] + (noise[1] - noise[0]) * np.clip(share, 0, 1)


def _solve(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(_regular(matrix), right)[..., 0], dtype=np.float64)


def _regular(matrix: Array) -> Array:
    """Return matrices (K, n, n) that can be inverted, where a corner shows too little to."""
    diagonal = np.einsum("kii->ki", matrix)
    tiny = 1e-9 * diagonal + 1e-15 * diagonal.max(axis=1, keepdims=True) + 1e-300
    return matrix + tiny[:, :, None] * np.eye(matrix.shape[1])


def _noise_of(fits: list[_Fit]) -> tuple[float, float]:
    """Return the variances of a black and of a white pixel: of most corners, whatever the others see."""
    black, white = (_median_variance(fits, low, high) for low, high in ((-np.inf, _EDGE), (1 - _EDGE, np.inf)))
    least = max(_QUIETEST * max(black, white), 1e-10)
    return max(black, least), max(white, least)


def _median_variance(fits: list[_Fit], low: float, high: float) -> float:
    """Return the variance that half of the corners exceed, of pixels with a share of white in that range."""
    each = []
    for fit in fits:
        of = fit.model.use * ((fit.share > low) & (fit.share < high))
        count = of.sum(axis=1)
        each.append((np.sum(fit.left**2 * of, axis=1) / np.maximum(count - 3, 1))[count > _FEWEST / 4])
    found = np.concatenate(each)
    return float(np.median(found)) if len(found) else 0.0


def _covered(distance: Array, wanted: Mask, there: Mask) -> Array:
    """Return the least share (K,) of the pixels wanted that is there, of the halves before and behind each edge."""
    sides = [side for edge in distance for side in (edge > 0, edge < 0)]
    return np.min([(there & side).sum(axis=1) / np.maximum((wanted & side).sum(axis=1), 1) for side in sides], axis=0)
