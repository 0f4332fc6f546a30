"""The posterior as it stands in a pose record, under the key `posterior`: plain JSON values, every key always there.

mm and degrees, as the names say; null stands for what has no value: `beta_deg` where the plane may well be untilted, an
intercept whose 95 % interval passes through infinity.
"""

import math
from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from planeopt.posterior.diagnostics import Diagnostics
from planeopt.posterior.result import Mode, Posterior
from planeopt.posterior.summary import Interval, Split
from planeopt.record import Triple, finite, triple


class IntervalRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Median, and equal-tailed intervals of 68 and 95 %; an angle's low end is the larger number across 180 deg."""

    median: float
    low68: float
    high68: float
    low95: float
    high95: float


class ConeRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Mean direction of the normal, camera frame, and the angles about it that hold 68 and 95 %, deg."""

    axis: Triple
    radius68: float
    radius95: float


class SplitRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Standard deviations from the spot and from the calibration; `calibration_share` of the variance."""

    spot: float
    calibration: float
    calibration_share: float


class SplitsRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of each quantity; `normal_deg` is the RMS angle of the normal."""

    z_L_mm: SplitRecord
    p: SplitRecord
    q: SplitRecord
    normal_deg: SplitRecord


class LaplaceRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The first-order normal law of (z_L_mm, p, q), and whether the samples agree with it."""

    plane: Triple | None
    matrix: tuple[Triple, Triple, Triple] | None
    agrees: bool
    sentence: str


class PriorRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The prior in words, and whether the answer is its own rather than the points'."""

    sentence: str
    dominated: bool
    effect: str


class DiagnosticsRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the chain went."""

    stopped: Literal["converged", "budget", "interrupted"]
    sentence: str
    walkers: int
    steps: int
    burn_in: int
    thin: int
    autocorrelation_time: float
    effective_draws: float
    r_hat: float | None
    acceptance: float


class ModeRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A place where the posterior is concentrated: its share with standard error, and (z_L_mm, p, q) there."""

    weight: float
    error: float
    plane: Triple
    lit_side: bool


class PosteriorRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The key `posterior` of a pose record.

    `noise` says what was known of the points' sigma; `robust` holds the degrees of freedom of Student's t, or null for
    normal noise. `rig_parameters` names what of the rig was sampled with the plane; empty where it was taken as it is.
    """

    z_L_mm: IntervalRecord
    p: IntervalRecord
    q: IntervalRecord
    alpha_deg: IntervalRecord
    beta_deg: IntervalRecord | None
    R_mm: IntervalRecord
    normal_x: IntervalRecord
    normal_y: IntervalRecord
    normal_z: IntervalRecord
    a_mm: IntervalRecord | None
    b_mm: IntervalRecord | None
    c_mm: IntervalRecord | None
    normal_deg: ConeRecord
    covariance: tuple[Triple, Triple, Triple]
    split: SplitsRecord
    laplace: LaplaceRecord
    prior: PriorRecord
    noise: str
    robust: float | None
    rig_parameters: tuple[str, ...]
    modes: tuple[ModeRecord, ...]
    diagnostics: DiagnosticsRecord
    n_samples: int


def posterior_record(posterior: Posterior) -> PosteriorRecord:
    """Return the record of a posterior."""
    cone = posterior.cone
    laplace = posterior.laplace
    parts = posterior.split

    def needed(name: str, unit: Callable[[float], float] = float) -> IntervalRecord:
        found = posterior.summary(name)
        if found is None:
            raise ValueError(f"{name} has no interval")
        return _interval(found, unit)

    def maybe(name: str, unit: Callable[[float], float] = float) -> IntervalRecord | None:
        found = posterior.summary(name)
        return None if found is None else _interval(found, unit)

    return PosteriorRecord(
        z_L_mm=needed("z_L"),
        p=needed("p"),
        q=needed("q"),
        alpha_deg=needed("alpha", math.degrees),
        beta_deg=maybe("beta", math.degrees),
        R_mm=needed("R"),
        normal_x=needed("normal_x"),
        normal_y=needed("normal_y"),
        normal_z=needed("normal_z"),
        a_mm=maybe("a"),
        b_mm=maybe("b"),
        c_mm=maybe("c"),
        normal_deg=ConeRecord(
            axis=cone.axis, radius68=math.degrees(cone.radius68), radius95=math.degrees(cone.radius95)
        ),
        covariance=_matrix(posterior.covariance),
        split=SplitsRecord(
            z_L_mm=_split(parts["z_L"]),
            p=_split(parts["p"]),
            q=_split(parts["q"]),
            normal_deg=_split(parts["normal"], math.degrees),
        ),
        laplace=LaplaceRecord(
            plane=None if laplace is None else triple(laplace.plane),
            matrix=None if laplace is None else _matrix(laplace.covariance),
            agrees=posterior.agrees,
            sentence=posterior.agreement,
        ),
        prior=PriorRecord(
            sentence=posterior.prior_sentence,
            dominated=posterior.prior_dominated,
            effect=posterior.prior_effect.sentence,
        ),
        noise=posterior.scale.value,
        robust=posterior.robust,
        rig_parameters=posterior.rig_parameters,
        modes=tuple(_mode(mode) for mode in posterior.modes),
        diagnostics=_diagnostics(posterior.diagnostics),
        n_samples=len(posterior),
    )


def _interval(of: Interval, unit: Callable[[float], float]) -> IntervalRecord:
    return IntervalRecord(
        median=unit(of.median),
        low68=unit(of.low68),
        high68=unit(of.high68),
        low95=unit(of.low95),
        high95=unit(of.high95),
    )


def _split(of: Split, unit: Callable[[float], float] = float) -> SplitRecord:
    return SplitRecord(spot=unit(of.spot), calibration=unit(of.calibration), calibration_share=of.share)


def _mode(mode: Mode) -> ModeRecord:
    return ModeRecord(weight=mode.weight, error=mode.error, plane=triple(mode.plane), lit_side=mode.lit_side)


def _diagnostics(of: Diagnostics) -> DiagnosticsRecord:
    stopped: dict[str, Literal["converged", "budget", "interrupted"]] = {
        "CONVERGED": "converged",
        "BUDGET": "budget",
        "INTERRUPTED": "interrupted",
    }
    return DiagnosticsRecord(
        stopped=stopped[of.stopped.name],
        sentence=of.sentence,
        walkers=of.walkers,
        steps=of.steps,
        burn_in=of.burn_in,
        thin=of.thin,
        autocorrelation_time=of.tau,
        effective_draws=of.ess,
        r_hat=finite(of.r_hat),
        acceptance=of.acceptance,
    )


def _matrix(rows: NDArray[np.floating]) -> tuple[Triple, Triple, Triple]:
    first, second, third = (triple(row) for row in rows)
    return first, second, third
