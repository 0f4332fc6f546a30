"""Is the rig still as calibrated? New views of a board test all of it: lens, beam and scale.

Camera, beam, poses and the board's bow are adjusted to the views twice. With hardly any prior, for the noise of the
corners and for what is wrong by rule: neither then hangs on whether the rig is right. And with the calibration as
prior, where the observations are linearised and tested with its joint covariance (`planeopt.calibration.rig_evidence`).
Where that fails, the groups of parameters that explain it are let go, and measured from where that puts the rig. Four
tests at a family-wise level:

- the *shift*: a change of the calibrated parameters, the same in every view;
- the *rest*: of what the calibration held fixed, further distortion or a second focal length;
- the *spots*: what of their ellipses no change of the rig explains;
- shift and spots *pooled*.

How noisy a corner is, is told from the same views, whose residuals have many degrees of freedom. No record of the
calibration's own noise is needed, and so none is tested. The board may be bowed by `bow_mm`; its squares are taken as
stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from planeopt.board import Observations, View
from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.approach import approach
from planeopt.calibration.board_basis import LOOSE, Basis, basis_of, changes_worth_finding, hardly_known
from planeopt.calibration.board_causes import GROUPS, Moved, causes_of, groups_alone, instead_of, p_value_of, unit_of
from planeopt.calibration.board_verdict import (
    POWER,
    TEST_LEVEL,
    BoardChange,
    BoardCheck,
    BoardPart,
    BoardState,
    BoardTest,
    ViewTest,
    untested_in_words,
    verdict_in_words,
)
from planeopt.calibration.equations import AdjustmentError, Equations, Task, Weights, equations, free_values
from planeopt.calibration.model import Model
from planeopt.calibration.noise import ELLIPSE
from planeopt.calibration.per_view import PerView, eliminated, joined, task_of, weights_of
from planeopt.calibration.rig_evidence import Extra, RigEvidence, found_from
from planeopt.calibration.spot_evidence import spots_against, spots_together
from planeopt.calibration.state import State
from planeopt.errors import InputError
from planeopt.rig import Rig, RigCovariance

Array = NDArray[np.float64]

BOW_MM = 0.2
"""Standard deviation of how far a board's middle lies off its edges, unless given."""

_ROUNDS = 3
_STEPS = 10
_HALVINGS = 6
# No detector is as bad: beyond, the corners are not this board's, and a rig would pass for the noise.
_SCATTER_PX = 1.0
# Of chi-squared: what a further step may still gain.
_NEAR = 1e-4


def check_board(observations: Observations, rig: Rig, *, bow_mm: float = BOW_MM) -> BoardCheck:
    """Test a rig with new views of a board; one is enough to test something.

    Parameters
    ----------
    observations : Observations
    rig : Rig
        Without a covariance it claims to be exact.
    bow_mm : float
        Standard deviation of the depth of the board's middle behind its edges, along x and along y.

    Returns
    -------
    BoardCheck

    Raises
    ------
    InputError
        If the images are not of the camera's size, or the bow is not a positive number.
    """
    if observations.image_size != rig.camera.image_size:
        seen, has = ("{} x {}".format(*size) for size in (observations.image_size, rig.camera.image_size))
        raise InputError(f"the images are of {seen} px, but the rig's camera has {has} px")
    if not (np.isfinite(bow_mm) and bow_mm > 0):
        raise InputError(f"how far the board may be bowed must be a positive number of mm, not {bow_mm}")
    if not observations.views:
        return _untested("no view of the board was found")
    with_beam = rig.beam is not None and any(view.spot is not None for view in observations.views)
    model = Model(focal="separate", distortion="k3", warp=True, beam="free" if with_beam else "none")
    reach = changes_worth_finding(rig, model, bow_mm)
    fit, why = None, ""
    for loose in LOOSE:
        try:
            fit = adjust(observations, model, prior=hardly_known(rig, model, reach, loose), held=rig)
            break
        except (AdjustmentError, InputError) as reason:
            why = str(reason)
    if fit is None:
        return _untested(why)
    if fit.corner_sigma > _SCATTER_PX:
        return _untested(
            f"the corners scatter by {fit.corner_sigma:.2g} px about any board that the views allow: these are not "
            "views of this board, or it is not flat"
        )
    try:
        return _judged(fit, rig, basis_of(rig, model, reach, bow_mm))
    except (InputError, np.linalg.LinAlgError) as reason:
        return _untested(f"the views and the rig file do not go together: {reason}")


