"""The normal law at the top of the likelihood, carried to the distance along the beam."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planeopt.formulations.problem import Problem
from planeopt.posterior.gaussian import Laplace
from planeopt.posterior.proposal import Peak, climb
from planeopt.posterior.quantities import beams
from planeopt.posterior.target import Target

Array = NDArray[np.float64]

_STEP = 0.05


def laplace_of(target: Target, problem: Problem, peak: Peak | None) -> Laplace | None:
    """Normal law of ``(z_L, p, q)``, z_L along the beam; None where the likelihood has no peak inside.

    Parameters
    ----------
    target : Target
    problem : Problem
    peak : Peak or None
        Of the log likelihood, in the target's coordinates.
    """
    if peak is None or not peak.curved:
        return None
    plane = target.planes(peak.centre[None])[0]
    scale = np.diag([plane[0], 1.0, 1.0])
    covariance = scale @ peak.covariance[:3, :3] @ scale
    if target.likelihood.rig is None:
        along = plane - [problem.axial_shift, 0, 0]
        return Laplace(along, covariance, covariance)
    known = replace(target, likelihood=replace(target.likelihood, rig=None))
    top = climb(known.log_likelihood, peak.centre, peak.root)
    spot = scale @ top.covariance[:3, :3] @ scale
    shift, by_plane, left = _axial_shift(target, problem, peak)
    carry = np.eye(3)
    carry[0] -= by_plane @ np.linalg.inv(scale)
    covariance = carry @ covariance @ carry.T
    covariance[0, 0] += left
    return Laplace(plane - [shift, 0, 0], covariance, spot)


def _axial_shift(target: Target, problem: Problem, peak: Peak) -> tuple[float, Array, float]:
    """``(Q e)_z`` at the likeliest rig, its derivative (3,) by theta, and its variance given theta."""
    rig = target.likelihood.rig
    if rig is None:
        return problem.axial_shift, np.zeros(3), 0.0
    d = target.dimension
    steps = _STEP * np.concatenate([np.zeros((1, d)), np.eye(d), -np.eye(d)])
    theta = peak.centre + steps @ peak.root.T
    mean, information = target.likelihood.rig_given(target.planes(theta), target.log_scale(theta))
    shifts = beams(problem, rig.parameters, rig.parameters_at(mean)).axial_shift
    by_units = (shifts[1 : d + 1] - shifts[d + 1 :]) / (2 * _STEP)
    around = mean[0] + _STEP * np.concatenate([np.eye(rig.size), -np.eye(rig.size)])
    moved = beams(problem, rig.parameters, rig.parameters_at(around)).axial_shift
    by_rig = (moved[: rig.size] - moved[rig.size :]) / (2 * _STEP)
    by_theta = np.asarray(np.linalg.solve(peak.root.T, by_units), dtype=float)
    return float(shifts[0]), by_theta[:3], float(by_rig @ np.linalg.solve(information[0], by_rig))
