"""What a spot is once it is measured: boundary points, their noise, and what should be known about them."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError

Kind = Literal["disc", "ring"]
"""A disc's boundary is where the irradiance is half its plateau; a ring's is its ridge."""

MIN_POINTS = 5
"""An ellipse has five parameters."""

SIGMAS = (1e-30, 1e30)
"""px: beyond, products of variances are no numbers."""


class SpotFlag(Enum):
    """Something that a reader of the result should know; the value says it."""

    RING_ASSUMED = "Neither the rig nor the caller said so: that the spot is a ring was told from the image."
    SATURATED = (
        "The spot is over-exposed: its plateau is clipped, and its boundary is told from the rest of the edge, which "
        "says less; lower the exposure."
    )
    LOW_CONTRAST = "The spot is faint: its edge is less than 10 times the noise of a pixel."
    PARTIAL_ARC = "Less than 90 % of the boundary could be measured."
    MANY_OUTLIERS = "More than 5 % of the boundary did not fit and was left out."
    STRONG_CURVATURE = (
        "The spot is small or narrow against its blur (curvature times blur over 0.3): "
        "its size, its blur and its brightness are hard to tell apart."
    )
    OWN_WIDTH = (
        "The beam's own softness and the camera's blur cannot be told apart; "
        "taking one for the other would move the boundary by more than 0.05 px."
    )
    NOT_AN_ELLIPSE = (
        "The boundary departs from an ellipse by more than 3 times what the image's noise explains; sigma includes it."
    )
    LEVEL_DEPENDENT = (
        "The ellipse of the edge's upper half is not that of its lower half: the beam is not clean, and the boundary "
        "is another at another level."
    )
    RESPONSE = (
        "The edge is lopsided, as grey values make it that are not proportional to light: a gamma left in the image, "
        "or a beam whose edge is not even; give gamma or linear images."
    )
    ENCODED = (
        "The image file is JPEG, or says that its values are coded for display (gamma, sRGB, colour profile): "
        "if they are not proportional to light, the boundary lies too far out, by 0.8 of its blur at a gamma of 2.2; "
        "give gamma or linear images."
    )
    SIGMA_UNKNOWN = "The file gave no sigma_px: the points' noise has to be estimated from their residuals."


class NoSpotReason(Enum):
    """Why there is no spot to measure; the value says it."""

    IMAGE_TOO_SMALL = "The image is too small to hold a measurable spot."
    TOO_DARK = "The image is dark: nothing in it rises above 2 % of full scale."
    TOO_BRIGHT = "The image is over-exposed nearly everywhere."
    NO_CONTRAST = "Nothing in the image stands out from its surroundings and its noise."
    TOO_SMALL = "What stands out is too small to be measured as a spot."
    TOUCHES_BORDER = "The spot touches the border of the image."
    NOT_AN_ELLIPSE = "What stands out from its surroundings is not an ellipse."
    OFF_BEAM = "What looks like a spot is not where this rig's beam can put one; or the rig has moved."
    SEVERAL = "Several things in the image look like a spot."
    WRONG_KIND = "The spot is not of the kind asked for."
    NO_BOUNDARY = "Something like a spot is there, but too little of its boundary can be measured."


class SpotNotFound(Exception):  # noqa: N818 - an answer with a reason, not an error
    """There is no spot that could be measured, and why.

    Attributes
    ----------
    reason : NoSpotReason
        The kind of failure, to act on.
    """

    def __init__(self, reason: NoSpotReason, detail: str = "") -> None:
        super().__init__(f"{reason.value} {detail}".rstrip())
        self.reason = reason

    def __reduce__(self) -> tuple[type["SpotNotFound"], tuple[NoSpotReason], dict[str, object]]:
        # The default would call the constructor with the message alone; workers in other processes must get it whole.
        return type(self), (self.reason,), {"args": self.args}


def _measure(value: float | None, name: str, upper: float) -> float | None:
    if value is None:
        return None
    value = float(value)
    if not 0.0 <= value <= upper:
        raise InputError(f"spot: {name} must be between 0 and {upper:g}, not {value!r}")
    return value


@dataclass(frozen=True, eq=False)
class Spot:
    """The measured boundary of a spot.

    Parameters
    ----------
    points : (N, 2) array
        Boundary points ``(x, y)`` in raw (distorted) pixels; pixel centres are at integers. At least five.
    sigma : (N,) array, optional
        Standard deviation across the boundary, px, inflated so that the points count as independent. ``None``: not
        known, to be estimated from the residuals.
    kind : {"disc", "ring"}, optional
        What the boundary is: half the plateau, or the ridge.
    arc_fraction : float, optional
        Share of the ellipse, in eccentric angle, that the points cover (`planeopt.conic.arc_fraction`).
    contrast : float, optional
        Height of the edge (of the ridge) over the background as a share of full scale.
    blur : float, optional
        Standard deviation of the edge's (of the ridge's) profile across the boundary, px.
    saturation : float, optional
        Share of the spot's pixels at full scale; ``None`` where full scale is not known.
    noise : float, optional
        Standard deviation of a pixel at the spot's background, share of full scale.
    rejected : (M, 2) array
        Boundary points that were measured and left out (occluded, streaks, outliers), raw pixels; for the eye only.
    flags : tuple of SpotFlag
        What a reader should know.
    source : str, optional
        Name of the file the spot comes from.

    Raises
    ------
    InputError
        If a shape does not fit, a number is not finite, or a sigma is not positive or not within `SIGMAS`.
    """

    points: NDArray[np.float64]
    sigma: NDArray[np.float64] | None = None
    kind: Kind | None = None
    arc_fraction: float | None = None
    contrast: float | None = None
    blur: float | None = None
    saturation: float | None = None
    noise: float | None = None
    rejected: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    flags: tuple[SpotFlag, ...] = field(default=())
    source: str | None = None

    def __post_init__(self) -> None:
        points = _frozen(self.points, "points")
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"spot: points must have shape (N, 2), not {points.shape}")
        if len(points) < MIN_POINTS:
            raise InputError(f"spot: an ellipse needs at least {MIN_POINTS} points, not {len(points)}")
        object.__setattr__(self, "points", points)
        rejected = _frozen(self.rejected, "rejected")
        if rejected.ndim != 2 or rejected.shape[1] != 2:
            raise InputError(f"spot: rejected must have shape (M, 2), not {rejected.shape}")
        object.__setattr__(self, "rejected", rejected)
        if self.sigma is not None:
            sigma = _frozen(self.sigma, "sigma")
            if sigma.shape != (len(points),):
                raise InputError(
                    f"spot: sigma must have one value for each of the {len(points)} points, not {sigma.shape}"
                )
            if not np.all(sigma > 0):
                raise InputError(f"spot: sigma must be positive, but is {sigma.min():g} at point {int(sigma.argmin())}")
            beyond = np.flatnonzero((sigma < SIGMAS[0]) | (sigma > SIGMAS[1]))
            if len(beyond):
                limits = f"from {SIGMAS[0]:g} to {SIGMAS[1]:g} px"
                raise InputError(f"spot: sigma must be {limits}, but is {sigma[beyond[0]]:g} at point {beyond[0]}")
            object.__setattr__(self, "sigma", sigma)
        if self.kind not in (None, "disc", "ring"):
            raise InputError(f'spot: kind must be "disc" or "ring", not {self.kind!r}')
        for name, upper in (
            ("arc_fraction", 1.0),
            ("contrast", np.inf),
            ("blur", np.inf),
            ("saturation", 1.0),
            ("noise", np.inf),
        ):
            object.__setattr__(self, name, _measure(getattr(self, name), name, upper))
        object.__setattr__(self, "flags", tuple(dict.fromkeys(self.flags)))

    def __len__(self) -> int:
        """Return the number of boundary points."""
        return len(self.points)

    @property
    def ok(self) -> bool:
        """Whether there is nothing to warn about."""
        return not self.flags


def _frozen(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"spot: {name} must be numbers: {error}") from None
    if not np.all(np.isfinite(array)):
        raise InputError(f"spot: {name} must be finite (no NaN, no infinity)")
    array.setflags(write=False)
    return array
