"""One input, from the file to its record, its posterior and its figures."""

import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from planeopt.batch import UNFORESEEN, Measurement, Search, StrPath, measure, worker_lost
from planeopt.comparison import Comparison, compare_problem
from planeopt.errors import InputError
from planeopt.executors import WorkerLost, ordered_map
from planeopt.formulations import Problem
from planeopt.methods import METHODS
from planeopt.posterior import Posterior, Prior, sample_posterior
from planeopt.posterior.record import PosteriorRecord, posterior_record
from planeopt.report.content import Figure, Picture
from planeopt.report.corner_figure import corner_figure
from planeopt.report.plane_figure import plane_figure
from planeopt.report.pose_figures import overlay, residuals
from planeopt.report.pose_fit import pose_fit
from planeopt.report.record import FirstOrder, ReportRecord, answers, first_order, report_record
from planeopt.report.spot_judged import judge
from planeopt.report.spot_overlay import refusal_picture
from planeopt.report.style import drawable, picture
from planeopt.report.words import CAPTIONS
from planeopt.rig import Rig
from planeopt.solution import Solution
from planeopt.spot import Spot
from planeopt.spot.files import load_image

_log = logging.getLogger(__name__)

Made = TypeVar("Made")


@dataclass(frozen=True, kw_only=True)
class Options:
    """How inputs are examined.

    Attributes
    ----------
    seed : int
        Of the sampler, the same for each input: a record does not depend on its place among others.
    draws : int or None
        Effective draws of a posterior; None: no posterior.
    robust : float or None
        Degrees of freedom of Student's t for the points; None: Gaussian.
    condition_on_rig : bool
        Take the rig's numbers as exact.
    both_sides : bool
        The plane may be seen from behind, on a translucent screen.
    prior : Prior
    search : Search
        How to look for a spot.
    """

    seed: int = 0
    draws: int | None = 2000
    robust: float | None = None
    condition_on_rig: bool = False
    both_sides: bool = False
    prior: Prior = field(default_factory=Prior)
    search: Search = field(default_factory=Search)


@dataclass(frozen=True, eq=False)
class Examined:
    """One input.

    Attributes
    ----------
    record : ReportRecord
    solution : Solution or None
    figures : tuple of Figure
        Those that could be drawn, in their order.
    """

    record: ReportRecord
    solution: Solution | None
    figures: tuple[Figure, ...]

    @property
    def input(self) -> str:
        return self.record.input

    @property
    def status(self) -> str:
        return self.record.status

    @property
    def message(self) -> str:
        return self.record.message

    @property
    def has_pose(self) -> bool:
        return self.record.z_L_mm is not None


def examine_many(
    paths: Iterable[StrPath], rig: Rig, options: Options | None = None, *, executor: Executor | None = None
) -> Iterator[Examined]:
    """Examine files, in their order, as they become ready.

    Parameters
    ----------
    paths : iterable of path-like
        Images, or `.csv` files of boundary points.
    rig : Rig
        With a beam.
    options : Options, optional
    executor : Executor, optional
        Where the work is done; in this process unless given.
    """
    return ordered_map(partial(examine, rig=rig, options=options or Options()), paths, executor, lost=_lost)


def _lost(path: StrPath, reason: WorkerLost) -> Examined:
    """Return what is known of a file over which workers died."""
    record = report_record(
        worker_lost(path, reason), first_order=FirstOrder(), posterior=None, missing=None, comparison=()
    )
    return Examined(record, None, ())


def examine(path: StrPath, rig: Rig, options: Options) -> Examined:
    """Examine one file; never raises for what is wrong with it."""
    measured = measure(path, rig, search=options.search)
    pixels = _pixels(path, measured)
    posterior, sampled, missing = _posterior(measured, rig, options)
    record = report_record(
        measured.record,
        first_order=FirstOrder() if measured.solution is None else first_order(measured.solution),
        posterior=sampled,
        missing=missing,
        comparison=() if measured.spot is None or measured.solution is None else _comparison(measured.spot, rig),
    )
    return Examined(record, measured.solution, tuple(_figures(measured, rig, options, pixels, posterior)))


def _pixels(path: StrPath, measured: Measurement) -> NDArray[Any] | None:
    if Path(path).suffix.lower() == ".csv" or measured.record.status == "error":
        return None
    try:
        return load_image(path).pixels
    except InputError:  # gone since it was measured
        return None


