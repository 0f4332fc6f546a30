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

_ROOT_2 = np.sqrt(2.0)
_ARM = 0.42  # of a square: so far along the edges, and not into the next corner's blur
_LONGEST, _FIRST = 40.0, 10.0  # px: longer arms gain little; at the start the directions are known to a few degrees
_WIDE = 4.0, 2.0  # blurs and px to each side of an edge: beyond, there is nothing but black or white
_GUARD = 2.5  # blurs from something else: a marker, the window
_START_BLUR = 1.2  # px
_BLUR_RANGE = 0.3, 12.0  # px
_STEPS = 8, 5, 3  # of Gauss-Newton: from the start, with long arms, and with the pixels' weights
_LONGEST_STEP = 1.0  # px
_CONVERGED = 0.01  # px
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_MOST_OBLIQUE = 0.97  # of the cosine between the edges
_FEWEST = 40  # pixels
_AT_ONCE = 48  # corners
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
    """

    place: Array
    pixel: Array
    first: Array
    second: Array
    white: Mask

    def __len__(self) -> int:
        return len(self.place)

    def __getitem__(self, which: slice | Mask) -> "Crossings":
        return Crossings(self.place[which], self.pixel[which], self.first[which], self.second[which], self.white[which])


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
    moved : (K,) array
        How far from where it was looked for, px.
    converged : (K,) bool array
    """

    pixel: Array
    sigma: Array
    blur: Array
    contrast: Array
    misfit: Array
    residual: Array
    covered: Array
    moved: Array
    converged: Mask

    @staticmethod
    def joined(parts: list["CornerFits"]) -> "CornerFits":
        """Return several as one."""
        return CornerFits(*(np.concatenate(values) for values in zip(*(vars(p).values() for p in parts), strict=True)))


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Pixels round K corners, P each; where there are fewer the rest has no weight."""

    offset: Array  # (K, P, 2) from the anchor, px
    value: Array  # (K, P)
    use: Array  # (K, P): 1 or 0
    covered: Array  # (K,)


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
            np.clip(self.turn + np.clip(step[:, 2:4], -0.1, 0.1), -0.5, 0.5),
            np.clip(self.blur * np.exp(np.clip(step[:, 4:6], -0.4, 0.4)), *_BLUR_RANGE),
        )


class _Corners:
    """The model of K corners in an image."""

    def __init__(self, image: NDArray[np.float32], crossings: Crossings, printed: Print) -> None:
        self.image, self.crossings, self.printed = image, crossings, printed
        self.anchor = np.rint(crossings.pixel)
        self.inverse = np.linalg.inv(crossings.first)  # mm per px
        self.steepness = np.linalg.norm(self.inverse, axis=2)  # mm per px across the lines of equal x and y
        self.normals = self.inverse / self.steepness[:, :, None]
        cosine = np.clip(np.sum(self.normals[:, 0] * self.normals[:, 1], axis=1), -_MOST_OBLIQUE, _MOST_OBLIQUE)
        half = np.arcsin(cosine) / 2
        self.angles = half[:, None] * (1 + _NODES)
        self.angle_weights = half[:, None] * _WEIGHTS * 2 / np.pi
        self.sign = np.where(crossings.white, 1.0, -1.0)
        self.arm = np.min(_ARM * np.array(printed.square) / self.steepness, axis=1)

    def start(self) -> _State:
        count = len(self.crossings)
        shift = self.crossings.pixel - self.anchor
        return _State(shift, np.zeros((count, 2)), np.full((count, 2), _START_BLUR))

    def distances(self, offset: Array, state: _State) -> Array:
        """Return the distances (K, P, 2) of pixels from the two edges as the map has them run, px."""
        from_corner = offset - state.shift[:, None]
        straight = np.einsum("kij,kpj->kpi", self.inverse, from_corner)
        bend = np.einsum("kaij,kpi,kpj->kpa", self.crossings.second, straight, straight) / 2
        place = straight - np.einsum("kij,kpj->kpi", self.inverse, bend)
        return place / self.steepness[:, None]

    def pixels(self, state: _State, longest: float) -> _Pixels:
        """Return the pixels along the arms of the corners."""
        height, width = self.image.shape
        arm = np.minimum(self.arm, longest)
        # A rhombus of that height reaches further along its sides, the more oblique the more.
        slant = np.abs(np.linalg.det(self.normals))
        reach = int(np.ceil(np.max(arm / np.maximum(slant, 0.5)) + 1))
        down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        offset = np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float64)
        offset = np.broadcast_to(offset, (len(self.crossings), *offset.shape))
        distance = self.distances(offset, state)
        blur = state.blur.max(axis=1)[:, None]
        near = np.abs(distance).min(axis=2)
        wide = _WIDE[0] * blur + _WIDE[1]
        margin = (self.printed.margin / self.steepness.max(axis=1))[:, None]
        # Where the margin is narrower than the blur the marker is seen too, but the same on both sides of the corner.
        in_white = np.minimum(np.maximum(margin - _GUARD * blur, margin / 2), wide)
        is_white = distance[..., 0] * distance[..., 1] * self.sign[:, None] > 0
        wanted = (np.abs(distance).max(axis=2) <= arm[:, None]) & (near <= np.where(is_white, in_white, wide))
        x, y = np.moveaxis(self.anchor[:, None] + offset, 2, 0).astype(np.intp)
        there = wanted & (x >= 0) & (x < width) & (y >= 0) & (y < height) & ~self._blank(distance, blur)
        order = np.argsort(~there, axis=1, kind="stable")[:, : max(int(there.sum(axis=1).max()), 1)]
        x, y, use = (np.take_along_axis(values, order, axis=1) for values in (x, y, there))
        value = self.image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
        offset = np.take_along_axis(offset, order[:, :, None], axis=1)
        return _Pixels(offset, value, use.astype(np.float64), _covered(distance, wanted, there))

    def _blank(self, distance: Array, blur: Array) -> Mask:
        """Return which pixels (K, P) see the blank window, or its blurred edge."""
        if self.printed.window is None:
            return np.zeros(distance.shape[:2], dtype=np.bool_)
        x, y, width, height = self.printed.window
        place = self.crossings.place[:, None] + distance * self.steepness[:, None]
        past = np.maximum(np.array([x, y]) - place, place - np.array([x + width, y + height]))
        return np.max(past / self.steepness[:, None], axis=2) < _GUARD * blur

    def terms(self, pixels: _Pixels, state: _State) -> tuple[Array, Array, Array]:
        """Return the share of white (K, P), its derivatives (K, P, 6) by the state, and the planes' terms (K, P, 6)."""
        straight = self.distances(pixels.offset, state)
        distance = straight + state.turn[:, None] * straight[..., ::-1]
        u, v = np.moveaxis(distance / state.blur[:, None], 2, 0)
        over, under = erf(u / _ROOT_2), erf(v / _ROOT_2)
        oblique = np.zeros_like(u)
        for k in range(len(_NODES)):
            angle = self.angles[:, k, None]
            power = (u * u + v * v - 2 * u * v * np.sin(angle)) / (2 * np.cos(angle) ** 2)
            oblique += self.angle_weights[:, k, None] * np.exp(-power)
        share = (1 + self.sign[:, None] * (over * under + oblique)) / 2
        # By the two distances; the part of the oblique angle is small and even about the corner.
        slope = np.sqrt(2 / np.pi) * self.sign[:, None, None] / 2 / state.blur[:, None]
        by_distance = slope * np.stack([np.exp(-u * u / 2) * under, np.exp(-v * v / 2) * over], axis=2)
        by_shift = -np.einsum(
            "kpi,kij->kpj", by_distance, self.normals + state.turn[:, :, None] * self.normals[:, ::-1]
        )
        slopes = np.concatenate([by_shift, by_distance * straight[..., ::-1], -by_distance * distance], axis=2)
        lever = straight / self.arm[:, None, None]
        planes = np.stack([np.ones_like(u), lever[..., 0], lever[..., 1]], axis=2)
        levels = np.concatenate([planes * (1 - share)[..., None], planes * share[..., None]], axis=2)
        return share, slopes, levels


