"""What sampling returns."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from planeopt.posterior.diagnostics import Diagnostics
from planeopt.posterior.gaussian import Agreement, Laplace
from planeopt.posterior.likelihood import Scale
from planeopt.posterior.prior import PlanePrior
from planeopt.posterior.summary import (
    Cone,
    Interval,
    Split,
    circular_interval,
    cone,
    intercept_interval,
    interval,
    may_be_untilted,
    variance_split,
)

Array = NDArray[np.float64]

_INTERCEPTS = ("a", "b", "c")

_FEW_DRAWS = 10


@dataclass(frozen=True, eq=False)
class Mode:
    """One of the places where the posterior is concentrated.

    Attributes
    ----------
    weight, error : float
        Its share of the posterior, and that share's standard error.
    plane : (3,)
        Medians of ``(z_L, p, q)`` in it, z_L along the beam.
    lit_side : bool
        Whether the camera sees the side that the laser lights; else it sees the spot through the plane.
    """

    weight: float
    error: float
    plane: Array
    lit_side: bool


@dataclass(frozen=True)
class PriorEffect:
    """How much the prior says, beside the points.

    Attributes
    ----------
    dominated : bool
        Whether it moves the answer by more than the stated share of its width.
    sentence : str
        By how much.
    """

    dominated: bool
    sentence: str


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws from the posterior of a plane, and what follows from them.

    Attributes
    ----------
    samples : (S, 3)
        ``(z_L, p, q)``, z_L along the beam, nearly independent draws; mm, 1, 1.
    rig_samples : (S, k)
        The rig's parameters of each draw, in their own units; k is 0 where the rig was taken as it stands.
    rig_parameters : tuple of str
        Their names.
    quantities : mapping of str to (S,)
        ``z_L, p, q, alpha, beta, R, normal_x, normal_y, normal_z, a, b, c``: mm, rad, 1; normal and intercepts in the
        camera frame; and ``noise_scale``, over the estimated one, where the noise's scale was sampled.
    laplace : Laplace or None
        The first-order normal law; None where the likelihood has no peak inside.
    agreement_with_laplace : Agreement
    diagnostics : Diagnostics
    prior : PlanePrior
    prior_sentence : str
        The prior in words, with its numbers.
    prior_effect : PriorEffect
    scale : Scale
        What was known of the noise's scale.
    robust : float or None
        Degrees of freedom of Student's t.
    modes : tuple of Mode
        One, or where both sides may be seen two, the heavier first.
    flags : tuple of Enum
        What a reader should know of the points.
    """

    samples: Array
    rig_samples: Array
    rig_parameters: tuple[str, ...]
    quantities: Mapping[str, Array]
    laplace: Laplace | None
    agreement_with_laplace: Agreement
    diagnostics: Diagnostics
    prior: PlanePrior
    prior_sentence: str
    prior_effect: PriorEffect
    scale: Scale
    robust: float | None
    modes: tuple[Mode, ...]
    flags: tuple[Enum, ...] = ()

    def __len__(self) -> int:
        """Return the number of draws."""
        return len(self.samples)

    def summary(self, name: str) -> Interval | None:
        """Median and equal-tailed intervals of a quantity.

        Parameters
        ----------
        name : str
            One of `quantities`.

        Returns
        -------
        Interval or None
            None for ``beta`` where the plane may well be untilted (0 lies in the slopes' 99 % region), and for an
            intercept whose 95 % interval passes through infinity.

        Raises
        ------
        KeyError
            For another name.
        """
        draws = self.quantities[name]
        if name == "beta":
            return None if self._may_be_untilted else circular_interval(draws)
        return intercept_interval(draws) if name in _INTERCEPTS else interval(draws)

    @property
    def _may_be_untilted(self) -> bool:
        """Whether one of the modes holds the untilted plane; both together would hold what lies between them."""
        lit = self.quantities["c"] * self.quantities["normal_z"] > 0
        modes = [self.samples[lit == mode.lit_side, 1:] for mode in self.modes]
        return any(may_be_untilted(slopes) for slopes in modes if len(slopes) > _FEW_DRAWS)

    @property
    def cone(self) -> Cone:
        """Mean direction of the normal, camera frame, and the angles about it that hold 68 and 95 %."""
        return cone(self.normals)

    @property
    def normals(self) -> Array:
        """Unit normals (S, 3), camera frame."""
        return np.stack([self.quantities[f"normal_{axis}"] for axis in "xyz"], axis=1)

    @property
    def covariance(self) -> Array:
        """Of ``(z_L, p, q)``, (3, 3)."""
        return np.cov(self.samples, rowvar=False)

    @property
    def split(self) -> dict[str, Split]:
        """Standard deviations that the spot and the calibration contribute, of ``z_L, p, q`` and ``normal`` (rad).

        From the draws: how much of the variance the drawn rigs explain.
        """
        parts = {name: variance_split(self.samples[:, i], self.rig_samples) for i, name in enumerate(("z_L", "p", "q"))}
        return parts | {"normal": variance_split(self.normals, self.rig_samples)}

    @property
    def prior_dominated(self) -> bool:
        """Whether the prior moves the answer by more than a stated share of its width."""
        return self.prior_effect.dominated

    @property
    def agrees(self) -> bool:
        """Whether the first-order law describes the posterior."""
        return self.agreement_with_laplace.agrees

    @property
    def agreement(self) -> str:
        """Whether the first-order law describes the posterior, in words."""
        return self.agreement_with_laplace.sentence
