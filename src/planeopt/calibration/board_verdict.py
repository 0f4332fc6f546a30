"""What new views of a board say of a rig: the tests' parts, the verdict, and both in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from planeopt.calibration.adjustment import Adjustment
from planeopt.calibration.board_basis import Basis
from planeopt.calibration.board_causes import GROUPS, Moved
from planeopt.estimation.misfits import LEVEL
from planeopt.rig import Rig

UNTESTED = (
    "The board's squares are taken as stated: a board that is larger than that by a share looks like a focal length as "
    "it was and a beam larger by that share. The noise of the corners is told from these views, not compared with the "
    "calibration's."
)
"""What no views of one board can test."""


class BoardState(Enum):
    """What the views say of the rig; the value is the sentence a user reads."""

    OK = "The views of the board agree with the rig, as far as they can test it."
    DEGRADED = "The rig is not as calibrated."
    UNTESTED = "No view of the board could be used to test the rig."


class BoardPart(Enum):
    """What is tested; the value says what it means where it fails."""

    POOLED = "The views together contradict the rig."
    SHIFT = "The rig's parameters are not those of the file."
    REST = "The rig differs from its file in what the calibration held fixed."
    SPOTS = "The spots' boundaries have misfits that no change of the rig explains: the points, or their sigma."


TEST_LEVEL = LEVEL / len(BoardPart)
"""Of each part: together they are wrong no more often than `LEVEL`."""

POWER = 0.9
"""Probability with which the changes are found that are said to be found."""


@dataclass(frozen=True)
class BoardTest:
    """One part of the evidence; ``p_value`` is how often a right rig does worse."""

    part: BoardPart
    chi2: float
    dof: float
    p_value: float

    @property
    def ok(self) -> bool:
        return self.p_value >= TEST_LEVEL


@dataclass(frozen=True)
class BoardChange:
    """One parameter: the file's, updated by the views with the calibration as prior, and what would be found.

    Attributes
    ----------
    name, unit : str
    before, sigma_before : float
        The file's.
    after, sigma_after : float
        The update.
    sigmas : float
        The change in standard deviations of the change that a rig as calibrated would give.
    found_from : float
        Change of this parameter alone that is found with probability `POWER`; infinite where none is.
    """

    name: str
    unit: str
    before: float
    sigma_before: float
    after: float
    sigma_after: float
    sigmas: float
    found_from: float


@dataclass(frozen=True)
class ViewTest:
    """One view against the rig with its covariance; None where the view has no spot, or cannot test."""

    name: str
    corners: int
    rms_px: float
    chi2: float | None
    dof: int
    p_value: float | None
    spot_chi2: float | None
    spot_p_value: float | None


@dataclass(frozen=True, eq=False)
class BoardCheck:
    """A rig against new views of a board.

    Attributes
    ----------
    state : BoardState
    verdict : str
        ``OK``, ``DEGRADED`` or ``UNTESTED``, and why.
    tests : tuple of BoardTest
        Those that the views allow.
    causes : tuple of Moved
        Where the shift fails: the fewest groups whose change explains it, each with what it adds to the others.
    instead : tuple of str
        Groups of which a change explains it as well as that of the one cause that is named.
    groups : tuple of Moved
        Each as if it alone had moved.
    changes : tuple of BoardChange
    views : tuple of ViewTest
    updated : Rig or None
        The rig updated by the views, the calibration being the prior; to first order.
    corner_sigma : float or None
        Noise of a coordinate of a corner, px, as the views show it.
    untested : str
        What could not be tested.
    adjustment : Adjustment or None
    """

    state: BoardState
    verdict: str
    tests: tuple[BoardTest, ...] = ()
    causes: tuple[Moved, ...] = ()
    instead: tuple[str, ...] = ()
    groups: tuple[Moved, ...] = ()
    changes: tuple[BoardChange, ...] = ()
    views: tuple[ViewTest, ...] = ()
    updated: Rig | None = None
    corner_sigma: float | None = None
    untested: str = UNTESTED
    adjustment: Adjustment | None = None

    @property
    def ok(self) -> bool:
        return self.state is BoardState.OK


_UNDERFLOW = 1e-300


def untested_in_words(changes: Sequence[BoardChange], basis: Basis, fit: Adjustment) -> str:
    """What these views could not test, and what none of one board can."""
    reach = dict(zip(basis.names, basis.reach.tolist(), strict=True))
    words = []
    blind = [
        group
        for group, members in GROUPS.items()
        if group != "the board's bow"
        and any(change.name in members for change in changes)
        and all(change.found_from > reach[change.name] for change in changes if change.name in members)
    ]
    if blind:
        words.append(f"Not tested by these views, but for gross changes: {', '.join(blind)}.")
    if not fit.spot_used.any():
        words.append("Not tested, since no view has a spot: the beam.")
    return " ".join([*words, UNTESTED])


def verdict_in_words(result: BoardCheck, rig: Rig, fixed: Sequence[str]) -> str:
    """The verdict, what fails, what explains it; `fixed` are the parameters that the calibration held fixed."""
    words = [f"{result.state.name}: {result.state.value}"]
    words += [f"{test.part.value.removesuffix('.')} ({_numbers(test)})." for test in result.tests if not test.ok]
    if any(test.part is BoardPart.REST and not test.ok for test in result.tests):
        words.append(f"Held fixed were {', '.join(fixed)}.")
    if result.causes:
        words.append(f"What explains it: {'; '.join(map(_cause, result.causes))}.")
    if result.instead:
        words.append(f"As well could it be {' or '.join(result.instead)}.")
    if result.ok:
        words.append(" ".join(f"{test.part.name.capitalize()}: {_numbers(test)}." for test in result.tests[:1]))
    fit = result.adjustment
    lost = [] if fit is None else _spots_left_out(fit)
    if lost:
        words.append(f"Left out, since no rig explains it beside the others: the spot of {', '.join(lost)}.")
    if not result.ok and rig.covariance is None:
        words.append("The rig file has no covariance: an error that the calibration itself left counts as a change.")
    return " ".join(words)


def _spots_left_out(fit: Adjustment) -> list[str]:
    seen = zip(fit.observations.views, fit.spot_used, strict=True)
    return [view.name for view, used in seen if view.spot is not None and not used]


def _numbers(test: BoardTest) -> str:
    p_value = f"p = {test.p_value:.2g}" if test.p_value > _UNDERFLOW else f"p < {_UNDERFLOW}"
    return f"chi-squared {test.chi2:.4g} with {test.dof:.3g} degrees of freedom, {p_value}"


def _cause(moved: Moved) -> str:
    listed = ", ".join(
        f"{name} by {value:+.3g} +- {sigma:.2g}{'' if unit == '1' else ' ' + unit}"
        for name, unit, value, sigma in moved.changes
    )
    return f"{moved.group} ({listed}; {np.sqrt(moved.chi2):.1f} sigma)"