def _untested(reason: str) -> BoardCheck:
    return BoardCheck(BoardState.UNTESTED, f"UNTESTED: {BoardState.UNTESTED.value} ({reason.rstrip('.')})")


@dataclass(frozen=True, eq=False)
class _Linear:
    """The views linearised where they and the calibration put the rig: each view alone, by its corners and by all."""

    here: Equations
    moved: Array
    corners: PerView
    each: PerView


def _linear(task: Task, weights: Weights, start: State, basis: Basis, loose: Sequence[str]) -> _Linear:
    """Adjust with the calibration as prior, but for parameters that are known to have moved."""
    here = _towards(replace(task, prior=basis.prior(loose)), start, weights)
    selection, spots = task.model.selection, here.boundaries
    corner_weight = np.repeat(weights.corners, 2, axis=1)
    corners = eliminated(here.corners, corner_weight, selection)
    parts = [(here.corners, corner_weight)]
    each = corners if spots is None else joined([*parts, (spots.linear, weights.boundary)], selection)
    return _Linear(here, free_values(task.model, here.state) - basis.full, corners, each)


def _towards(task: Task, start: State, weights: Weights) -> Equations:
    """Go some steps down: a place to linearise at, for which any near the least cost will do."""
    here = equations(task, start, weights)
    for _ in range(_STEPS):
        shared, pose = here.total.step()
        for halved in range(_HALVINGS):
            part = 0.5**halved
            try:
                to = here.state.moved(task.model.selection @ (part * shared), part * pose[:, :3], part * pose[:, 3:])
                there = equations(task, to, weights)
            except InputError:
                continue
            if there.cost < here.cost:
                break
        else:
            return here
        near = here.cost - there.cost < _NEAR
        here = there
        if near:
            break
    return here


def _judged(fit: Adjustment, rig: Rig, basis: Basis) -> BoardCheck:
    """Test at the calibration's place; where it fails, find what moved and measure it there."""
    task = task_of(fit)
    weights = weights_of(fit, task.packed)
    # The boundaries' sigmas are taken as given: whether they are right is tested.
    weights = Weights(weights.corners, weights.boundary * fit.noise.spots**2)
    noise = fit.dof_corners
    linear = _linear(task, weights, approach(task, rig), basis, ())
    evidence, extra = _of(linear.each, linear.moved, basis)
    tests = _tests(evidence, extra, spots_together(task, weights, linear.here, basis), noise)
    views = tuple(
        _view(row, fit, linear, basis, spot)
        for row, spot in enumerate(spots_against(task, weights, linear.here, basis))
    )
    causes: tuple[Moved, ...] = ()
    if any(test.part is BoardPart.SHIFT and not test.ok for test in tests):
        shift = evidence
        linear, evidence, causes = _measured(task, weights, linear, basis, noise)
        # What no change explains is told from where the change that there is has been made.
        free, extra = _of(linear.each, linear.moved, basis)
        free = replace(free, sigma=basis.loosened([name for cause in causes for name in GROUPS[cause.group]]))
        tests = _tests(shift, extra, spots_together(task, weights, linear.here, basis), noise, beside=free)
    groups, changes = groups_alone(evidence, basis, noise), _changes(evidence, basis)
    state = BoardState.OK if all(test.ok for test in tests) else BoardState.DEGRADED
    result = BoardCheck(
        state,
        "",
        tests,
        causes,
        instead_of(evidence, causes, groups, noise),
        groups,
        changes,
        views,
        _updated(rig, evidence, basis),
        fit.corner_sigma,
        untested_in_words(changes, basis, fit),
        fit,
    )
    return replace(result, verdict=verdict_in_words(result, rig, basis.fixed))


