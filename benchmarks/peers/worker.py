"""Run in a peer's own environment: fit what a file of points holds, and write what came out and how long it took.

`python worker.py PEER POINTS.npz ANSWERS.npz`. The points are pixels from the principal point, (M, N, 2). A fitter
answers with conics ``a x^2 + b x y + c y^2 + d x + e y + f = 0``, (M, 6). A tool that finds circles in space answers
with the two circles that an ellipse may show, (M, 2, 6): unit normals, and centres in units of the radius. NaN where it
gave nothing, and the reasons. This file knows nothing of planeopt.
"""

# The peers are installed in environments of their own, which the type checker does not see.
# pyright: reportMissingImports=false

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def skimage_direct(points: Array, _: float) -> Array:
    """scikit-image: Halir and Flusser's direct fit."""
    from skimage.measure import EllipseModel

    model = EllipseModel.from_estimate(points)
    if not model:
        raise ValueError(str(model))
    return conic_of(model.center, model.axis_lengths, model.theta)


def lsq_direct(points: Array, _: float) -> Array:
    """lsq-ellipse: Halir and Flusser's direct fit."""
    from ellipse import LsqEllipse

    return LsqEllipse().fit(points).coefficients


def conics_algebraic(points: Array, _: float) -> Array:
    """conics: the algebraic fit."""
    from conics.fitting import fit_dlt

    return coefficients(fit_dlt(points).homogeneous)


def conics_orthogonal(points: Array, _: float) -> Array:
    """conics: orthogonal distances, from the algebraic fit."""
    from conics import Ellipse
    from conics.fitting import fit_dlt

    return coefficients(Ellipse.from_conic(fit_dlt(points)).refine(points).to_conic().homogeneous)


def ellipsinator_direct(points: Array, _: float) -> Array:
    """ellipsinator: Halir and Flusser's direct fit."""
    from ellipsinator import fit_ellipse_halir

    return fit_ellipse_halir(*points.T)


def ellipsinator_guaranteed(points: Array, _: float) -> Array:
    """ellipsinator: Sampson distances, of Szpak, Chojnacki and van den Hengel."""
    from ellipsinator import fast_guaranteed_ellipse_estimate

    return fast_guaranteed_ellipse_estimate(*points.T)


def conics_circles(points: Array, focal_px: float) -> Array:
    """conics: the circles of an ellipse, its algebraic fit included."""
    from conics import estimate_pose
    from conics.fitting import fit_dlt

    cone = fit_dlt(points / focal_px).homogeneous
    # Two positive eigenvalues and a negative one are asked for.
    cone = cone * -np.sign(np.linalg.det(cone))
    _, _, normals, centres, _, _, _, valid = estimate_pose(cone, 1.0, 0.0)
    # The camera as seen from the circle: the other way round.
    return np.concatenate([normals[valid, :, 0], -centres[valid, :, 0]], axis=1)


def pye3d_circles(points: Array, focal_px: float) -> Array:
    """pye3d: the circles of an ellipse, with least squares for the ellipse, since it takes one."""
    from pye3d.geometry.primitives import Ellipse
    from pye3d.geometry.projections import unproject_ellipse

    centre, minor, major, angle = ellipse_of(points)
    circles = unproject_ellipse(Ellipse(centre, minor, major, angle), focal_px, 1.0)
    # The first two coordinates of its centres are not those of the circle; the ray through the image's would be near.
    return np.array([[*circle.normal, np.nan, np.nan, circle.center[2]] for circle in circles])


LONG = 5.0
"""Seconds after which nothing is repeated."""

PEERS: dict[str, Callable[[Array, float], Array]] = {
    peer.__name__: peer
    for peer in (
        skimage_direct,
        lsq_direct,
        conics_algebraic,
        conics_orthogonal,
        ellipsinator_direct,
        ellipsinator_guaranteed,
        conics_circles,
        pye3d_circles,
    )
}


def coefficients(matrix: Array) -> Array:
    """Coefficients (6,) of a conic's symmetric matrix."""
    (a, b, d), (_, c, e), (_, _, f) = matrix
    return np.array([a, 2 * b, c, 2 * d, 2 * e, f])


def conic_of(centre: Array, axes: Array, angle: float) -> Array:
    """Coefficients (6,) of an ellipse with semi-axes at an angle."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    form = turn @ np.diag(1 / np.square(axes)) @ turn.T
    towards = form @ centre
    return np.array([form[0, 0], 2 * form[0, 1], form[1, 1], *(-2 * towards), centre @ towards - 1])


def ellipse_of(points: Array) -> tuple[Array, float, float, float]:
    """Centre, semi-axes and the major one's angle, by algebraic least squares on centred and scaled points."""
    middle, size = points.mean(axis=0), points.std()
    x, y = ((points - middle) / size).T
    design = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    a, b, c, d, e, f = np.linalg.svd(design, full_matrices=False)[2][-1]
    form = np.array([[a, b / 2], [b / 2, c]])
    centre = -np.linalg.solve(form, [d, e]) / 2
    values, vectors = np.linalg.eigh(form / (centre @ form @ centre - f))
    major = vectors[:, 0]
    minor_axis, major_axis = 1 / np.sqrt(values[::-1])
    return centre * size + middle, minor_axis * size, major_axis * size, float(np.arctan2(major[1], major[0]))


def main(name: str, points_file: Path, answers_file: Path) -> None:
    """Fit each set of points; the time is the best of three rounds over all of them, of one where that is long."""
    peer = PEERS[name]
    with np.load(points_file) as data:
        sets, focal_px = data["points"], float(data["focal_px"])
    peer(sets[0], focal_px)
    answers, reasons, seconds = [], [], []
    while len(seconds) < 3 and sum(seconds) < LONG:
        answers, reasons = [], []
        begun = time.perf_counter()
        for points in sets:
            try:
                answers.append(np.asarray(peer(points, focal_px), dtype=float))
                reasons.append("")
            except (ArithmeticError, AssertionError, RuntimeError, ValueError) as reason:
                answers.append(None)
                reasons.append(f"{type(reason).__name__}: {reason}")
        seconds.append(time.perf_counter() - begun)
    shape = next((answer.shape for answer in answers if answer is not None), (6,))
    filled = [np.full(shape, np.nan) if answer is None or answer.shape != shape else answer for answer in answers]
    np.savez(answers_file, answers=np.array(filled), reasons=np.array(reasons), seconds=min(seconds) / len(sets))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
