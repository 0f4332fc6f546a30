"""Planes from the same points by everybody: our own routes, OpenCV's fits, SciPy's search, and other programs.

A program that fits ellipses gets the closed form of this one on top, since none knows the beam. A program that finds
circles in space is asked where the spot is one, on a plane across the beam, and of its two answers the better counts.
"""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from conftest import Report
from peers.environments import environment
from planeopt import equations as eq
from planeopt.closed_form import solve_both
from planeopt.conic import ConicFit, conic_from_geometric, direct, least_squares, maximum_likelihood, taubin
from planeopt.estimation import solve_points, solve_problem
from planeopt.estimation.efficiency import bounds
from planeopt.estimation.feet import Boundary
from planeopt.formulations import Constrained, Problem, Reprojection
from planeopt.solvers import Ipopt, Sqp
from test_many_spots import minimise
from worked_example import SETUP, SIGMA, SPOT, Array

SPOTS, POINTS = 200, 200
PITCH = 0.005
WORKER = Path(__file__).parent / "peers" / "worker.py"


@dataclass(frozen=True)
class Case:
    """A plane, and how much of its spot's boundary was seen."""

    spot: eq.PaperVariables
    arc: float


CASES = {
    "the paper's example": Case(SPOT, 1.0),
    "40 % of its boundary": Case(SPOT, 0.4),
    "across the beam at 150 mm": Case(eq.PaperVariables(SETUP.r, 150.0, 0.0, 0.0), 1.0),
}
ACROSS = "across the beam at 150 mm"


@cache
def boundary(case: str) -> Array:
    """The exact boundary (N, 2), mm."""
    v, arc = CASES[case].spot, CASES[case].arc
    theta = 2 * np.pi * arc * np.arange(POINTS) / POINTS
    return np.stack(eq.image_point(np, SETUP, *eq.spot_point(np, v, SETUP, theta)), axis=1)


@cache
def points(case: str) -> Array:
    """The boundary again and again (M, N, 2), with 0.3 px of noise, mm."""
    exact = boundary(case)
    return exact + SIGMA * np.random.default_rng(2).standard_normal((SPOTS, *exact.shape))


def truth(case: str) -> Array:
    """``(z_L, p, q)``."""
    return np.array([CASES[case].spot.z_L, *eq.slopes(np, CASES[case].spot)])


@cache
def bound(case: str) -> Array:
    """The Cramer-Rao bound (3, 3) of the plane."""
    exact = boundary(case)[None]
    seen = Boundary.of(exact, np.broadcast_to(SIGMA**2 * np.eye(2), (*exact.shape, 2)), None)
    return bounds(SETUP, truth(case)[None], seen)[0]


def over_bound(case: str, planes: Array) -> float:
    """RMS error of those planes (M, 3) that there are, pooled by the bound."""
    errors = planes[np.isfinite(planes).all(axis=1)] - truth(case)
    return float(np.sqrt(np.mean(errors * np.linalg.solve(bound(case), errors.T).T)))


def said(case: str, planes: Array) -> dict[str, float | int]:
    """What the table says of an answer."""
    failures = int(np.sum(~np.isfinite(planes).all(axis=1)))
    if failures == len(planes):
        return {"failures": failures}
    return {"over_bound": over_bound(case, planes), "failures": failures}


# --- Ours, OpenCV, SciPy ----------------------------------------------------------------------------------------------

Route = Callable[[Array], Array]
"""From points (M, N, 2), mm, to planes (M, 3); NaN where there is none."""


def with_closed_form(fit: Callable[..., ConicFit]) -> Route:
    """The route of a fit of ours, its covariance included, all sets in a call."""
    return lambda sets: solve_both(fit(sets, SIGMA, check=False).B, SETUP).visible


def opencv(fit: Callable[..., Any]) -> Route:
    """The route of one of OpenCV's fits, set by set: it takes single precision, and pixels."""

    def route(sets: Array) -> Array:
        found = np.array(
            [np.concatenate([np.array(part).ravel() for part in fit(one)]) for one in (sets / PITCH).astype(np.float32)]
        )
        angle = np.radians(found[:, 4])
        B = conic_from_geometric(found[:, :2] * PITCH, found[:, 2:4] / 2 * PITCH, angle)
        return solve_both(B, SETUP).visible

    return route


def one_by_one(solve: Callable[[Array], Array]) -> Route:
    """The route of a solver of one set."""
    return lambda sets: np.array([solve(one) for one in sets])


def programme(formulation: Constrained | Reprojection, solver: Sqp | Ipopt) -> Route:
    """The route of a formulation and a solver, evidence and covariance included."""

    def solve(one: Array) -> Array:
        pose = solve_problem(Problem.from_points(one, SETUP, SIGMA), formulation=formulation, solver=solver).pose
        return np.full(3, np.nan) if pose is None else np.array([pose.z_L, *pose.slopes])

    return one_by_one(solve)


