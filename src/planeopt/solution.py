"""What a solve returns: a status that is a sentence, the plane and its covariance, the evidence, the path."""

import math
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planeopt.plane import Plane, SpotPose
from planeopt.uncertainty import Sigmas, Uncertainty, sigmas

Array = NDArray[np.float64]


class Status(Enum):
    """How a solve ended; the value is the sentence a user reads."""

    CONVERGED = "The plane was found; image and rig agree."
    INCONSISTENT = (
        "The best plane does not explain the image ellipse: chi-squared is beyond its 1e-6 quantile, so the rig, the "
        "boundary points or their sigma are wrong."
    )
    NO_NOISE_SCALE = "The plane was found, but five points leave nothing to estimate their noise from: give sigma_px."
    UNIDENTIFIABLE = "The equations do not fix the plane: their Jacobian is rank deficient."
    OVERDETERMINED = "There are more equations than unknowns: as hard constraints no solver can take them."
    UNUSABLE = "The boundary points cannot be used: they are too few, not finite, without a proper sigma, or on a line."
    NO_PLANE = "No plane before the camera, lit on the side it sees, has a spot with this image ellipse."
    INFEASIBLE = "The solver stopped where the constraints do not hold."
    NOT_CONVERGED = "The solver stopped before it reached a minimum."
    AT_BOUND = "The solution lies on the edge of what can be seen, where the plane is not determined from both sides."
    LOCAL_MINIMUM = (
        "The search ended at a local minimum: the plane is farther from the one that the image favours than its own "
        "covariance allows."
    )
    UNSEEN = (
        "The search ended on a plane whose lit side faces away from the camera (c < 0): it may have the same image, "
        "but it cannot be seen."
    )
    NO_COVARIANCE = "The plane was found, but no covariance can be given."
    UNSUITED = "The solver is not made for such a programme."

    @property
    def record(self) -> Literal["ok", "degraded", "refused"]:
        """Status of a pose record: ``ok``, ``degraded`` (a pose, with a reservation) or ``refused`` (no pose)."""
        if self is Status.CONVERGED:
            return "ok"
        degraded = (Status.INCONSISTENT, Status.NO_NOISE_SCALE, Status.AT_BOUND, Status.NO_COVARIANCE)
        return "degraded" if self in degraded else "refused"


class Flag(Enum):
    """A reservation about a result that is no failure; the value is the sentence a user reads."""

    SCALE_ESTIMATED = "No sigma was given: the noise scale is estimated from the residuals of the ellipse fit."
    SCALE_AT_FLOOR = "The residuals are at rounding level: the noise scale is set to a floor, intervals are nominal."
    RESTARTED = "The first solution failed the chi-squared test or did not converge: solved again from the closed form."
    BETA_UNDEFINED = "alpha is 0: beta means nothing, read the normal."
    ANGLES_NONLINEAR = (
        "The slopes' standard deviation is over a tenth of tan(alpha): "
        "first-order sigmas of alpha, beta and R are rough."
    )
    WEAK = "The slopes' standard deviation is over 0.2: first-order intervals are too short."
    BOUND_OUT_OF_REACH = (
        "The noise is large for the size of this spot's image, or the plane so uncertain that its image is no longer "
        "linear over it: intervals of first order may be too short; the posterior's are right."
    )
    SHORT_ARC = "Under a third of the ellipse is covered by points: intervals of first order are rough."
    POINTS_SCATTER = "The points scatter about the plane's ellipse by more than their sigma says (p < 1e-6)."
    RIG_WITHOUT_COVARIANCE = "The rig file has no covariance: sigma is the spot's part only."
    RIG_REFUSED = "The rig's calibration was refused: its file says why, and nothing measured with it can be defended."


@dataclass(frozen=True)
class Residual:
    """One of the ten equations, evaluated again at the solution: left minus right, in ``unit``.

    ``sigmas`` is what an error of this size in this equation's data alone would show, in standard deviations; None for
    the laser block, whose data are the rig's.
    """

    equation: str
    name: str
    block: str
    unit: str
    value: float
    sigmas: float | None = None


