"""Were all views taken by one camera? Views that would rather have another one, and a view that fits none."""

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.equations import AdjustmentError, Task, descend
from planeopt.calibration.model import FULL, Model
from planeopt.calibration.noise import REJECT
from planeopt.calibration.packed import Packed
from planeopt.calibration.per_view import PerView, eliminated, linearised, weights_of
from planeopt.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_log = logging.getLogger(__name__)

_CHANCE = 1e-6
_ROUNDS = 30
_SWAPS = 6
_LEAST = 2
"""Views of a group: a single view is one that does not fit, not a camera."""
_EXPLAINED = 0.1
"""Of the corners' sum of squares: what two cameras explain at least; else it is something else that differs."""
_WORSE = 2.0
"""Times the others' root mean square: what a view that does not fit has at least."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """Two groups of views that would have two cameras.

    Attributes
    ----------
    second : (V,) array of bool
        Which views belong to the smaller group.
    focal : (float, float)
        Focal length of the larger and of the smaller group, px.
    centre : ((float, float), (float, float))
        Their principal points, px.
    explained : float
        Share of the corners' sum of squares that two cameras explain and one does not.
    """

    second: Mask
    focal: tuple[float, float]
    centre: tuple[tuple[float, float], tuple[float, float]]
    explained: float


def mixture(adjustment: Adjustment) -> Mixture | None:
    """Return the two groups into which the views fall, if they do.

    What each view alone says about f, cx, cy and k1 (its pose unknown) is compared with what all say. The sum of these
    differences' chi-squared is the most that any split into groups could gain, so no search can find by chance what it
    does not allow. If it is beyond chance, the best split into two is looked for, each group is calibrated by itself,
    and each view goes to the camera that fits it better.
    """
    if not adjustment.model.camera or len(adjustment.observations.views) < 2 * _LEAST + 1:
        return None
    here = _camera_evidence(adjustment)
    alone = _solve(here.information, here.pull)
    disagreement = float(np.sum(alone * here.pull))
    dof = here.pull.size - here.pull.shape[1]
    # The noise was estimated from the residuals, which two cameras make large: a sum over its degrees of freedom.
    if disagreement < chi2.isf(_CHANCE, dof):
        return None
    found = _split(here, alone)
    # Something else may make views disagree, a little: then two cameras would hardly help.
    if found is None or found[0] < _EXPLAINED / 2 * _square_sum(adjustment):
        return None
    return _refined(adjustment, found[1])


def misfitting_views(adjustment: Adjustment) -> list[tuple[int, float]]:
    """Return views whose corners fit much worse than the others', with by how much: times the others' RMS."""
    views = adjustment.observations.views
    squares, counts = np.zeros(len(views)), np.zeros(len(views))
    rows = zip(views, adjustment.corner_residuals, adjustment.corner_used, strict=True)
    for row, (view, residual, used) in enumerate(rows):
        square = np.sum(residual**2, axis=1) / (view.sigma * adjustment.noise.corners) ** 2
        # What was left out counts here, up to what a corner just within the rule would: a view is not well fitted
        # because its worst corners are gone.
        squares[row] = float(np.sum(np.where(used, square, np.minimum(square, REJECT**2))))
        counts[row] = max(2 * len(view) - 6, 1)
    found = []
    for row in range(len(views)):
        others = np.arange(len(views)) != row
        if not np.any(others):
            break
        ratio = (squares[row] / counts[row]) / (squares[others].sum() / counts[others].sum())
        chance = float(fisher.sf(ratio, counts[row], counts[others].sum()))
        if chance * len(views) < _CHANCE and ratio > _WORSE**2:
            found.append((row, float(np.sqrt(ratio))))
    return sorted(found, key=lambda pair: -pair[1])


def _camera_evidence(adjustment: Adjustment) -> PerView:
    _, weights, here = linearised(adjustment)
    free = [("fx", "fy"), ("cx",), ("cy",), ("k1",)]
    if adjustment.model.distortion == "none":
        free = free[:3]
    selection = np.zeros((len(FULL), len(free)))
    for column, targets in enumerate(free):
        for target in targets:
            selection[FULL.index(target), column] = 1.0
    found = eliminated(here.corners, np.repeat(weights.corners, 2, axis=1), selection)
    # Columns of like size: px and 1 stand side by side.
    scale = 1 / np.sqrt(np.maximum(np.diagonal(found.information.sum(axis=0)), np.finfo(np.float64).tiny))
    return PerView(found.information * np.outer(scale, scale), found.pull * scale)


def _solve(information: Array, pull: Array) -> Array:
    """Return the least-squares solutions (V, n); what a view does not tell stays where all have it."""
    inverse = np.linalg.pinv(information, rcond=1e-9, hermitian=True)
    return (inverse @ pull[..., None])[..., 0]


def _square_sum(adjustment: Adjustment) -> float:
    """Return the corners' sum of squares over the noise that was found."""
    return adjustment.chi2_corners / adjustment.noise.corners**2