ROUTES: dict[str, Route] = {
    "planeopt, maximum likelihood of many spots": lambda sets: solve_points(sets, SIGMA, SETUP).planes,
    "planeopt, Constrained + Sqp": programme(Constrained(), Sqp()),
    "planeopt, Constrained + Ipopt": programme(Constrained(), Ipopt()),
    "planeopt, Reprojection + Ipopt": programme(Reprojection(), Ipopt()),
    "planeopt's Sampson fit, closed form": with_closed_form(maximum_likelihood),
    "planeopt's Taubin fit, closed form": with_closed_form(taubin),
    "planeopt's least squares (16), closed form": with_closed_form(least_squares),
    "planeopt's direct fit, closed form": with_closed_form(direct),
    "cv2.fitEllipse, closed form": opencv(cv2.fitEllipse),
    "cv2.fitEllipseAMS, closed form": opencv(cv2.fitEllipseAMS),
    "cv2.fitEllipseDirect, closed form": opencv(cv2.fitEllipseDirect),
    "SciPy least_squares, maximum likelihood": one_by_one(minimise),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("what", ROUTES)
def test_route(benchmark: BenchmarkFixture, case: str, what: str) -> None:
    planes = benchmark.pedantic(ROUTES[what], (points(case),), rounds=3)
    benchmark.group = group(case)
    benchmark.extra_info.update(what=what, each=SPOTS, **said(case, planes))


def group(case: str) -> str:
    return f"A plane from {POINTS} points, {case}"


# --- Other programs ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Peer:
    """A function of `peers/worker.py` and the environment that it runs in."""

    what: str
    worker: str
    packages: str
    sets: int = SPOTS


FITTERS = (
    Peer("scikit-image EllipseModel, closed form", "skimage_direct", "fitters"),
    Peer("lsq-ellipse, closed form", "lsq_direct", "fitters"),
    Peer("conics fit_dlt, closed form", "conics_algebraic", "fitters"),
    Peer("conics refine, closed form (5 spots)", "conics_orthogonal", "fitters", 5),
    Peer("ellipsinator direct, closed form", "ellipsinator_direct", "ellipsinator"),
    Peer("ellipsinator guaranteed, closed form", "ellipsinator_guaranteed", "ellipsinator"),
)
CIRCLES = (
    Peer("conics estimate_pose, the better of two", "conics_circles", "fitters"),
    Peer("pye3d unproject_ellipse, the better of two", "pye3d_circles", "pye3d"),
)


def answers(peer: Peer, sets: Array, folder: Path) -> tuple[Array, float, str] | str:
    """Return a peer's answers, seconds a set, and why its first failure failed; or why it cannot be asked."""
    python = environment(peer.packages)
    if isinstance(python, str):
        return python
    np.savez(folder / "points.npz", points=sets / PITCH, focal_px=SETUP.f / PITCH)
    command = [str(python), str(WORKER), peer.worker, str(folder / "points.npz"), str(folder / "answers.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return done.stderr.splitlines()[-1]
    with np.load(folder / "answers.npz") as found:
        return found["answers"], float(found["seconds"]), next((text for text in found["reasons"] if text), "")


def planes_of_conics(conics: Array) -> Array:
    """Planes (M, 3) of conics (M, 6) in pixels."""
    mm = conics / PITCH ** np.array([2, 2, 2, 1, 1, 0])
    return solve_both(mm[:, 1:] / mm[:, :1], SETUP).visible


def planes_of_circles(circles: Array, case: str) -> Array:
    """Planes (M, 3) of two circles each (M, 2, 6) in units of the radius: of both the one nearer to the truth.

    Where a centre's x and y are not given it is taken to be on the beam's axis, where it is.
    """
    normals, centres = circles[..., :3], circles[..., 3:] * SETUP.r
    axis = np.array([SETUP.e_x, SETUP.e_y])
    across = np.where(np.isfinite(centres[..., :2]), centres[..., :2], axis)
    slopes = -normals[..., :2] / normals[..., 2:]
    z_L = centres[..., 2] + np.sum(slopes * (axis - across), axis=-1)
    both = np.concatenate([z_L[..., None], slopes], axis=-1)
    errors = both - truth(case)
    away = np.sum(errors * np.linalg.solve(bound(case), errors[..., None])[..., 0], axis=-1)
    nearer = np.argmin(np.where(np.isfinite(away), away, np.inf), axis=1)
    return both[np.arange(len(both)), nearer]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("peer", FITTERS, ids=lambda peer: peer.worker)
def test_fitter(report: Report, peer: Peer, case: str, tmp_path: Path) -> None:
    found = answers(peer, points(case)[: peer.sets], tmp_path)
    if isinstance(found, str):
        report(group(case), peer.what, None, failures=peer.sets, reason=found)
        return
    conics, seconds, reason = found
    report(group(case), peer.what, seconds, reason=reason, **said(case, planes_of_conics(conics)))


@pytest.mark.parametrize("peer", CIRCLES, ids=lambda peer: peer.worker)
def test_circles(report: Report, peer: Peer, tmp_path: Path) -> None:
    found = answers(peer, points(ACROSS), tmp_path)
    if isinstance(found, str):
        report(group(ACROSS), peer.what, None, failures=SPOTS, reason=found)
        return
    circles, seconds, reason = found
    report(group(ACROSS), peer.what, seconds, reason=reason, **said(ACROSS, planes_of_circles(circles, ACROSS)))