@dataclass(frozen=True, eq=False)
class _Fit:
    """The state that fits best, and what is left."""

    state: _State
    pixels: _Pixels
    share: Array
    left: Array
    levels: Array
    normal: Array
    last: Array


def fit_corners(image: NDArray[np.float32], crossings: Crossings, printed: Print) -> CornerFits:
    """Measure corners.

    Parameters
    ----------
    image : (H, W) array
        Grey values, share of full scale.
    crossings : Crossings
        At least one.
    printed : Print
    """
    parts = [crossings[first : first + _AT_ONCE] for first in range(0, len(crossings), _AT_ONCE)]
    models = [_Corners(image, part, printed) for part in parts]
    fits = [_unweighted(model) for model in models]
    noise = _noise_of(fits)
    return CornerFits.joined([_weighted(model, fit, noise) for model, fit in zip(models, fits, strict=True)])


def _unweighted(model: _Corners) -> _Fit:
    state = model.start()
    for longest, steps in zip((_FIRST, _LONGEST), _STEPS, strict=False):
        fit = _gauss_newton(model, model.pixels(state, longest), state, steps, None)
        state = fit.state
    return fit


def _weighted(model: _Corners, fit: _Fit, noise: tuple[float, float]) -> CornerFits:
    fit = _gauss_newton(model, model.pixels(fit.state, _LONGEST), fit.state, _STEPS[-1], noise)
    freedom = np.maximum(fit.pixels.use.sum(axis=1) - 12, 1.0)
    variance = noise[0] + (noise[1] - noise[0]) * np.clip(fit.share, 0, 1)
    misfit = np.sqrt(np.sum(fit.left**2 / variance, axis=1) / freedom)
    covariance = np.linalg.inv(fit.normal)[:, :2, :2]
    sigma = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0) / 2)
    pixel = model.anchor + fit.state.shift
    return CornerFits(
        pixel=pixel,
        sigma=sigma,
        blur=fit.state.blur,
        contrast=fit.levels[:, 3] - fit.levels[:, 0],
        misfit=misfit,
        residual=np.sqrt(np.sum(fit.left**2, axis=1) / freedom),
        covered=fit.pixels.covered,
        moved=np.linalg.norm(pixel - model.crossings.pixel, axis=1),
        converged=(fit.last < _CONVERGED) & (fit.pixels.use.sum(axis=1) >= _FEWEST) & np.isfinite(sigma),
    )


