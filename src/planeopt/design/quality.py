"""How well a boundary will be seen: by the pixels' noise, or by what is known of its points."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.spot.bound import boundary_sigma, size_cost

Array = NDArray[np.float64]

PIXEL_VARIANCE = 1 / 12
"""Of a pixel's own area, px^2; and of rounding to whole grey levels."""

LEAST_WIDTHS = 1.5
"""Widths of the blurred edge in the shorter semi-axis: `find_spot` refuses what is smaller."""

MARGIN_WIDTHS = 3.0
"""Widths of the blurred edge between the boundary and the image's border."""

_COSTS = np.geomspace(LEAST_WIDTHS, 60.0, 24)
# Radii in widths of the edge at which `size_cost` is computed; its excess over 1 goes with their inverse beyond.


@dataclass(frozen=True, eq=False)
class EdgeNoise:
    """How well M boundaries are known across themselves.

    Attributes
    ----------
    per_pixel : (M, N)
        Standard deviation of one pixel of boundary, px.
    size_cost : (M,)
        By what factor the mean position is known worse, because height and blur of the edge are measured as well.
    point_sigma : (M,)
        Typical standard deviation of a point, px; from pixels there is one for each pixel of boundary.
    """

    per_pixel: Array
    size_cost: Array
    point_sigma: Array


@dataclass(frozen=True)
class Pixels:
    """A boundary seen by pixels with noise (`planeopt.spot.bound`).

    Parameters
    ----------
    contrast : float
        Height of the edge or ridge over the background in the image, grey levels.
    noise : float
        Standard deviation of a pixel, grey levels; rounding to whole levels comes on top of it.
    blur_px : float
        Standard deviation of the optics' blur; the pixel's own area comes on top of it.
    kind : {"disc", "ring"}
    line_mm : float, optional
        Standard deviation of a ring's line in the beam's cross-section; a ring needs it.
    arc : float
        Fraction of the way round the beam that is seen.
    arc_deg : float
        Direction of the arc's middle, from that of the beam's offset.

    Raises
    ------
    InputError
        If a number is outside its range.
    """

    contrast: float
    noise: float
    blur_px: float = 1.0
    kind: Literal["disc", "ring"] = "disc"
    line_mm: float | None = None
    arc: float = 1.0
    arc_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("contrast", "blur_px"):
            _positive(name, getattr(self, name))
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise must be a number of grey levels, at least 0, not {self.noise}")
        if self.kind not in ("disc", "ring"):
            raise InputError(f"kind must be disc or ring, not {self.kind!r}")
        if (self.line_mm is not None) != (self.kind == "ring"):
            raise InputError("line_mm, the width of a ring's line, goes with kind ring, and with no other")
        if self.line_mm is not None:
            _positive("line_mm", self.line_mm)
        _check_arc(self.arc, self.arc_deg)

    @property
    def least_axis_px(self) -> float:
        """Shortest semi-axis that can be measured."""
        return LEAST_WIDTHS * self._blur

    @property
    def margin_px(self) -> float:
        """Least distance of the boundary from the image's border."""
        return MARGIN_WIDTHS * self._blur

    @property
    def _blur(self) -> float:
        return float(np.hypot(self.blur_px, np.sqrt(PIXEL_VARIANCE)))

    def at(self, stretch: Array, length: Array) -> "EdgeNoise":
        """Return how well boundaries are known.

        Parameters
        ----------
        stretch : (M, N)
            px along the normal per mm of the beam's radius, at N places.
        length : (M,)
            Of the boundary that is seen, px.
        """
        noise = np.hypot(self.noise, np.sqrt(PIXEL_VARIANCE))
        if self.line_mm is None:
            sigma = np.full(stretch.shape, float(boundary_sigma("disc", self.contrast, noise, self._blur)))
            widths = length / (2 * np.pi * self.arc * self._blur)
            excess = np.exp(np.interp(np.log(widths), np.log(_COSTS), _log_costs())) / widths
            return EdgeNoise(sigma, 1 + excess, sigma[:, 0])
        line = self.line_mm * np.abs(stretch)
        width = np.hypot(line, self._blur)
        # Blur spreads a thin line's light over its new width.
        share = (line / width) / np.max(line / width, axis=-1, keepdims=True)
        sigma = boundary_sigma("ring", self.contrast * share, noise, width)
        return EdgeNoise(sigma, np.ones(length.shape), np.median(sigma, axis=-1))

    def scaled(self, what: str, factor: float) -> "Pixels":
        """Return this with one of its numbers multiplied."""
        return replace(self, **{what: factor * getattr(self, what)})


@dataclass(frozen=True)
class Points:
    """A boundary of so many independent points of so much noise, evenly along it, however they were found.

    Parameters
    ----------
    sigma_px : float
        Standard deviation of a point across the boundary.
    count : int
        Of the points on the arc.
    arc, arc_deg : float
        As in `Pixels`.

    Raises
    ------
    InputError
        If a number is outside its range.
    """

    sigma_px: float
    count: int = 200
    arc: float = 1.0
    arc_deg: float = 0.0

    least_axis_px = 0.0
    margin_px = 0.0

    def __post_init__(self) -> None:
        _positive("sigma_px", self.sigma_px)
        if not 5 <= self.count <= 10**9:
            limit = "needs at least 5" if self.count < 5 else "is given at most 1,000,000,000"
            raise InputError(f"an ellipse {limit} points, not {self.count}")
        _check_arc(self.arc, self.arc_deg)

    def at(self, stretch: Array, length: Array) -> "EdgeNoise":
        """As `Pixels.at`: what makes so many points on the length."""
        sigma = self.sigma_px * np.sqrt(length / self.count)
        one = np.ones(length.shape)
        return EdgeNoise(np.broadcast_to(sigma[:, None], stretch.shape), one, self.sigma_px * one)

    def scaled(self, what: str, factor: float) -> "Points":
        """Return this with one of its numbers multiplied."""
        return replace(self, **{what: factor * getattr(self, what)})


Quality = Pixels | Points


def _positive(name: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise InputError(f"{name} must be a positive number, not {value}")


def _check_arc(arc: float, arc_deg: float) -> None:
    if not 0 < arc <= 1:
        raise InputError(f"arc must be a fraction above 0 and at most 1, not {arc}")
    if not np.isfinite(arc_deg):
        raise InputError(f"arc_deg must be a finite angle, not {arc_deg}")


@cache
def _log_costs() -> Array:
    """Logarithm of the cost's excess over 1, times the radius in widths."""
    return np.log([(size_cost(float(widths), 1.0) - 1) * widths for widths in _COSTS])
