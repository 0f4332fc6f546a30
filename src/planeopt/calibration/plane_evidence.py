"""The most probable rig, given images of unknown planes and what was known of the rig before."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.estimation import BatchSolution, solve_batch
from planeopt.rig import PARAMETERS, Rig, RigCovariance
from planeopt.solution import Flag
from planeopt.spot import Spot

Array = NDArray[np.float64]

_STEPS = 30
_HALVINGS = 8
# Of a step, in standard deviations of the result: a hundredth of one changes no conclusion.
_CONVERGED = 1e-2
# Of chi-squared: what a step may still promise where none that is tried keeps it.
_STALLED = 1.0


@dataclass(frozen=True, eq=False)
class RigPrior:
    """What is known of a rig before the images.

    Attributes
    ----------
    rig : Rig
        Its covariance is `allowed`.
    names : tuple of str
        Of what is free.
    values : (n,)
    calibrated, allowed : (n, n)
        Covariance of the calibration, zero for what was not free in it; and with the moves that may have happened.
    """

    rig: Rig
    names: tuple[str, ...]
    values: Array
    calibrated: Array
    allowed: Array

    def at(self, values: Array) -> Rig:
        """Return the rig with other values; its covariance names what is free."""
        return self.rig.with_parameters(dict(zip(self.names, values.tolist(), strict=True)))


def rig_prior(rig: Rig, moved: Mapping[str, float]) -> RigPrior:
    """Return what is known of a rig whose parameters may have moved since its calibration, by these variances."""
    old = () if rig.covariance is None else rig.covariance.parameters
    names = tuple(name for name in PARAMETERS if name in old or name in moved)
    calibrated = np.zeros((len(names), len(names)))
    place = [names.index(name) for name in old]
    calibrated[np.ix_(place, place)] = rig.covariance_matrix
    allowed = calibrated + np.diag([moved.get(name, 0.0) for name in names])
    free = replace(rig, covariance=RigCovariance(names, allowed))
    return RigPrior(free, names, np.array([rig.parameter(name) for name in names]), calibrated, allowed)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The misfits (2n,) of n images at a rig, and their derivatives by what is free and by the beam's `SEEN`."""

    misfit: Array
    by_rig: Array
    by_beam: Array
    fine: Array


@dataclass(frozen=True, eq=False)
class MostProbable:
    """Where the search ended: values (n,) of what is free, their covariance (n, n), the misfits there."""

    prior: RigPrior
    values: Array
    covariance: Array
    linear: Linearised
    steps: int
    converged: bool


def _linear(spots: Sequence[Spot], rig: Rig) -> Linearised | None:
    """Solve all planes again; None where one has no misfit."""
    batch = solve_batch(spots, rig)
    if not np.isfinite(batch.misfit).all():
        return None
    scale = np.repeat(_as_normal(batch), 2)
    return Linearised(
        batch.misfit.reshape(-1) * scale,
        batch.misfit_by_rig.reshape(len(scale), -1) * scale[:, None],
        batch.misfit_by_beam.reshape(len(scale), -1) * scale[:, None],
        batch.fineness,
    )


def _as_normal(batch: BatchSolution) -> Array:
    """Factors (n,) that make misfits over a scale that was estimated normal, whose squares follow F; 1 elsewhere."""
    estimated = np.array([Flag.SCALE_ESTIMATED in flags for flags in batch.flags])
    size = np.maximum(np.sum(batch.misfit**2, axis=1), np.finfo(np.float64).tiny)
    dof = np.maximum(batch.n_points - _ELLIPSE, 1)
    return np.where(estimated, np.sqrt(dof * np.log1p(size / dof) / size), 1.0)


_ELLIPSE = 5


def most_probable(spots: Sequence[Spot], prior: RigPrior) -> MostProbable | None:
    """Return the rig that minimises the images' misfits and the prior's together; None where no search ends.

    Gauss-Newton with halved steps, in units in which the prior is white.

    Parameters
    ----------
    spots : sequence of Spot
        Each with a plane at the rig that the prior is about.
    prior : RigPrior
    """
    factor = np.asarray(np.linalg.cholesky(prior.allowed), dtype=np.float64)

    def done(linear: Linearised, white: Array, triangle: Array, count: int, *, converged: bool) -> MostProbable:
        half = np.asarray(np.linalg.solve(triangle.T, factor.T), dtype=np.float64)
        return MostProbable(prior, prior.values + factor @ white, half.T @ half, linear, count, converged)

    white = np.zeros(len(prior.names))
    linear = _linear(spots, prior.rig)
    if linear is None:
        return None
    for count in range(1, _STEPS + 1):
        by_white = linear.by_rig @ factor
        # QR, not normal equations: an image that is sharp sees some directions 10^4 times as well as the prior.
        orthogonal, triangle = np.linalg.qr(np.vstack([by_white, np.eye(len(white))]))
        pull = orthogonal.T @ np.concatenate([linear.misfit, white])
        step = -np.asarray(np.linalg.solve(triangle, pull), dtype=np.float64)
        gain = float(np.sum((triangle @ step) ** 2))
        if gain < _CONVERGED**2:
            return done(linear, white, triangle, count, converged=True)
        cost = float(linear.misfit @ linear.misfit + white @ white)
        shorter = _shorter(spots, prior, factor, white, step, cost)
        if shorter is None:
            # Images that contradict each other leave so large misfits that their next order decides where it ends.
            return done(linear, white, triangle, count, converged=gain < _STALLED)
        linear, white = shorter
    return None


def _shorter(
    spots: Sequence[Spot], prior: RigPrior, factor: Array, white: Array, step: Array, cost: float
) -> tuple[Linearised, Array] | None:
    """The first of a step, its half, its quarter, ... that is better; None where none is."""
    for halved in range(_HALVINGS):
        tried = white + step / 2**halved
        try:
            linear = _linear(spots, prior.at(prior.values + factor @ tried))
        except InputError:
            continue
        if linear is not None and linear.misfit @ linear.misfit + tried @ tried <= cost:
            return linear, tried
    return None