@dataclass(frozen=True)
class Identifiability:
    """Counts and ranks before a solve, at its start.

    Attributes
    ----------
    n_equations, n_unknowns : int
        As the paper counts: 10 and 4.
    rank, laser_rank, image_rank : int
        Of the ten rows, of (11)-(15), and of (17)-(21).
    singular_values : tuple of float
        Of the independent system (the one laser equation and the image block) in ``(R, z_L, p, q)``, largest first.
    dependent_rows : tuple of str
        Laser equations that repeat another one, by number.
    null_vector : str or None
        In words, where the independent system is rank deficient.
    """

    n_equations: int
    n_unknowns: int
    rank: int
    laser_rank: int
    image_rank: int
    singular_values: tuple[float, ...]
    dependent_rows: tuple[str, ...]
    null_vector: str | None = None

    @property
    def sentence(self) -> str:
        rows = f"; {', '.join(self.dependent_rows)} repeat the others" if self.dependent_rows else ""
        return (
            f"{self.n_equations} equations, {self.n_unknowns} unknowns, laser block rank {self.laser_rank}, "
            f"image block rank {self.image_rank}, together rank {self.rank}{rows}"
        )


FEASIBLE = 1e-4
"""Largest violation of a constraint at a solution, in units of its row (standard deviations of B, or radii of the
beam).

It can be loose, because the Newton step that must also be small goes onto the constraints; tighter, and a row whose
standard deviation is near the rounding of B itself could never pass."""

RESOLUTION = 1e-8
"""Largest step that may be left at a solution, relative to depth, and in slopes to 1 + tan^2(alpha)."""

DUAL = 1e-6
"""Largest multiplier with the wrong sign, over the size of the multipliers, at a solution."""


@dataclass(frozen=True)
class KktCheck:
    """Optimality as recomputed here, not as the solver reports it.

    Attributes
    ----------
    feasibility : float
        Largest violation of a row or bound over its scale.
    step : float
        By how much the Newton step to the nearest KKT point would still move the plane, relative as in `RESOLUTION`.
    dual : float
        Largest inequality multiplier with the wrong sign over the size of the multipliers.
    minimum : bool
        Whether the Lagrangian curves upwards there: not a saddle or a maximum.
    """

    feasibility: float
    step: float
    dual: float
    minimum: bool = True

    @property
    def feasible(self) -> bool:
        return self.feasibility <= FEASIBLE

    @property
    def ok(self) -> bool:
        return self.feasible and self.step <= RESOLUTION and self.dual <= DUAL and self.minimum


@dataclass(frozen=True)
class Trace:
    """The path of a search, one row an iteration; ``x`` only where the solver was asked to record it.

    Attributes
    ----------
    objective, infeasibility : (n,)
        As the solver saw them, in the scaled units of its stage.
    stage : (n,) of int
        Which stage (weight) the iteration belongs to.
    x : (n, n_x) or None
        Iterates, in the formulation's variables.
    """

    objective: Array
    infeasibility: Array
    stage: NDArray[np.integer]
    x: Array | None = None


@dataclass(frozen=True)
class Effort:
    """What a solve cost. Counted is what the search asks for, not what checks its answer afterwards.

    Attributes
    ----------
    iterations : int
        Newton steps of the final polish included.
    evaluations : int
        Points at which the objective and the rows were evaluated; both at one point are one.
    first_derivatives, second_derivatives : int
        Points at which the gradient and the Jacobian, and at which the Hessian of the Lagrangian were evaluated.
    build_s : float
        Seconds for making the programme's functions and its solver; nothing to speak of where an earlier solve made
        them.
    solve_s : float
        Seconds for the search, its polish and the check of the optimality conditions; of a direct answer, for that.
    """

    iterations: int = 0
    evaluations: int = 0
    first_derivatives: int = 0
    second_derivatives: int = 0
    build_s: float = 0.0
    solve_s: float = 0.0

    @property
    def derivative_evaluations(self) -> int:
        """Of first and of second derivatives."""
        return self.first_derivatives + self.second_derivatives

    def __add__(self, more: "Effort") -> "Effort":
        return Effort(*(getattr(self, field.name) + getattr(more, field.name) for field in fields(Effort)))


@dataclass(frozen=True)
class End:
    """Where a search ended, in its own unknowns, whether or not that is an answer.

    Attributes
    ----------
    R : float
        mm; the beam's where the programme has no such unknown, otherwise the unknown, which only a hard laser block
        keeps on the beam.
    z_L, p, q : float
        Of the laser-parallel frame, as in the equations.
    """

    R: float
    z_L: float
    p: float
    q: float


@dataclass(frozen=True)
class OtherPlane:
    """The second exact solution of the ten equations, and why it was excluded."""

    pose: SpotPose
    plane: Plane
    reason: str


