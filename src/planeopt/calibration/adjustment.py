"""The joint adjustment: camera, poses, bow of the board and beam, from residuals in pixels with their own sigmas."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Observations
from planeopt.calibration.approach import approach
from planeopt.calibration.arrow import Inverse, condition
from planeopt.calibration.equations import AdjustmentError, Prior, Task, Weights, descend, equations
from planeopt.calibration.model import FULL, Model
from planeopt.calibration.noise import (
    ELLIPSE,
    Noise,
    ellipse_misfits,
    noise_from,
    robust_noise,
    weights_given,
    without_outliers,
)
from planeopt.calibration.packed import Packed
from planeopt.calibration.start import LEAST_CORNERS
from planeopt.calibration.state import State
from planeopt.errors import InputError
from planeopt.rig import Camera, Rig, RigCovariance, SpotDefinition

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CONVERGED = 0.01
"""Standard deviations that the least cost may be away."""

_ROUNDS = 5  # of weights that depend on residuals that depend on weights
_SETTLED = 1e-3  # of a factor of the sigmas: it is known to a percent or so
_MAY_VANISH = ("k1", "k2", "p1", "p2", "k3", "warp_x", "warp_y", "direction_x", "direction_y", "divergence")


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A rig, the poses of the boards, and how well they explain what was seen.

    Parameters
    ----------
    observations : Observations
    model : Model
    state : State
        All shared values (`planeopt.calibration.model.FULL`), held and free, and the poses.
    covariance : (g, g) array
        Joint covariance of the free parameters in the order of `names`: px, mm, 1.
    pose_covariances : (V, 6, 6) array
        Of a rotation vector (rad, applied after the rotation, about the board's origin) and the translation (mm).
    noise : Noise
    corner_residuals : tuple of (N, 2) arrays
        Observed minus predicted, px, view by view, in the order of the views' corners.
    corner_used : tuple of (N,) arrays of bool
    spot_residuals : tuple of (M,) arrays
        Across the boundary, px, positive outside; empty where there is no spot.
    spot_used : (V,) array of bool
        Which views' spots are used.
    spot_chi2 : (V,) array
        What of a spot's misfit an ellipse can show (5 numbers), over the sigmas given; NaN without a spot.
    cost : float
        Sum of all squared residuals over their sigmas, with the noise's factors.
    chi2_corners, chi2_spots : float
        Sums of squares over the sigmas given, of what is used; of the spots at the level of their ellipses.
    dof_corners, dof_spots : float
        Degrees of freedom of these: numbers observed less the unknowns that they pay for.
    information : (g, g) array
        About the free parameters, the poses being unknown; with the prior.
    condition : float
        See `planeopt.calibration.arrow.condition`.
    iterations : int
        Steps of the last descent.
    left : float
        Standard deviations that the least cost may be away.
    before : Adjustment, optional
        The same with all observations, where some were left out.
    held : Rig, optional
        Where what is not free stays.
    prior : Prior, optional
        What was known beforehand.
    """

    observations: Observations
    model: Model
    state: State
    covariance: Array
    pose_covariances: Array
    noise: Noise
    corner_residuals: tuple[Array, ...]
    corner_used: tuple[Mask, ...]
    spot_residuals: tuple[Array, ...]
    spot_used: Mask
    spot_chi2: Array
    cost: float
    chi2_corners: float
    dof_corners: float
    chi2_spots: float
    dof_spots: float
    information: Array
    condition: float
    iterations: int
    left: float
    before: "Adjustment | None" = None
    held: Rig | None = None
    prior: Prior | None = None

    @property
    def converged(self) -> bool:
        """Whether the least cost was reached; if not, the observations contradict each other, or leave a way open."""
        return self.left < CONVERGED

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.model.names

    @property
    def rotations(self) -> Array:
        """Rotations (V, 3, 3), board to camera."""
        return self.state.rotations

    @property
    def translations(self) -> Array:
        """Translations (V, 3), the board's origin in the camera frame, mm."""
        return self.state.translations

    @property
    def values(self) -> Array:
        """Values (g,) of the free parameters."""
        return np.array([self.value(name) for name in self.names])

    def value(self, name: str) -> float:
        """Return a shared parameter, free or not: px, mm, 1."""
        return self.state.value(name)

    def sigma(self, name: str) -> float:
        """Return the standard deviation of a free parameter; 0 of one that is held."""
        if name not in self.names:
            return 0.0
        row = self.names.index(name)
        return float(np.sqrt(self.covariance[row, row]))

    @property
    def corner_sigma(self) -> float:
        """Standard deviation of a coordinate of a typical corner, px: the rms of the sigmas given, times the factor."""
        return self.noise.corners * self.observations.corner_sigma

    @cached_property
    def camera(self) -> Camera:
        """The camera."""
        return replace(self.state.camera, pixel_pitch_mm=self.observations.pixel_pitch_mm)

    @cached_property
    def rig(self) -> Rig:
        """The rig, with the joint covariance of what is free of it; the board's bow is marginalised."""
        has_beam = self.model.beam != "none" or (self.held is not None and self.held.beam is not None)
        names = self.model.freedom
        rows = [self.names.index(name) for name in names]
        covariance = RigCovariance(names, self.covariance[np.ix_(rows, rows)]) if names else None
        kind = self.observations.spot
        held = self.held
        if held is not None and held.spot is not None:
            definition: SpotDefinition | None = held.spot
        else:
            definition = SpotDefinition(kind=kind) if has_beam and kind != "none" else None
        return Rig(
            camera=self.camera,
            beam=self.state.beam if has_beam else None,
            spot=definition,
            covariance=covariance,
            mount=None if held is None else held.mount,
        )