def _split(here: PerView, alone: Array) -> tuple[float, Mask] | None:
    """Return the best split found, after what it would take off the sum of squares, to first order.

    By Lloyd's method, from splits along each parameter and along all.
    """
    views = len(here.pull)
    deviation = np.sqrt(np.maximum(np.diagonal(here.information, axis1=1, axis2=2), np.finfo(np.float64).tiny))
    starts = [alone[:, column] > np.median(alone[:, column]) for column in range(alone.shape[1])]
    starts.append((alone * deviation).sum(axis=1) > np.median((alone * deviation).sum(axis=1)))
    best: tuple[float, Mask] | None = None
    for start in starts:
        second, gain = np.asarray(start, dtype=np.bool_), 0.0
        for _ in range(_ROUNDS):
            if not _LEAST <= np.count_nonzero(second) <= views - _LEAST:
                break
            groups = np.stack(
                [
                    _solve(here.information[rows].sum(axis=0)[None], here.pull[rows].sum(axis=0)[None])[0]
                    for rows in (~second, second)
                ]
            )
            # Of each view under each group's camera: x' H x - 2 b' x.
            costs = np.einsum("gi,vij,gj->vg", groups, here.information, groups) - 2 * here.pull @ groups.T
            again, gain = costs[:, 1] < costs[:, 0], -float(np.min(costs, axis=1).sum())
            if np.array_equal(again, second):
                break
            second = again
        if not _LEAST <= np.count_nonzero(second) <= views - _LEAST:
            continue
        if best is None or gain > best[0]:
            best = gain, second
    return best


def _refined(adjustment: Adjustment, second: Mask) -> Mixture | None:
    """Return the split after each group was calibrated by itself and each view went where it fits; None if it fails."""
    alike = replace(adjustment.model, beam="none", divergence=False)
    seen = replace(adjustment.observations, spot="none")
    packed = Packed.of(seen)
    everything = weights_of(adjustment, packed)
    poses = Task(packed, Model(camera=False, warp=False, beam="none"), with_spots=False)
    fits: list[Adjustment] = []
    misfits = np.zeros((2, len(packed)))
    for _ in range(_SWAPS):
        fits = []
        for group, rows in enumerate((~second, second)):
            views = tuple(view for view, taken in zip(seen.views, rows, strict=True) if taken)
            try:
                fit = adjust(replace(seen, views=views), alike)
                placed = descend(poses, replace(adjustment.state, values=fit.state.values), everything).here
            except (AdjustmentError, InputError) as error:
                _log.debug("a group of views gives no camera: %s", error)
                return None
            fits.append(fit)
            misfits[group] = np.sum(np.repeat(everything.corners, 2, axis=1) * placed.corners.residual**2, axis=1)
        again = misfits[1] < misfits[0]
        if not _LEAST <= np.count_nonzero(again) <= len(packed) - _LEAST:
            return None
        if np.array_equal(again, second):
            break
        second = again
    if np.count_nonzero(second) > len(packed) / 2:
        second, fits, misfits = ~second, fits[::-1], misfits[::-1]
    explained = 1 - float(np.min(misfits, axis=0).sum()) / _square_sum(adjustment)
    if explained < _EXPLAINED:
        return None
    larger, smaller = fits
    return Mixture(
        second,
        (larger.value("f"), smaller.value("f")),
        ((larger.value("cx"), larger.value("cy")), (smaller.value("cx"), smaller.value("cy"))),
        explained,
    )