@dataclass(frozen=True)
class RigTest:
    """What one image's test of the rig is made of, so that many images can be tested together.

    Attributes
    ----------
    misfit : (2,)
        The part of the image ellipse's misfit that no plane can change, in standard deviations of the spot: white of
        unit variance where rig and points are right.
    by_rig : (2, n)
        Its derivative by the parameters of the rig's covariance; n is 0 without one.
    by_beam : (2, 4)
        Its derivative by e_x, e_y (mm), direction_x and direction_y.
    fineness : float
        Standard deviation of a point over the image ellipse's shorter semi-axis and over the root of the number of
        points: how much of a misfit is of second order, in standard deviations, over its square.
    """

    misfit: Array
    by_rig: Array
    by_beam: Array
    fineness: float


@dataclass(frozen=True)
class Solution:
    """The answer to "which plane", with everything needed to judge it.

    Attributes
    ----------
    status : Status
    message : str
        The status's sentence, with the numbers of this case.
    formulation, solver : str
        Names of what was solved and by what; ``solver`` is ``"none"`` for a direct answer.
    pose : SpotPose or None
        ``(R, z_L, alpha, beta)`` in the laser-parallel frame; ``z_L`` along the beam from ``(e_x, e_y, 0)``. None
        where refused.
    plane : Plane or None
        In the camera frame.
    uncertainty : Uncertainty or None
        None with its reason in ``uncertainty_reason``.
    chi2, dof, p_value : float, int, float
        Of the image ellipse against the rig: tests the rig and the points, not the plane; never the focal length or
        the scale.
    chi2_points, dof_points : float, int
        Of the points' distances from the plane's ellipse.
    rig_test : RigTest or None
        What chi2 is made of; None where the rig or the noise's scale is not known.
    other_plane : OtherPlane or None
    residuals : tuple of Residual
        All ten equations at the solution.
    end : End or None
        Where the search stopped, also where no plane came of it; None where nothing was searched or found.
    identifiability, kkt, trace, effort
        Evidence: see their classes.
    """

    status: Status
    message: str
    formulation: str
    solver: str
    pose: SpotPose | None = None
    plane: Plane | None = None
    uncertainty: Uncertainty | None = None
    uncertainty_reason: str | None = None
    radius: float = math.nan
    chi2: float | None = None
    dof: int = 2
    p_value: float | None = None
    chi2_points: float | None = None
    dof_points: int | None = None
    rig_test: RigTest | None = None
    other_plane: OtherPlane | None = None
    residuals: tuple[Residual, ...] = ()
    end: End | None = None
    identifiability: Identifiability | None = None
    kkt: KktCheck | None = None
    trace: Trace | None = None
    effort: Effort = field(default_factory=Effort)
    n_points: int = 0
    arc_fraction: float | None = None
    flags: tuple[Enum, ...] = ()

    @property
    def ok(self) -> bool:
        return self.status is Status.CONVERGED

    @property
    def worst(self) -> Residual | None:
        """The image equation whose residual is largest in its own standard deviations; with `Elastic` the one at fault.

        A least-squares solution spreads a gross error over all equations; only an L1 solution leaves it in its place.
        """
        image = [residual for residual in self.residuals if residual.sigmas is not None]
        return max(image, key=lambda residual: residual.sigmas or 0.0, default=None)

    @property
    def covariance(self) -> Array | None:
        """Of ``(z_L, p, q)``, (3, 3), spot and rig together; None where there is none."""
        return None if self.uncertainty is None else self.uncertainty.spot + self.uncertainty.rig

    @property
    def sigma(self) -> Sigmas | None:
        """Standard deviations, spot and rig together."""
        if self.uncertainty is None or self.pose is None or self.covariance is None:
            return None
        u = self.uncertainty
        return sigmas(self.pose, self.covariance, u.normal_spot + u.normal_rig, self.radius, u.radius)

    @property
    def sigma_spot(self) -> Sigmas | None:
        """Standard deviations without the rig's part."""
        if self.uncertainty is None or self.pose is None:
            return None
        return sigmas(self.pose, self.uncertainty.spot, self.uncertainty.normal_spot, self.radius)


class SolveError(RuntimeError):
    """A solve that found no defensible plane, raised on request (``throw=True``); carries the `Solution`."""

    def __init__(self, solution: Solution) -> None:
        super().__init__(solution.message)
        self.solution = solution
