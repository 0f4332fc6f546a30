"""What all inputs say together, in numbers: tests of the rig, outliers, and one plane out of many frames."""

from collections import Counter
from collections.abc import Sequence

from planeopt.check import ChangeRecord
from planeopt.estimation.combine import Combined, combine
from planeopt.estimation.drift import Drift, drift
from planeopt.estimation.sequence import Positions, Sequenced, trends
from planeopt.record import SigmaRecord, Slopes, degrees, finite, triple
from planeopt.report.examine import Examined
from planeopt.report.record import (
    CombinedRecord,
    DriftRecord,
    PartRecord,
    SequenceRecord,
    Summary,
    TrendRecord,
    shares,
)
from planeopt.rig import Rig
from planeopt.solution import Solution, Status


def summarise(
    examined: Sequence[Examined], rig: Rig, *, combined: bool = False, positions: Positions | None = None
) -> Summary:
    """Test the rig with all inputs, combine them, and follow the plane along them, where that is asked for.

    Parameters
    ----------
    examined : sequence of Examined
    rig : Rig
    combined : bool
        All show one plane: combine them.
    positions : Positions, optional
        They are a sequence, one position for each.
    """
    solutions = [one.solution or _without(one) for one in examined]
    moved = drift(solutions, rig, positions=None if positions is None else positions.values)
    usable = any(solution.uncertainty is not None and solution.status.record != "refused" for solution in solutions)
    return Summary(
        counts=dict(sorted(Counter(one.status for one in examined).items())),
        outliers=moved.worst,
        drift=_drift(moved),
        combined=_combined(combine(solutions, rig)) if combined and usable else None,
        sequence=None if positions is None else _sequence(trends(solutions, rig, positions), positions),
    )


def _without(one: Examined) -> Solution:
    """Stand in for an input without a solution, so that images keep their numbers."""
    return Solution(Status.NO_PLANE, one.message, "", "")


def _drift(found: Drift) -> DriftRecord:
    return DriftRecord(
        state=found.state.name.lower(),
        verdict=found.verdict,
        blind=found.blind,
        tests=tuple(
            PartRecord(part=test.part.name.lower(), chi2=test.chi2, dof=test.dof, p_value=test.p_value)
            for test in found.tests
        ),
        shift=tuple(map(ChangeRecord.of, found.shift)),
        trend=tuple(map(ChangeRecord.of, found.trend)),
    )


def _combined(found: Combined) -> CombinedRecord:
    pose, sigma = found.pose, found.sigma
    p, q = pose.slopes
    return CombinedRecord(
        message=found.message,
        agreement=found.agreement.name.lower(),
        ok=found.ok,
        n_frames=found.n_frames,
        z_L_mm=finite(pose.z_L),
        alpha_deg=degrees(pose.alpha),
        beta_deg=degrees(pose.beta),
        R_mm=finite(pose.R),
        slopes=Slopes(p=finite(p), q=finite(q)),
        normal=triple(found.plane.normal),
        point_mm=triple(found.plane.point),
        sigma=SigmaRecord(
            z_L_mm=finite(sigma.z_L),
            alpha_deg=degrees(sigma.alpha),
            beta_deg=degrees(sigma.beta),
            normal_deg=degrees(sigma.normal),
        ),
        first_order=shares(pose, sigma, found.sigma_spot, found.covariance, found.uncertainty.spot),
        chi2=finite(found.chi2),
        dof=found.dof,
        p_value=finite(found.p_value),
        outliers=found.outliers,
    )


def _sequence(found: Sequenced, positions: Positions) -> SequenceRecord:
    return SequenceRecord(
        label=found.label,
        unit=found.unit,
        positions=positions.values,
        message=found.message,
        trends=tuple(
            TrendRecord(
                name=trend.name,
                unit=trend.unit,
                slope=trend.slope,
                slope_sigma=trend.slope_sigma,
                slope_sigma_calibration=trend.slope_sigma_rig,
                p_value=trend.p_value,
                changes=trend.changes,
                message=trend.message,
            )
            for trend in found.trends
        ),
    )
