"""Simulated sessions: what a detector would have measured of a board in many poses, with the truth."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planeopt.board import Board, Observations, SpotOnBoard, View
from planeopt.rig import Rig
from planeopt.simulation.board_views import BoardPoses, BoardView
from planeopt.spot import Spot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SimulatedSession:
    """A session with its truth.

    Attributes
    ----------
    rig : Rig
        Without covariance.
    board : Board
        As it is; `observations.board` is as it was stated.
    poses : BoardPoses
    observations : Observations
    corner_sigma, spot_sigma : float
        Standard deviation of each corner's coordinates, and of boundary points across the boundary, px.
    warp : (float, float)
        mm, see `BoardView`.
    divergence : float
    spot_points : int
        Boundary points of each spot.
    """

    rig: Rig
    board: Board
    poses: BoardPoses
    observations: Observations
    corner_sigma: float
    spot_sigma: float
    warp: tuple[float, float] = (0.0, 0.0)
    divergence: float = 0.0
    spot_points: int = 100

    def again(self, seed: int) -> "SimulatedSession":
        """Return the same session with other noise."""
        observations = simulated_session(
            self.rig,
            self.board,
            self.poses,
            corner_sigma=self.corner_sigma,
            spot_sigma=self.spot_sigma,
            warp=self.warp,
            divergence=self.divergence,
            spot_points=self.spot_points,
            spot=self.observations.spot,
            seed=seed,
        )
        return replace(self, observations=replace(observations, board=self.observations.board))

    def views(self) -> list[BoardView]:
        """Return the true geometry of every view."""
        return board_views(self.rig, self.board, self.poses, self.warp, self.divergence)


def board_views(
    rig: Rig, board: Board, poses: BoardPoses, warp: tuple[float, float] = (0.0, 0.0), divergence: float = 0.0
) -> list[BoardView]:
    """Return the geometry of every pose of a board."""
    placed = zip(poses.rotations, poses.translations, strict=True)
    return [BoardView(rig, board, R, t, warp, divergence) for R, t in placed]


def simulated_session(
    rig: Rig,
    board: Board,
    poses: BoardPoses,
    *,
    corner_sigma: float = 0.1,
    spot_sigma: float = 0.1,
    warp: tuple[float, float] = (0.0, 0.0),
    divergence: float = 0.0,
    spot_points: int = 100,
    spot: SpotOnBoard = "disc",
    seed: int = 0,
) -> Observations:
    """Return what would be measured: corners in the image and spots in the window, with noise.

    The corners' noise is normal, independent and the same in x and y. Boundary points are spread evenly round the beam,
    from an angle of their own in each view; their noise is across the boundary, as an edge's is. A view's numbers
    depend on the seed and its place alone: more views leave the others as they are.

    Parameters
    ----------
    rig : Rig
        The true one.
    board : Board
    poses : BoardPoses
    corner_sigma, spot_sigma : float
        px; 0 for none. What is stated with the measurements is this, or 0.1 px where there is none.
    warp : (float, float)
        mm, see `BoardView`.
    divergence : float
        See `BoardView`.
    spot_points : int
        Of each spot.
    spot : {"disc", "ring", "none"}
    seed : int
    """
    views = []
    for index, view in enumerate(board_views(rig, board, poses, warp, divergence)):
        rng = np.random.default_rng((seed, index))
        name = f"view_{index + 1:04d}.png"
        corners, seen = view.corners
        ids = np.flatnonzero(seen)
        noisy = corners[ids] + corner_sigma * rng.standard_normal((len(ids), 2))
        measured = None
        if spot != "none" and view.spot_state() == "seen":
            theta = 2 * np.pi * (np.arange(spot_points) + rng.uniform()) / spot_points
            px, normals = view.outline(theta)
            px = px + spot_sigma * rng.standard_normal(spot_points)[:, None] * normals
            stated = np.full(spot_points, spot_sigma or _STATED)
            measured = Spot(px, stated, kind=spot, arc_fraction=1.0, source=name)
        views.append(View(name, ids, noisy, np.full(len(ids), corner_sigma or _STATED), measured))
    return Observations(board, rig.camera.image_size, tuple(views), spot, rig.camera.pixel_pitch_mm)


_STATED = 0.1
"""px, of measurements without noise, whose weights need some."""