def _gauss_newton(
    model: _Corners, pixels: _Pixels, state: _State, steps: int, noise: tuple[float, float] | None
) -> _Fit:
    last = np.zeros(len(model.crossings))
    for turn in range(steps + 1):
        share, slopes, terms = model.terms(pixels, state)
        weight = pixels.use
        if noise is not None:
            weight = weight / np.sqrt(noise[0] + (noise[1] - noise[0]) * np.clip(share, 0, 1))
        weighed = terms * weight[..., None]
        levels = _solve(weighed.mT @ weighed, (weighed.mT @ (pixels.value * weight)[..., None])[..., 0])
        left = (pixels.value - np.einsum("kpi,ki->kp", terms, levels)) * pixels.use
        contrast = levels[:, 3] - levels[:, 0]
        jacobian = np.concatenate([slopes * (contrast[:, None] * weight)[..., None], weighed], axis=2)
        normal = jacobian.mT @ jacobian
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1]) + 1e-300 * np.eye(
            normal.shape[1]
        )
        if turn == steps:
            break
        step = _solve(normal, (jacobian.mT @ (left * weight)[..., None])[..., 0])
        state = state.after(step)
        last = np.linalg.norm(step[:, :2], axis=1)
    return _Fit(state, pixels, share, left, levels, normal, last)


def _solve(matrix: Array, right: Array) -> Array:
    size = matrix.shape[1]
    tiny = 1e-12 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] + 1e-300
    return np.linalg.solve(matrix + tiny * np.eye(size), right[..., None])[..., 0]


def _noise_of(fits: list[_Fit]) -> tuple[float, float]:
    """Return the variances of a black and of a white pixel: of most corners, whatever the others see."""
    variances = []
    for low, high in ((-np.inf, _EDGE), (1 - _EDGE, np.inf)):
        each = []
        for fit in fits:
            of = fit.pixels.use * ((fit.share > low) & (fit.share < high))
            count = of.sum(axis=1)
            each.append((np.sum(fit.left**2 * of, axis=1) / np.maximum(count - 3, 1))[count > _FEWEST / 4])
        all_of_them = np.concatenate(each)
        variances.append(float(np.median(all_of_them)) if len(all_of_them) else np.nan)
    known = [value for value in variances if np.isfinite(value)] or [0.0]
    least = max(_QUIETEST * max(known), 1e-10)
    black, white = (max(value, least) if np.isfinite(value) else max(*known, least) for value in variances)
    return black, white


def _covered(distance: Array, wanted: Mask, there: Mask) -> Array:
    """Return the least share (K,) of the pixels wanted that is there, of the halves before and behind each edge."""
    shares = []
    for edge in range(2):
        for side in (distance[..., edge] > 0, distance[..., edge] < 0):
            shares.append((there & side).sum(axis=1) / np.maximum((wanted & side).sum(axis=1), 1))
    return np.min(shares, axis=0)