def _posterior(
    measured: Measurement, rig: Rig, options: Options
) -> tuple[Posterior | None, PosteriorRecord | None, str | None]:
    """Return the posterior of an input that has a pose, and its record, or why there is none."""
    if measured.spot is None or measured.solution is None or measured.solution.pose is None:
        return None, None, None
    if measured.solution.status.record == "refused":
        return None, None, None
    if options.draws is None:
        return None, None, "It was not asked for."
    try:
        posterior = sample_posterior(
            measured.spot,
            rig,
            seed=options.seed,
            prior=options.prior,
            robust=options.robust,
            condition_on_rig=options.condition_on_rig,
            both_sides=options.both_sides,
            draws=options.draws,
        )
        return posterior, posterior_record(posterior), None
    except InputError as error:
        return None, None, f"It could not be sampled: {error}."
    except UNFORESEEN as error:
        _log.debug("%s: no posterior", measured.record.input, exc_info=error)
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
        return None, None, f"Sampling broke down ({said})."


def _comparison(spot: Spot, rig: Rig) -> tuple[Any, ...]:
    try:
        # The pairs that suit each other; what building takes is no part of a report.
        return answers(Comparison((compare_problem(Problem.from_spot(spot, rig), METHODS, builds=False),)))
    except (InputError, *UNFORESEEN) as error:
        _log.debug("no comparison", exc_info=error)
        return ()


def _figures(
    measured: Measurement, rig: Rig, options: Options, pixels: NDArray[Any] | None, posterior: Posterior | None
) -> Iterator[Figure]:
    """Draw what there is to draw; what breaks down is left out, and the rest is drawn."""
    name = drawable(Path(measured.record.input).name)
    spot, solution = measured.spot, measured.solution
    if spot is None:
        if pixels is not None:
            yield from _drawn("refusal", "The image", lambda: _refusal(pixels, measured, name))
        return
    channel = options.search.channel or "gray" if rig.spot is None else rig.spot.channel
    pose = None if solution is None else solution.pose
    posed = None if pose is None else _tried("fit", lambda: pose_fit(spot, rig, pose))
    judged = _tried("ellipse", lambda: judge(spot, rig.camera)) if posed is None else posed.judged
    yield from _drawn(
        "overlay",
        "The boundary on the image",
        lambda: overlay(pixels, spot, judged, name, posed=posed is not None, channel=channel),
    )
    if posed is not None:
        yield from _drawn("residuals", "Residuals round the spot", lambda: residuals(spot, posed))
    if solution is not None:
        yield from _drawn("plane", "The plane in space", lambda: plane_figure(rig, solution))
    if posterior is not None and solution is not None:
        several = ", of the heavier plane" if len(posterior.modes) > 1 else ""
        yield from _drawn("corner", f"Posterior of depth and slopes{several}", lambda: _corner(posterior, rig))


def _corner(posterior: Posterior, rig: Rig) -> Picture:
    samples, laplace = posterior.samples, posterior.laplace
    if len(posterior.modes) > 1:
        # Both together would be two dots far apart.
        samples = samples[_lit_side(samples, rig) == posterior.modes[0].lit_side]
    if laplace is None or _lit_side(laplace.plane[None], rig)[0] != _lit_side(samples, rig)[0]:
        return corner_figure(samples, None, None)
    return corner_figure(samples, laplace.plane, laplace.covariance)


def _lit_side(planes: NDArray[np.float64], rig: Rig) -> NDArray[np.bool_]:
    """Whether the camera is on the laser's side of planes (S, 3) of (z_L along the beam, p, q)."""
    z_L, p, q = planes.T
    e_x, e_y = rig.laser_offset
    return np.asarray(z_L + rig.axial_shift - p * e_x - q * e_y > 0)


def _refusal(pixels: NDArray[Any], measured: Measurement, name: str) -> Picture:
    shown = refusal_picture(pixels, measured.record.message, name)
    return picture(shown, f"The image {name}, without a spot", photograph=True)


def _drawn(key: str, title: str, draw: Callable[[], Picture | None]) -> Iterator[Figure]:
    drawing = _tried(key, draw)
    if drawing is not None:
        yield Figure(key, title, CAPTIONS[key], drawing)


def _tried(what: str, make: Callable[[], Made | None]) -> Made | None:
    """Return what is made; None where that breaks down: the rest of the report does not depend on it."""
    try:
        return make()
    except (InputError, *UNFORESEEN) as error:
        _log.debug("%s cannot be drawn", what, exc_info=error)
        return None
