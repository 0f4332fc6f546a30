"""How searches run from the paper's start, and on which of the two planes they end."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planeopt import equations as eq
from planeopt import paper
from planeopt.closed_form import other_plane
from planeopt.estimation import starts
from planeopt.formulations import Problem
from planeopt.plane import SpotPose
from planeopt.reproduction.unguarded import Unguarded
from planeopt.solution import Effort, Solution, Trace
from planeopt.solvers import Ipopt

Array = NDArray[np.float64]
Which = Literal["the plane", "the second plane", "neither plane"]

_NEAR = 1e-3
"""A search ended on a plane if its unknowns agree to this (mm, rad): rounding does less, the planes differ by more."""


@dataclass(frozen=True)
class Search:
    """A search from the paper's start.

    Attributes
    ----------
    name : str
    poses : (n, 4)
        ``(R, z_L, alpha, beta)`` at the start and after each iteration, mm and rad, angles canonical.
    stage : (n,) of int
        Weights change between stages.
    misfit : (n,)
        `relative_misfit` there.
    effort : Effort
    end : {"the plane", "the second plane", "neither plane"}
    """

    name: str
    poses: Array
    stage: NDArray[np.integer]
    misfit: Array
    effort: Effort
    end: Which


def searches(problem: Problem, constrained: Solution, penalty: Solution) -> tuple[Search, ...]:
    """IPOPT (`Constrained`), SWIFT (`Penalty`), and IPOPT without inequalities, its objective whole and halved.

    Parameters
    ----------
    problem : Problem
    constrained, penalty : Solution
        Found from the paper's start, with their iterates kept.
    """
    return (
        _search("IPOPT, Constrained", _poses_in_slopes(_iterates(constrained.trace)), constrained, problem),
        _search("SWIFT, Penalty", _canonical(_iterates(penalty.trace)), penalty, problem),
        _unguarded(problem, 1.0),
        _unguarded(problem, 0.5),
    )


def relative_misfit(v: eq.PaperVariables, B: Array) -> Array:
    """Largest residual of the ten, each over the size of its own data; of the unknowns' shape.

    (11) and (12) are numbers of order 1 already; (13)-(15) and (17)-(21) have their right-hand sides as data.
    """
    k = paper.SETUP
    sizes = [1.0, 1.0, 2 * k.e_x, 2 * k.e_y, k.e_x**2 + k.e_y**2 - k.r**2, *np.abs(B)]
    rows = [np.abs(row) / size for row, size in zip(eq.ten_residuals(np, v, k, B.tolist()), sizes, strict=True)]
    return np.max(np.broadcast_arrays(*rows), axis=0)


def stated_plane() -> Array:
    """``(z_L, p, q)`` (3,) of the worked example's stated solution."""
    return np.array([paper.TRUTH.z_L, *eq.slopes(np, paper.TRUTH)])


def second_pose() -> SpotPose:
    """The second plane of the worked example, without rounding."""
    z_L, p, q = other_plane(stated_plane(), paper.SETUP).tolist()
    return SpotPose.from_slopes(z_L, p, q, paper.SETUP.r)


def _iterates(trace: Trace | None) -> Array:
    if trace is None or trace.x is None:
        raise ValueError("the search kept no iterates: ask its solver to record them")
    return trace.x[:, :4]


def _search(name: str, poses: Array, solution: Solution, problem: Problem) -> Search:
    stage = np.empty(0, dtype=int) if solution.trace is None else solution.trace.stage
    return _described(name, poses, stage, solution.effort, problem)


def _unguarded(problem: Problem, factor: float) -> Search:
    formulation = Unguarded(factor)
    start = starts.given(tuple(paper.START), problem)
    found = Ipopt(record=True).solve(formulation.build(problem, start))
    poses = _poses_in_slopes(_iterates(found.trace))
    return _described(f"IPOPT {formulation.name}", poses, found.trace.stage, found.effort, problem)


def _described(name: str, poses: Array, stage: NDArray[np.integer], effort: Effort, problem: Problem) -> Search:
    if not np.allclose(poses[0], paper.START):
        # A simplex search reports its best vertex from the end of the first iteration on.
        poses, stage = np.vstack([paper.START, poses]), np.concatenate([stage[:1], stage])
    misfit = relative_misfit(eq.PaperVariables(*poses.T), problem.B)
    return Search(name, poses, stage, misfit, effort, _end(poses[-1]))


def _poses_in_slopes(iterates: Array) -> Array:
    """``(R, z_L, p, q)`` to ``(R, z_L, alpha, beta)``, a row each; R is an unknown of its own on the way."""
    R, z_L, p, q = iterates.T
    return np.stack([R, z_L, np.arctan(np.hypot(p, q)), np.arctan2(-p, q)], axis=1)


def _canonical(iterates: Array) -> Array:
    """Angles folded as `SpotPose.canonical` folds them, all rows at once."""
    R, z_L, alpha, beta = iterates.T
    tilt = np.remainder(alpha + np.pi / 2, np.pi) - np.pi / 2
    turned = np.where(tilt < 0, beta + np.pi, beta)
    return np.stack([R, z_L, np.abs(tilt), np.pi - np.remainder(np.pi - turned, 2 * np.pi)], axis=1)


def _end(pose: Array) -> Which:
    second = second_pose()
    if np.allclose(pose, paper.TRUTH, rtol=0, atol=_NEAR):
        return "the plane"
    if np.allclose(pose, [second.R, second.z_L, second.alpha, second.beta or 0.0], rtol=0, atol=_NEAR):
        return "the second plane"
    return "neither plane"
