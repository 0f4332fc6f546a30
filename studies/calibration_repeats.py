"""The same session measured again and again: do the parameters scatter as each calibration says?"""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from planeopt.calibration.adjustment import adjust
from planeopt.executors import ordered_map
from planeopt.simulation import random_session
from studies.calibration_fits import QUANTITIES, fit_default, joint_chi2, truth_of

FIRST = 500
"""Seed of the first of these sessions, which are others than those of the coverage."""

_BATCH = 25


@dataclass(frozen=True)
class DrawRow:
    """One calibration of a session with noise of its own; every value less its truth, and its standard deviation.

    Attributes
    ----------
    session, draw : int
    f, cx, cy, e_x, e_y, radius, direction_x, direction_y : float
        Errors: px, mm, 1.
    f_own, cx_own, cy_own, e_x_own, e_y_own, radius_own, direction_x_own, direction_y_own : float
        Standard deviations as reported.
    chi2 : float
        Squared error of all parameters over the joint covariance.
    dof : int
    """

    session: int
    draw: int
    f: float
    cx: float
    cy: float
    e_x: float
    e_y: float
    radius: float
    direction_x: float
    direction_y: float
    f_own: float
    cx_own: float
    cy_own: float
    e_x_own: float
    e_y_own: float
    radius_own: float
    direction_x_own: float
    direction_y_own: float
    chi2: float
    dof: int


@dataclass(frozen=True)
class _Job:
    session: int
    first: int
    end: int


def run_repeats(sessions: int, draws: int, executor: Executor | None) -> list[DrawRow]:
    """Calibrate so many sessions so many times each."""
    jobs = [
        _Job(FIRST + number, first, min(first + _BATCH, draws))
        for number in range(sessions)
        for first in range(0, draws, _BATCH)
    ]
    return [row for rows in ordered_map(_repeated, jobs, executor) for row in rows]


def _repeated(job: _Job) -> list[DrawRow]:
    session = random_session(job.session)
    truth = truth_of(session)
    # The descent is begun where another draw's ended: it ends in the same place, sooner.
    begun = fit_default(session.observations)
    rows = []
    for draw in range(job.first, job.end):
        observations = session.again(10_000 + draw).observations
        fit = adjust(observations, begun.model, prior=begun.prior, start=begun.state)
        errors = {name: fit.value(name) - truth[name] for name in QUANTITIES}
        own = {f"{name}_own": fit.sigma(name) for name in QUANTITIES}
        chi2, dof = joint_chi2(fit.rig, truth)
        rows.append(DrawRow(job.session, draw, **errors, **own, chi2=chi2, dof=dof))
    return rows


@dataclass(frozen=True)
class RepeatRow:
    """How much a parameter scatters, and what was reported of it.

    Attributes
    ----------
    session : str
        Number of the session; "all": pooled, each session's scatter over what it reports.
    quantity : str
    draws : int
    spread : float
        Standard deviation of the errors about their mean; pooled: over the reported.
    reported : float
        Root mean square of the reported standard deviations; pooled: 1.
    ratio : float
        Reported over spread.
    least, most : float
        That right code has, two-sided, family-wise.
    """

    session: str
    quantity: str
    draws: int
    spread: float
    reported: float
    ratio: float
    least: float
    most: float

    @property
    def within(self) -> bool:
        return self.least <= self.ratio <= self.most


ALL = "all"


def spreads(rows: list[DrawRow]) -> list[tuple[str, str, int, float, float]]:
    """Return session, quantity, draws, scatter and what was reported: each session's, and all pooled."""
    found = []
    names = sorted({row.session for row in rows})
    for quantity in QUANTITIES:
        pooled, freedom = 0.0, 0
        for session in names:
            own = [row for row in rows if row.session == session]
            errors = np.array([getattr(row, quantity) for row in own])
            reported = float(np.sqrt(np.mean([getattr(row, f"{quantity}_own") ** 2 for row in own])))
            spread = float(np.std(errors, ddof=1))
            found.append((str(session), quantity, len(own), spread, reported))
            pooled += (len(own) - 1) * (spread / reported) ** 2
            freedom += len(own) - 1
        found.append((ALL, quantity, freedom + 1, float(np.sqrt(pooled / freedom)), 1.0))
    return found