def adjust(
    observations: Observations,
    model: Model | None = None,
    *,
    prior: Rig | Prior | None = None,
    held: Rig | None = None,
    start: State | Camera | None = None,
    noise: Noise | None = None,
    reject: bool = True,
) -> Adjustment:
    """Adjust a rig to what was seen of a board.

    Huber's loss leads to the neighbourhood; there, observations beyond `REJECT` standard deviations are left out by
    rule, and least squares give the rest. The corners' noise is estimated from their residuals; the spots' is taken as
    given, or raised to what their ellipses' misfits show.

    Parameters
    ----------
    observations : Observations
        Each view with at least `LEAST_CORNERS` corners.
    model : Model, optional
    prior : Rig or Prior, optional
        What is known of free parameters beforehand; a rig with its covariance.
    held : Rig, optional
        Where what is not free stays; needed where the camera is not free.
    start : State or Camera, optional
        With as many poses as there are views; or a camera from which to look for them.
    noise : Noise, optional
        Known factors of the sigmas, instead of those estimated.
    reject : bool
        Whether outliers are left out.

    Raises
    ------
    AdjustmentError
        If the observations do not determine the free parameters. Where they contradict each other so much that no least
        cost is reached, `Adjustment.converged` is false.
    InputError
        If there is no view, or a view has too few corners.
    """
    model = Model() if model is None else model
    if not observations.views:
        raise InputError("there is no view to calibrate from")
    for view in observations.views:
        if len(view) < LEAST_CORNERS:
            raise InputError(f"{view.name}: {len(view)} corners; each view needs {LEAST_CORNERS}")
    packed = Packed.of(observations)
    with_beam = model.beam != "none" or (held is not None and held.beam is not None)
    task = Task(
        packed,
        model,
        with_beam and bool(packed.boundary_seen.any()),
        rig_prior(prior, model) if isinstance(prior, Rig) else prior,
    )
    if model.beam != "none" and not task.with_spots:
        raise AdjustmentError("No view has a spot: the beam cannot be found without one.")
    _enough(task)
    job = _Job(observations, task, noise, held)
    try:
        if isinstance(start, State):
            state = _near(job, _with_one_focal_length(start, model))
        else:
            state = _near(job, approach(task, held, start))
        return job.finish(state, reject=reject)
    except np.linalg.LinAlgError as error:
        raise AdjustmentError("The observations do not determine the free parameters: too few views.") from error


def _with_one_focal_length(state: State, model: Model) -> State:
    """Return a state with fx and fy equal where they are one parameter."""
    if not model.camera or model.focal == "separate" or state.value("fx") == state.value("fy"):
        return state
    both = (state.value("fx") + state.value("fy")) / 2
    return replace(state, values=np.where(np.isin(FULL, ("fx", "fy")), both, state.values))


def weights_kept(adjustment: Adjustment, packed: Packed) -> Weights:
    """Return the weights by the sigmas given of what an adjustment used; 0 for what it left out."""
    given = weights_given(packed)
    used = np.zeros_like(packed.corner_seen)
    for row, (view, kept) in enumerate(zip(adjustment.observations.views, adjustment.corner_used, strict=True)):
        used[row, view.ids] = kept
    return Weights(given.corners * used, given.boundary * adjustment.spot_used[:, None])


def refit(adjustment: Adjustment, model: Model) -> Adjustment:
    """Adjust another model to the same observations with the same weights: what tests compare.

    Parameters
    ----------
    adjustment : Adjustment
        Of the model to compare with; its noise and what it left out are kept. What is free in it and not in the other
        model is set to zero: distortions, bow, divergence, the beam's tilt.
    model : Model

    Raises
    ------
    AdjustmentError
        If the observations do not determine the model.
    """
    packed = Packed.of(adjustment.observations)
    weights = weights_kept(adjustment, packed)
    dropped = [name for name in adjustment.names if name not in model.names and name in _MAY_VANISH]
    start = replace(adjustment.state, values=np.where(np.isin(FULL, dropped), 0.0, adjustment.state.values))
    start = _with_one_focal_length(start, model)
    task = Task(packed, model, bool(adjustment.spot_used.any()) and model.beam != "none", adjustment.prior)
    try:
        job = _Job(adjustment.observations, task, adjustment.noise, adjustment.held)
        return job.fit(start, weights, adjustment.noise)
    except np.linalg.LinAlgError as error:
        raise AdjustmentError("The observations do not determine the free parameters: too few views.") from error


