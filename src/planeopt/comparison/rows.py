"""What one formulation with one solver gave on one problem."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt.accuracy import Deviation, deviation
from planeopt.formulations import Problem
from planeopt.plane import Plane, SpotPose
from planeopt.record import degrees, finite
from planeopt.solution import End, Residual, Solution

Array = NDArray[np.float64]

NEAR = 0.1
"""Two planes count as the same root where the angle between their normals (rad) plus their relative difference in depth
is below this: far above noise and the bias of any formulation, far below the usual distance between the two roots."""

EFFORT = (
    "iterations",
    "evaluations",
    "first_derivatives",
    "second_derivatives",
    "build_ms",
    "solve_ms",
    "total_ms",
)
"""What a search took, by the keys of a row; without values where none was begun."""


class Root(Enum):
    """Which of the two exact solutions of the ten equations a search ended near; the value says it."""

    VISIBLE = "the visible plane"
    OTHER = "the second plane, which cannot be seen"
    ELSEWHERE = "neither of the two planes"


@dataclass(frozen=True)
class InBound:
    """A difference of ``(z_L, p, q)`` in standard deviations of the Cramér-Rao bound.

    Attributes
    ----------
    z_L, p, q : float
        Each over the bound's own standard deviation.
    mahalanobis : float
        All three together: ``sqrt(d' C^-1 d)`` with the bound ``C``; its square has the mean 3 at the bound.
    """

    z_L: float
    p: float
    q: float
    mahalanobis: float

    @classmethod
    def of(cls, difference: Array, bound: Array) -> "InBound":
        """Return a difference (3,) of ``(z_L, p, q)`` under a bound (3, 3)."""
        sigma = np.sqrt(np.diag(bound))
        z_L, p, q = (difference / sigma).tolist()
        normed = bound / np.outer(sigma, sigma)
        return cls(z_L, p, q, float(np.sqrt(np.array([z_L, p, q]) @ np.linalg.solve(normed, [z_L, p, q]))))


@dataclass(frozen=True, eq=False)
class Row:
    """What one formulation with one solver gave.

    Attributes
    ----------
    method : str
        Name of the pair, as tables have it.
    solution : Solution
        Also where it failed: its status and message are the reason.
    root : Root or None
        Near which plane the search ended, also where its answer was refused. None where there is no plane, or nothing
        to compare it with.
    residuals : tuple of Residual
        The ten equations where the search ended, with its own R, which only a hard laser block keeps on the beam.
    from_closed_form : Deviation or None
        This plane minus the closed form's visible one.
    from_closed_form_in_bound : InBound or None
        The same in standard deviations of the bound.
    error : Deviation or None
        This plane minus the truth, where that is known.
    error_in_bound : InBound or None
        The same in standard deviations of the bound.
    build_s : float
        Seconds to make the programme's functions and its solver from its symbols, with nothing kept from elsewhere.
        Once made they serve any number of problems.
    seconds : float
        Wall time of everything but building and the ellipse fit: ranks before, search, covariance, evidence.
    """

    method: str
    solution: Solution
    root: Root | None
    residuals: tuple[Residual, ...]
    from_closed_form: Deviation | None
    from_closed_form_in_bound: InBound | None
    error: Deviation | None
    error_in_bound: InBound | None
    build_s: float
    seconds: float

    @property
    def formulation(self) -> str:
        return self.solution.formulation

    @property
    def solver(self) -> str:
        return self.solution.solver

    @property
    def ok(self) -> bool:
        return self.solution.ok

    @property
    def solve_s(self) -> float:
        """Seconds for the search, its polish and the check of the optimality conditions; of a direct answer, for it."""
        return self.solution.effort.solve_s

    @property
    def took(self) -> dict[str, float] | None:
        """What the search took, by the names in `EFFORT`; None where none was begun."""
        if self.solution.end is None:
            return None
        effort = self.solution.effort
        counts = (effort.iterations, effort.evaluations, effort.first_derivatives, effort.second_derivatives)
        times = (1e3 * self.build_s, 1e3 * self.solve_s, 1e3 * self.seconds)
        return dict(zip(EFFORT, (*counts, *times), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain JSON values: mm, degrees, milliseconds; None where there is no value."""
        solution = self.solution
        pose = None if solution.status.record == "refused" else solution.pose
        sigma = None if pose is None else solution.sigma
        return {
            "method": self.method,
            "formulation": self.formulation,
            "solver": self.solver,
            "status": solution.status.record,
            "outcome": solution.status.name.lower(),
            "message": solution.message,
            "z_L_mm": None if pose is None else pose.z_L,
            "alpha_deg": None if pose is None else math.degrees(pose.alpha),
            "beta_deg": None if pose is None else degrees(pose.beta),
            "R_mm": None if pose is None else pose.R,
            "sigma_z_L_mm": None if sigma is None else finite(sigma.z_L),
            "sigma_normal_deg": None if sigma is None else degrees(sigma.normal),
            "root": None if self.root is None else self.root.name.lower(),
            **_deviation("z_L_minus_closed_form_mm", "normal_to_closed_form_deg", self.from_closed_form),
            "closed_form_over_bound": over_bound(self.from_closed_form_in_bound),
            **_deviation("z_L_error_mm", "normal_error_deg", self.error),
            "error_over_bound": over_bound(self.error_in_bound),
            **_in_bound("error_in_bound_sigmas", self.error_in_bound),
            "chi2": finite(solution.chi2),
            "p_value": finite(solution.p_value),
            **(self.took or dict.fromkeys(EFFORT)),
            "residuals": {f"{r.equation} {r.unit}": finite(r.value) for r in self.residuals},
        }


def over_bound(difference: InBound | None) -> float | None:
    """Return a difference over the bound, pooled over its three components: 1 in the mean of squares at the bound."""
    return None if difference is None else finite(difference.mahalanobis / math.sqrt(3))


def _deviation(depth: str, normal: str, away: Deviation | None) -> dict[str, float | None]:
    return {
        depth: None if away is None else finite(away.depth),
        normal: None if away is None else degrees(away.normal),
    }


def _in_bound(name: str, difference: InBound | None) -> dict[str, Any]:
    components = ("z_L", "p", "q")
    return {name: None if difference is None else {part: finite(getattr(difference, part)) for part in components}}


def residuals_at(problem: Problem, end: End) -> tuple[Residual, ...]:
    """Return the ten equations, left minus right, where a search ended."""
    v = eq.PaperVariables(end.R, end.z_L, math.atan(math.hypot(end.p, end.q)), math.atan2(-end.p, end.q))
    with np.errstate(all="ignore"):  # a search that ran off may end where they have no value
        values = [float(value) for value in eq.ten_residuals(np, v, problem.setup, problem.B.tolist())]
    return tuple(
        Residual(f"({e.number})", e.name, str(e.block), e.unit, value) for e, value in zip(eq.TEN, values, strict=True)
    )


def nearest_root(pose: SpotPose, plane: Plane, direct: Solution) -> Root:
    """Return which of the two planes of a closed-form solution a plane is `NEAR`."""
    candidates: list[tuple[SpotPose, Plane, Root]] = []
    if direct.pose is not None and direct.plane is not None:
        candidates.append((direct.pose, direct.plane, Root.VISIBLE))
    if direct.other_plane is not None:
        candidates.append((direct.other_plane.pose, direct.other_plane.plane, Root.OTHER))
    return nearest(pose, plane, candidates)


def nearest(pose: SpotPose, plane: Plane, candidates: Sequence[tuple[SpotPose, Plane, Root]]) -> Root:
    """Return which of some planes a plane is nearest to, if it is `NEAR` it."""
    away = [(_distance(pose, plane, other_pose, other), root) for other_pose, other, root in candidates]
    distance, root = min(away, key=lambda candidate: candidate[0], default=(math.inf, Root.ELSEWHERE))
    return root if distance < NEAR else Root.ELSEWHERE


def _distance(pose: SpotPose, plane: Plane, other_pose: SpotPose, other_plane: Plane) -> float:
    away = deviation(pose, plane, other_pose, other_plane)
    return away.normal + abs(away.depth / other_pose.z_L)