def _measured(
    task: Task, weights: Weights, linear: _Linear, basis: Basis, noise: float
) -> tuple[_Linear, RigEvidence, tuple[Moved, ...]]:
    """Find what moved, and again from where that puts the rig, until it is the same."""
    evidence = _of(linear.each, linear.moved, basis)[0]
    causes = causes_of(evidence, basis, noise)
    for _ in range(_ROUNDS):
        loose = [name for cause in causes for name in GROUPS[cause.group]]
        linear = _linear(task, weights, linear.here.state, basis, loose)
        evidence = _of(linear.each, linear.moved, basis)[0]
        again = causes_of(evidence, basis, noise)
        same = {cause.group for cause in again} == {cause.group for cause in causes}
        causes = again
        if same:
            break
    return linear, evidence, causes


def _of(each: PerView, moved: Array, basis: Basis) -> tuple[RigEvidence, Extra]:
    """What views say of the rig as calibrated: their pull there is that where the views put it, and the way to it."""
    information = each.information.sum(axis=0)
    pull = information @ moved + each.pull.sum(axis=0)
    return basis.evidence(information, pull), basis.beyond(information, pull)


def _tests(
    evidence: RigEvidence,
    extra: Extra,
    spots: tuple[float, float],
    dof_noise: float,
    *,
    beside: RigEvidence | None = None,
) -> tuple[BoardTest, ...]:
    """Test the parts that there are; the rest beside what is free to have moved, where that is given."""
    moved, dof = evidence.test()
    rest, dof_rest = (evidence if beside is None else beside).beyond(extra) if len(extra.pull) else (0.0, 0)
    made = [
        (BoardPart.SHIFT, moved, float(dof), True),
        (BoardPart.REST, rest, float(dof_rest), True),
        (BoardPart.SPOTS, *spots, False),
    ]
    if spots[1] >= 1 and dof > 0:
        made.insert(0, (BoardPart.POOLED, moved + spots[0], dof + spots[1], True))
    return tuple(
        BoardTest(part, chi2, n, p_value_of(chi2, n, dof_noise) if scaled else float(scipy.stats.chi2.sf(chi2, n)))
        for part, chi2, n, scaled in made
        if n >= 1
    )


def _changes(evidence: RigEvidence, basis: Basis) -> tuple[BoardChange, ...]:
    sigma_before, sigma_after, expected = (
        np.sqrt(np.maximum(np.diagonal(matrix), 0.0)) for matrix in (basis.sigma, evidence.updated, evidence.expected)
    )
    sigmas = evidence.update / np.maximum(expected, np.finfo(np.float64).tiny)
    least = found_from(evidence, TEST_LEVEL, POWER)
    columns = (basis.before, sigma_before, basis.before + evidence.update, sigma_after, sigmas, least)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return tuple(BoardChange(name, unit_of(name), *row) for name, row in zip(basis.names, rows, strict=True))


def _updated(rig: Rig, evidence: RigEvidence, basis: Basis) -> Rig | None:
    """The rig after the update; None for one that claims to be exact, or where the update is none of a rig."""
    if rig.covariance is None:
        return None
    names = basis.names[:-2]
    values = dict(zip(names, (basis.before + evidence.update)[:-2].tolist(), strict=True))
    try:
        moved = rig.with_parameters(values)
    except InputError:
        return None
    return replace(moved, covariance=RigCovariance(names, evidence.updated[:-2, :-2]))


def _view(row: int, fit: Adjustment, linear: _Linear, basis: Basis, spot: float) -> ViewTest:
    view: View = fit.observations.views[row]
    used = fit.corner_used[row]
    corners = linear.corners
    alone = PerView(corners.information[row : row + 1], corners.pull[row : row + 1])
    chi2, dof = _of(alone, linear.moved, basis)[0].test()
    residual = fit.corner_residuals[row][used]
    has_spot = bool(np.isfinite(spot))
    return ViewTest(
        view.name,
        int(np.count_nonzero(used)),
        float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0,
        chi2 if dof else None,
        dof,
        p_value_of(chi2, dof, fit.dof_corners) if dof else None,
        float(spot) if has_spot else None,
        float(scipy.stats.chi2.sf(spot, ELLIPSE)) if has_spot else None,
    )
