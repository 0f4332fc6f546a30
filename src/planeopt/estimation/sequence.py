"""A sequence of images: how the plane changes along it, against the number of the image or time."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.rig import Rig
from planeopt.solution import Solution

Array = NDArray[np.float64]

LEVEL = 1e-3
"""How often a quantity that does not change is said to, of all of a sequence's together."""

FEWEST = 3
"""Images that a line needs, so that it can be told from them whether it fits."""


@dataclass(frozen=True)
class Positions:
    """Where in a sequence each input was taken.

    Parameters
    ----------
    values : tuple of float
        One for each input.
    label : str
        For an axis: what they are, with their unit.
    unit : str
        What a rate is per: "image" or "s".

    Raises
    ------
    InputError
        If a value is not finite.
    """

    values: tuple[float, ...]
    label: str = "image number"
    unit: str = "image"

    def __post_init__(self) -> None:
        values = tuple(float(value) for value in self.values)
        if not np.isfinite(values).all():
            raise InputError(f"the positions in a sequence must be finite numbers ({self.label})")
        object.__setattr__(self, "values", values)

    @classmethod
    def of_names(cls, names: Iterable[str]) -> "Positions":
        """Return the numbers with which files are named, so that gaps count; 1, 2, ... where they do not order them.

        The number is the last run of digits in the name without its ending, as in ``frame_0012.png``. It counts only if
        every name has one and they increase in the order given.
        """
        stems = [PurePath(name).stem for name in names]
        runs = [re.findall(r"[0-9]+", stem) for stem in stems]
        numbers = [float(run[-1]) if run else np.nan for run in runs]
        if all(np.isfinite(numbers)) and np.all(np.diff(numbers) > 0):
            return cls(tuple(numbers))
        return cls(tuple(float(number) for number in range(1, len(stems) + 1)))

    @classmethod
    def at_times(cls, seconds: Sequence[float]) -> "Positions":
        """Return times, in seconds since the first of them."""
        first = min(seconds, default=0.0)
        return cls(tuple(second - first for second in seconds), "time, s", "s")


@dataclass(frozen=True, eq=False)
class Trend:
    """One quantity along the sequence, and the straight line through it.

    Attributes
    ----------
    name, unit : str
        mm, 1 or rad.
    values, sigmas : (n,)
        With the standard deviations of the spots' part, which is what scatters from image to image.
    fitted : (n,)
        The line at the images, weighted by those.
    slope, slope_sigma : float
        Per unit of position, its standard deviation from the spots' part.
    slope_sigma_rig : float
        From the rig's part: the same error in all images, which moves planes apart that are apart.
    scatter_p_value : float
        How often values with these sigmas scatter more about a line.
    p_value : float
        How often a quantity that does not change has a slope as large. Where the values scatter more than their sigmas
        say (`LEVEL`), by the scatter, in Student's law.
    changes : bool
        Whether the p-value is below `LEVEL` over the number of quantities.
    message : str
    """

    name: str
    unit: str
    values: Array
    sigmas: Array
    fitted: Array
    slope: float
    slope_sigma: float
    slope_sigma_rig: float
    scatter_p_value: float
    p_value: float
    changes: bool
    message: str


@dataclass(frozen=True, eq=False)
class Sequenced:
    """The trends of a sequence.

    Attributes
    ----------
    label, unit : str
        Of the positions.
    positions : (n,)
        Of the images that are in it.
    images : tuple of int
        Which of the inputs those are, counted from 0.
    trends : tuple of Trend
        Of z_L, p, q and the turn of the normal, in this order; empty where there are too few images, or all are at one
        position.
    message : str
        What changes, in words.
    """

    label: str
    unit: str
    positions: Array
    images: tuple[int, ...]
    trends: tuple[Trend, ...]
    message: str


