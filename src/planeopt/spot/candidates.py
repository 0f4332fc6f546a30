"""Find what in an image looks like a spot: bright, elliptic, with an edge all round."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.spot.grey import Grey
from planeopt.spot.outline import Outline, from_moments
from planeopt.spot.points import Kind, NoSpotReason, SpotNotFound

Array = NDArray[np.float64]

# Shares of the way from the image's median to its brightest part. The low ones are closer together: a faint spot beside
# a bright reflection is as good a spot.
_LEVELS = (0.03, 0.05, 0.08, 0.12, 0.17, 0.23, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_MIN_SEMI_AXIS = 3.5  # px: below, background, edge and plateau of one profile cannot be told apart
_SEARCH_PIXELS = 1_500_000  # larger images are searched at half or a quarter of their size
_COMPONENTS_PER_LEVEL = 12  # the largest; what is smaller than a dozen others at its level is not the spot
_SEEN = 4  # px: smaller parts are not looked at, not even to say that they are too small
_NOISE_FACTOR = 3.0  # an edge has to be that many standard deviations of a pixel's noise
_DARK = 0.02  # of full scale
_MIN_CONTRAST = 0.004  # of full scale: one grey value of 8 bits
_RIVAL = 0.3  # a second find with that share of the best one's edge makes the choice a guess
_MIN_SIDE = 16  # px


@dataclass(frozen=True, slots=True)
class Candidate:
    """Something that looks like a spot.

    Parameters
    ----------
    outline : Outline
        The ellipse (of a ring: the middle of its line), good to a pixel or two.
    kind : {"disc", "ring"}
        By the brightness of its inside.
    contrast : float
        Height of its edge, share of full scale.
    line_width : float
        Of a ring: the width of its line, px.
    touches_border : bool
    """

    outline: Outline
    kind: Kind
    contrast: float
    line_width: float
    touches_border: bool

    @property
    def strength(self) -> float:
        """What it is ranked by: the height of its edge times (up to a factor) its length."""
        return self.contrast * self.outline.size


def pixel_noise(values: NDArray[np.float32]) -> float:
    """Return the standard deviation of the pixels' noise, robust against the image's content.

    From the second differences along rows, whose noise is sqrt(6) times the pixels' (Immerkaer, Computer Vision and
    Image Understanding 64, 1996, in one dimension, with the median absolute value).
    """
    sample = values[:: max(1, values.shape[0] // 256)]
    second = sample[:, :-2] - 2 * sample[:, 1:-1] + sample[:, 2:]
    return float(np.median(np.abs(second))) / (0.6745 * np.sqrt(6.0)) if second.size else 0.0


def find_candidate(grey: Grey, noise: float, kind: Kind | None) -> Candidate:
    """Return the one thing in the image that looks like a spot.

    Raises
    ------
    SpotNotFound
        If there is none, or no telling which of several it is.
    """
    values = grey.values
    if min(values.shape) < _MIN_SIDE:
        raise SpotNotFound(NoSpotReason.IMAGE_TOO_SMALL, f"It has {values.shape[1]} x {values.shape[0]} pixels.")
    candidates, rejection = _search(values, noise)
    best = max(candidates, key=lambda found: found.strength, default=None)
    if best is None:
        raise _explain(grey, rejection)
    rivals = [found for found in candidates if found is not best and found.strength > _RIVAL * best.strength]
    if rivals:
        raise SpotNotFound(NoSpotReason.SEVERAL, f"{len(rivals) + 1} were found, at {_places([best, *rivals])}.")
    if best.touches_border:
        raise SpotNotFound(NoSpotReason.TOUCHES_BORDER, f"Its centre is near {_places([best])}.")
    if kind is not None and best.kind != kind:
        raise SpotNotFound(NoSpotReason.WRONG_KIND, f"A {best.kind} was found at {_places([best])}, not a {kind}.")
    return best


def _threshold(noise: float) -> float:
    return max(_NOISE_FACTOR * noise, _MIN_CONTRAST)


def _places(candidates: list[Candidate]) -> str:
    return ", ".join(f"({found.outline.x:.0f}, {found.outline.y:.0f})" for found in candidates)


def _explain(grey: Grey, rejection: NoSpotReason | None) -> SpotNotFound:
    if grey.clipped is not None and grey.clipped.mean() > 0.5:
        return SpotNotFound(NoSpotReason.TOO_BRIGHT)
    if rejection is not None:
        return SpotNotFound(rejection)
    if np.quantile(grey.values, 0.999) < _DARK:
        return SpotNotFound(NoSpotReason.TOO_DARK)
    return SpotNotFound(NoSpotReason.NO_CONTRAST)


def _search(values: NDArray[np.float32], noise: float) -> tuple[list[Candidate], NoSpotReason | None]:
    """Return what looks like a spot at some level, one of each, and why the most striking other thing does not."""
    factor = 1
    while values.size / factor**2 > _SEARCH_PIXELS:
        factor *= 2
    if factor > 1:
        height, width = values.shape
        small = cv2.resize(values, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
    else:
        small = values
    # Smoothing by one pixel lowers white noise 3.5 times and joins the line of a noisy ring.
    smooth = np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), dtype=np.float32)
    low, high = float(np.median(smooth)), float(smooth.max())
    found: list[Candidate] = []
    rejected: list[tuple[float, NoSpotReason]] = []
    threshold = _threshold(noise / factor)
    for share in _LEVELS if high - low > threshold / 2 else ():
        level = low + share * (high - low)
        if level - low < 2 * noise / factor:
            continue
        for mask, origin in _components(smooth > level):
            outcome = _examine(smooth, mask, origin, threshold)
            if isinstance(outcome, NoSpotReason):
                rejected.append(((level - low) * np.sqrt(mask.sum()), outcome))
            else:
                found.append(outcome)
    found.sort(key=lambda candidate: -candidate.strength)
    distinct: list[Candidate] = []
    for candidate in found:
        if not any(_same(candidate.outline, other.outline) for other in distinct):
            distinct.append(candidate)
    striking = max(rejected, key=lambda pair: pair[0])[1] if rejected else None
    return [_enlarged(candidate, factor) for candidate in distinct], striking


def _same(one: Outline, other: Outline) -> bool:
    """Whether two finds are one thing seen at two levels: one lies within the other."""
    return np.hypot(one.x - other.x, one.y - other.y) < max(one.a, other.a)


def _enlarged(candidate: Candidate, factor: int) -> Candidate:
    e = candidate.outline
    shift = (factor - 1) / 2  # pixel centres at integers in both
    whole = Outline(e.x * factor + shift, e.y * factor + shift, e.a * factor, e.b * factor, e.angle)
    return Candidate(whole, candidate.kind, candidate.contrast, candidate.line_width * factor, candidate.touches_border)


def _components(mask: NDArray[np.bool_]) -> list[tuple[NDArray[Any], tuple[int, int]]]:
    """Return the largest connected parts of a mask as small masks with the place (x, y) of their corner."""
    pixels = mask.astype(np.uint8)
    # Labelling costs by the area, and above the lowest levels nearly all of an image is dark.
    left, top, wide, high = cv2.boundingRect(pixels)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(pixels[top : top + high, left : left + wide], connectivity=8)
    sides = stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    large = np.flatnonzero(sides.min(axis=1) >= _SEEN) + 1
    boxes = stats[large]
    order = np.argsort(-boxes[:, cv2.CC_STAT_WIDTH] * boxes[:, cv2.CC_STAT_HEIGHT], kind="stable")
    parts = []
    for index in large[order[:_COMPONENTS_PER_LEVEL]]:
        x, y, width, height = (int(v) for v in stats[index, :4])
        parts.append(((labels[y : y + height, x : x + width] == index).astype(np.uint8), (x + left, y + top)))
    return parts


def _examine(
    smooth: NDArray[np.float32], mask: NDArray[Any], origin: tuple[int, int], threshold: float
) -> Candidate | NoSpotReason:
    padded = np.pad(mask, 1)
    contours, _ = cv2.findContours(padded, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)[:, 0, :] + np.array(origin, dtype=np.float64) - 1
    filled = np.zeros_like(padded)
    cv2.drawContours(filled, contours, -1, 1, thickness=cv2.FILLED)
    m = cv2.moments(filled, binaryImage=True)
    area = m["m00"]
    mean = np.array([m["m10"], m["m01"]]) / area + np.array(origin) - 1
    # A pixel is a square, not a point: 1/12 on the diagonal.
    spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / area + np.eye(2) / 12
    outer = from_moments(mean, spread)
    if outer.b < _MIN_SEMI_AXIS:
        return NoSpotReason.TOO_SMALL
    touches = _touches_border(smooth.shape, origin, mask.shape)
    # The outline runs through the outermost pixels' centres, half a pixel inside.
    off = outer.distances(outline) + 0.5
    if np.sqrt(np.mean(off**2)) > 0.7 + 0.03 * outer.size:
        return NoSpotReason.TOUCHES_BORDER if touches and area < smooth.size / 4 else NoSpotReason.NOT_AN_ELLIPSE
    return _judge(smooth, outer, np.sqrt(1 - float(mask.sum()) / area), touches, threshold)


def _touches_border(shape: tuple[int, ...], origin: tuple[int, int], size: tuple[int, ...]) -> bool:
    x, y = origin
    return x < 2 or y < 2 or x + size[1] > shape[1] - 2 or y + size[0] > shape[0] - 2


def _judge(
    smooth: NDArray[np.float32], outer: Outline, hollow: float, touches: bool, threshold: float
) -> Candidate | NoSpotReason:
    """Measure the height of the edge and tell a disc from a ring; `hollow` is the hole's radius over the outer one."""
    middle = outer.grown((1 + hollow) / 2) if hollow > 0.3 else outer
    count = 64
    points, normals, _ = middle.normals_at(count)
    gap = max(3.0, (1 - hollow) * outer.b if hollow > 0.3 else 0.0)
    depths = np.array([-min(gap, 0.6 * middle.b), 0.0, gap])
    places = points[:, None, :] + normals[:, None, :] * depths[:, None]
    maps = places.astype(np.float32)
    levels = cv2.remap(smooth, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside, on, outside = np.median(levels, axis=0)
    ring = hollow > 0.3 and inside - outside < 0.5 * (on - outside)
    contrast = float(on - max(inside, outside) if ring else inside - outside)
    # All of the edge counts, not its better half: a quarter of the profiles may fail.
    edges = levels[:, 1] - levels[:, [0, 2]].max(axis=1) if ring else levels[:, 0] - levels[:, 2]
    if contrast < threshold or np.quantile(edges, 0.25) < threshold / 2:
        return NoSpotReason.NO_CONTRAST
    if not ring:
        return Candidate(outer, "disc", contrast, 0.0, touches)
    return Candidate(middle, "ring", contrast, (1 - hollow) * outer.size, touches)