def _enough(task: Task) -> None:
    seen = 2 * np.count_nonzero(task.packed.corner_seen)
    if task.with_spots:
        seen += ELLIPSE * int(np.count_nonzero(task.packed.with_spot))
    unknown = 6 * len(task.packed) + len(task.model.names)
    if seen <= unknown and task.prior is None:
        raise AdjustmentError(f"{seen} numbers observed cannot determine {unknown} unknowns: more views are needed.")


def rig_prior(rig: Rig, model: Model) -> Prior:
    """Return what a calibrated rig says of a model's parameters, as a prior.

    Raises
    ------
    InputError
        If the rig has no covariance, or one of a parameter that is not free.
    """
    if rig.covariance is None:
        raise InputError("the rig has no [covariance]: it cannot be a prior")
    names = rig.covariance.parameters
    missing = next((name for name in names if name not in model.names), None)
    if missing is not None:
        raise InputError(f"the rig's covariance has {missing!r}, which is not free in this adjustment")
    units = np.outer(rig.covariance.sigmas, rig.covariance.sigmas)
    values = np.array([rig.parameter(name) for name in names])
    return Prior(names, values, np.linalg.inv(rig.covariance.correlation) / units)


@dataclass(frozen=True, eq=False)
class _Job:
    """One adjustment under way: what is given."""

    observations: Observations
    task: Task
    noise: Noise | None
    held: Rig | None

    def finish(self, state: State, *, reject: bool) -> Adjustment:
        """Least squares with all observations, and again without those that are wrong by rule."""
        given = weights_given(self.task.packed)
        here = equations(self.task, state, given)
        noise = robust_noise(self.task, here) if self.noise is None else self.noise
        full = self._settle(state, given, noise)
        if not reject:
            return full
        kept = without_outliers(self.task, here, noise)
        if np.count_nonzero(kept.corners) + np.count_nonzero(kept.boundary) == np.count_nonzero(
            given.corners
        ) + np.count_nonzero(given.boundary):
            return full
        return replace(self._settle(state, kept, noise), before=full)

    def _settle(self, state: State, weights: Weights, noise: Noise) -> Adjustment:
        """Least squares, and the noise's factors from its residuals, until they agree."""
        fit = self.fit(state, weights, noise)
        for _ in range(_ROUNDS):
            found = noise_from(fit.chi2_corners, fit.dof_corners, fit.chi2_spots, fit.dof_spots)
            if self.noise is not None or np.allclose(
                [found.corners, found.spots], [fit.noise.corners, fit.noise.spots], rtol=_SETTLED, atol=0
            ):
                break
            fit = self.fit(fit.state, weights, found)
        return fit

    def fit(self, state: State, weights: Weights, noise: Noise) -> Adjustment:
        """Least squares with these weights."""
        task, packed, views = self.task, self.task.packed, self.observations.views
        descent = descend(task, state, noise.weights(weights))
        here = descent.here
        inverse = Inverse.of(here.total)
        square = here.corners.residual**2 * np.repeat(weights.corners, 2, axis=1)
        used = np.asarray(weights.boundary.any(axis=1), dtype=np.bool_)
        misfits = ellipse_misfits(here, weights_given(packed))
        residuals = here.corners.residual.reshape(len(packed), -1, 2)
        boundary = np.zeros(packed.boundary_seen.shape)
        if here.boundaries is not None:
            boundary = here.boundaries.linear.residual
        return Adjustment(
            observations=self.observations,
            model=task.model,
            state=here.state,
            covariance=inverse.shared,
            pose_covariances=inverse.pose,
            noise=noise,
            corner_residuals=tuple(residuals[row, view.ids] for row, view in enumerate(views)),
            corner_used=tuple(weights.corners[row, view.ids] > 0 for row, view in enumerate(views)),
            spot_residuals=tuple(boundary[row, packed.boundary_seen[row]] for row in range(len(packed))),
            spot_used=used if task.with_spots else np.zeros_like(used),
            spot_chi2=np.where(packed.with_spot & task.with_spots, misfits, np.nan),
            cost=here.cost,
            chi2_corners=float(square.sum()),
            dof_corners=2 * np.count_nonzero(weights.corners) - inverse.trace(here.by_corners),
            chi2_spots=float(misfits[used].sum()),
            dof_spots=ELLIPSE * np.count_nonzero(used) * task.with_spots - inverse.trace(here.by_boundary),
            information=here.total.reduced(),
            condition=condition(here.total),
            iterations=descent.steps,
            left=descent.left,
            held=self.held,
            prior=task.prior,
        )


def _near(job: _Job, state: State) -> State:
    """Return the state at the least of Huber's loss, whose scale is that of the residuals' medians."""
    given = weights_given(job.task.packed)
    for _ in range(2 if job.noise is None else 1):
        noise = robust_noise(job.task, equations(job.task, state, given)) if job.noise is None else job.noise
        state = descend(job.task, state, noise.weights(given), huber=True).here.state
    return state