def trends(solutions: Iterable[Solution], rig: Rig, positions: Positions) -> Sequenced:
    """Follow the plane along a sequence of images.

    The turn of the normal is the angle between each normal and their mean, along the direction in which the normals
    turn, and signed; its p-value is of the turn in any direction, with 2 degrees of freedom.

    Parameters
    ----------
    solutions : iterable of Solution
        One for each input; those without a plane and its covariance are left out.
    rig : Rig
        They were solved with.
    positions : Positions

    Returns
    -------
    Sequenced

    Raises
    ------
    InputError
        If there is not one position for each solution.
    """
    given = list(solutions)
    if len(positions.values) != len(given):
        raise InputError(f"a sequence of {len(given)} images needs a position for each, not {len(positions.values)}")
    usable = [
        index
        for index, solution in enumerate(given)
        if solution.status.record != "refused" and solution.pose is not None and solution.uncertainty is not None
    ]
    place = np.array([positions.values[index] for index in usable], dtype=float)
    frames = _Frames.of([given[index] for index in usable], rig, place)
    if len(usable) < FEWEST or np.ptp(place) == 0:
        message = f"{len(usable)} images at {len(set(place.tolist()))} positions: no trend can be told."
        return Sequenced(positions.label, positions.unit, place, tuple(usable), (), message)
    found = (*frames.of_plane(positions.unit), frames.of_normal(positions.unit))
    changing = [trend.message for trend in found if trend.changes]
    message = " ".join(changing) if changing else f"Nothing changes along the {len(usable)} images beyond its scatter."
    return Sequenced(positions.label, positions.unit, place, tuple(usable), found, message)


_QUANTITIES = (("z_L", "mm"), ("p", "1"), ("q", "1"))
_NORMAL = ("turn of the normal", "rad")
_N_QUANTITIES = len(_QUANTITIES) + 1


@dataclass(frozen=True, eq=False)
class _Frames:
    """Planes (n, 3) and normals (n, 3), with the spots' covariances and the derivatives by the rig."""

    place: Array
    plane: Array
    spot: Array
    by_rig: Array
    normal: Array
    normal_spot: Array
    normal_by_rig: Array
    sigma: Array

    @classmethod
    def of(cls, solutions: Sequence[Solution], rig: Rig, place: Array) -> "_Frames":
        planes, normals, parts = [], [], []
        for solution in solutions:
            if solution.pose is not None and solution.plane is not None and solution.uncertainty is not None:
                planes.append((solution.pose.z_L, *solution.pose.slopes))
                normals.append(solution.plane.normal)
                parts.append(solution.uncertainty)
        none = np.zeros((3, 0))
        return cls(
            place,
            np.array(planes).reshape(-1, 3),
            np.array([part.spot for part in parts]).reshape(-1, 3, 3),
            np.array([none if part.plane_by_rig is None else part.plane_by_rig for part in parts]),
            np.array(normals).reshape(-1, 3),
            np.array([part.normal_spot for part in parts]).reshape(-1, 3, 3),
            np.array([none if part.normal_by_rig is None else part.normal_by_rig for part in parts]),
            rig.covariance_matrix,
        )

    def of_plane(self, per: str) -> tuple[Trend, ...]:
        return tuple(
            self._trend(name, unit, per, self.plane[:, i], self.spot[:, i, i], self.by_rig[:, i])
            for i, (name, unit) in enumerate(_QUANTITIES)
        )

    def of_normal(self, per: str) -> Trend:
        mean = self.normal.sum(axis=0)
        mean /= np.linalg.norm(mean)
        # Two directions at right angles to the mean normal span how it can turn.
        across = np.linalg.svd(mean[None, :])[2][1:]
        lines = [
            _line(self.place, self.normal @ axis, np.einsum("i,nij,j->n", axis, self.normal_spot, axis))
            for axis in across
        ]
        rate = np.array([line.slope for line in lines])
        length = float(np.linalg.norm(rate))
        along = (rate / length if length else np.array([1.0, 0.0])) @ across
        variance = np.einsum("i,nij,j->n", along, self.normal_spot, along)
        by_rig = np.einsum("i,nij->nj", along, self.normal_by_rig)
        values = np.arcsin(np.clip(self.normal @ along, -1, 1))
        covariance = self._rate_covariance(across, lines)
        stretch = max(1.0, *(line.stretch for line in lines))
        distance = float(rate @ np.linalg.solve(covariance, rate)) / stretch
        n = len(self.place)
        p_value = float(
            scipy.stats.chi2.sf(distance, 2) if stretch == 1 else scipy.stats.f.sf(distance / 2, 2, 2 * (n - 2))
        )
        return self._trend(*_NORMAL, per, values, variance, by_rig, p_value)

    def _rate_covariance(self, across: Array, lines: Sequence["_Line"]) -> Array:
        """Covariance (2, 2) of the rates along two directions, from the spots' parts."""
        weights = np.stack([line.weights for line in lines])
        between = np.einsum("ai,nij,bj->nab", across, self.normal_spot, across)
        return np.einsum("an,nab,bn->ab", weights, between, weights)

    def _trend(
        self,
        name: str,
        unit: str,
        per: str,
        values: Array,
        variance: Array,
        by_rig: Array,
        p_value: float | None = None,
    ) -> Trend:
        line = _line(self.place, values, variance)
        moved = line.weights @ by_rig
        p_value = line.p_value if p_value is None else p_value
        trend = Trend(
            name,
            unit,
            values,
            np.sqrt(variance),
            line.fitted,
            line.slope,
            line.sigma,
            float(np.sqrt(moved @ self.sigma @ moved)),
            line.scatter_p_value,
            p_value,
            p_value < LEVEL / _N_QUANTITIES,
            "",
        )
        return replace(trend, message=_message(trend, per))


