"""Rendered sessions through the whole chain: a folder of images in, a rig out."""

import math
import tempfile
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planeopt.calibration.routine import calibrate
from planeopt.executors import ordered_map
from planeopt.simulation import (
    BeamProfile,
    BoardScene,
    BoardSurface,
    Noise,
    Optics,
    Sensor,
    Shooting,
    SimulatedSession,
    random_session,
)
from planeopt.simulation.board_files import write_session
from studies.calibration_fits import NAN, NO_ERRORS, Errors, errors_row

FIRST = 300
"""Seed of the first of these sessions, which are others than those of the point sets."""

_SIZES = {"full": (1024, 768), "quick": (640, 480)}
_VIEWS = {"full": 12, "quick": 6}


@dataclass(frozen=True, kw_only=True)
class ImageRow(Errors):
    """One session of images.

    Attributes
    ----------
    seed : int
    outcome : str
        The verdict; where there is no rig, the reason.
    views, used : int
        Images, and those with a board.
    spots : int
        Views whose spot was measured.
    corners : int
        Measured, of all views.
    share : float
        Of the corners that are printed and in the image.
    corner_px : float
        RMS error of a coordinate of a measured corner against the truth.
    corner_factor, spot_factor : float
        By how much the stated sigmas of corners and spots had to be raised or lowered.
    f_relative : float
        Standard deviation of f over f.
    blur_px : float
        Of the lens.
    """

    seed: int
    outcome: str
    views: int
    used: int
    spots: int
    corners: int
    share: float
    corner_px: float
    corner_factor: float
    spot_factor: float
    f_relative: float
    blur_px: float


@dataclass(frozen=True)
class _Job:
    seed: int
    mode: str


def run_images(count: int, mode: str, executor: Executor | None) -> list[ImageRow]:
    """Render so many sessions and calibrate from their folders."""
    return list(ordered_map(_calibrated, [_Job(FIRST + number, mode) for number in range(count)], executor))


def scene_of(session: SimulatedSession, seed: int) -> BoardScene:
    """Return a session's look: paper, light, lens and noise as they come, 8 bits or 12.

    The beam is sharp. Of a soft one the radius at half height is not that of the sharp disc which, blurred, looks like
    it, as the spot's measurement takes it: a beam whose edge is soft by 1 % of its radius has one 5e-5 larger there.
    """
    rng = np.random.default_rng((78, seed))
    white, over = rng.uniform(0.3, 0.5), rng.uniform(0.25, 0.42)
    return BoardScene(
        session.rig,
        session.board,
        surface=BoardSurface(
            white=white,
            black=rng.uniform(0.04, 0.12),
            margin_mm=0.6 * min(session.board.square_mm),
            gradient=tuple(rng.uniform(-0.2, 0.2, 2).tolist()),
        ),
        beam=BeamProfile(height=over),
        optics=Optics(blur_px=rng.uniform(0.65, 1.3), vignetting=rng.uniform(0, 0.2)),
        noise=Noise(full_well_electrons=rng.uniform(6000, 20000), read=rng.uniform(0.001, 0.004)),
        sensor=Sensor(bits=12 if seed % 4 == 3 else 8),
        warp=session.warp,
    )


def _calibrated(job: _Job) -> ImageRow:
    session = random_session(job.seed, image_size=_SIZES[job.mode], shooting=Shooting(_VIEWS[job.mode], spotless=0.1))
    scene = scene_of(session, job.seed)
    with tempfile.TemporaryDirectory() as name:
        result = calibrate(write_session(scene, session.poses, Path(name), seed=job.seed))
    found = result.adjustment
    seen, errors = [], []
    truth = {f"view_{index + 1:02d}.png": view for index, view in enumerate(session.views())}
    for view in result.observations.views:
        true, printed = truth[view.name].corners
        errors.append((view.corners - true[view.ids]).ravel())
        seen.append(int(np.count_nonzero(printed)))
    spots = sum(view.spot is not None for view in result.observations.views)
    corners = sum(len(view) for view in result.observations.views)
    return ImageRow(
        **vars(NO_ERRORS if found is None else errors_row(found, session)),
        seed=job.seed,
        outcome=result.verdict if found is not None else " ".join(result.message.split()),
        views=len(session.poses),
        used=len(result.observations.views),
        spots=spots,
        corners=corners,
        share=corners / max(sum(seen), 1),
        corner_px=math.sqrt(np.mean(np.concatenate(errors) ** 2)) if errors else NAN,
        corner_factor=NAN if found is None else found.noise.corners,
        spot_factor=NAN if found is None else found.noise.spots,
        f_relative=NAN if found is None else found.sigma("f") / found.value("f"),
        blur_px=scene.optics.blur_px,
    )