@dataclass(frozen=True, eq=False)
class _Line:
    """Weighted straight line: the slope is ``weights @ values``."""

    fitted: Array
    slope: float
    sigma: float
    weights: Array
    scatter_p_value: float
    stretch: float
    p_value: float


def _line(place: Array, values: Array, variance: Array) -> _Line:
    """Fit by least squares weighted with the inverse variances."""
    weight = 1 / variance
    centre = float(weight @ place / weight.sum())
    arm = weight * (place - centre)
    weights = arm / float(arm @ (place - centre))
    slope, sigma = float(weights @ values), float(np.sqrt(weights**2 @ variance))
    fitted = float(weight @ values / weight.sum()) + slope * (place - centre)
    dof = len(place) - 2
    chi2 = float(np.sum((values - fitted) ** 2 / variance))
    scatter = float(scipy.stats.chi2.sf(chi2, dof))
    if scatter >= LEVEL:
        return _Line(fitted, slope, sigma, weights, scatter, 1.0, float(2 * scipy.stats.norm.sf(abs(slope) / sigma)))
    stretch = chi2 / dof
    p_value = float(2 * scipy.stats.t.sf(abs(slope) / (sigma * np.sqrt(stretch)), dof))
    return _Line(fitted, slope, sigma, weights, scatter, stretch, p_value)


def _message(trend: Trend, per: str) -> str:
    """The slope in words; angles in degrees."""
    factor, unit = (180 / np.pi, "deg") if trend.unit == "rad" else (1.0, trend.unit)
    shown = "" if unit == "1" else f"{unit} "
    rate = f"{factor * trend.slope:+.3g} +- {factor * trend.slope_sigma:.2g} {shown}per {per}"
    scatter = trend.scatter_p_value < LEVEL
    about = " The values scatter about the line by more than their sigma says." if scatter else ""
    verb = "changes" if trend.changes else "does not change beyond its scatter"
    subject = trend.name[0].upper() + trend.name[1:] if trend.unit == "rad" else trend.name
    return f"{subject} {verb}: {rate} (p = {trend.p_value:.2g}).{about}"
