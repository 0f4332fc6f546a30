"""Conic fits that planeopt does not have: Kanatani's hyper-accurate one, and those of OpenCV."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.conic import conic_from_geometric, transform_conic

Array = NDArray[np.float64]
Fit = Callable[[Array], Array]
"""From sets of points (D, N, 2) to ``B`` of (16), (D, 5), in the unit of the points."""


def hyper(points: Array) -> Array:
    """Fit by the algebraic fit without bias to second order in the noise (Kanatani & Rangarajan 2011, "HyperLS").

    The least ``theta' M theta`` with ``theta' N theta = 1``, where N is theirs to second order in one over the number
    of points.

    Parameters
    ----------
    points : (D, N, 2) array
        Sets of points in any unit.

    Returns
    -------
    (D, 5) array
        ``B`` of (16).
    """
    centre = points.mean(axis=1)
    unit = np.sqrt(np.mean((points - centre[:, None]) ** 2, axis=(1, 2)))
    x, y = np.moveaxis((points - centre[:, None]) / unit[:, None, None], 2, 0)
    zero, one, n = np.zeros_like(x), np.ones_like(x), x.shape[1]
    xi = np.stack([x * x, x * y, y * y, x, y, one], axis=2)
    by_x = np.stack([2 * x, y, zero, one, zero, zero], axis=2)
    by_y = np.stack([zero, x, 2 * y, zero, one, zero], axis=2)
    M = _moment(xi, xi) / n
    values, vectors = np.linalg.eigh(M)
    # The pseudo-inverse of rank 5: without the direction of the conic itself.
    root = vectors[:, :, 1:] / np.sqrt(values[:, None, 1:])
    w, w_x, w_y = xi @ root, by_x @ root, by_y @ root
    own, trace = np.sum(w * w, axis=2), np.sum(w_x * w_x + w_y * w_y, axis=2)
    bend = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    mixed = _moment(by_x * np.sum(w_x * w, axis=2)[:, :, None], xi) + _moment(
        by_y * np.sum(w_y * w, axis=2)[:, :, None], xi
    )
    first = _moment(by_x, by_x) + _moment(by_y, by_y) + 2 * _symmetric(xi.sum(axis=1)[:, :, None] * bend)
    second = (
        _moment(xi * trace[:, :, None], xi)
        + _moment(by_x * own[:, :, None], by_x)
        + _moment(by_y * own[:, :, None], by_y)
        + 2 * _symmetric(mixed)
    )
    N = first / n - second / n**2
    whitened = vectors / np.sqrt(values[:, None, :])
    ratios, directions = np.linalg.eigh(np.swapaxes(whitened, 1, 2) @ N @ whitened)
    best = np.argmax(np.abs(ratios), axis=1)
    theta = (whitened @ directions[np.arange(len(best)), :, best][:, :, None])[:, :, 0]
    B = transform_conic(theta[:, 1:] / theta[:, :1], unit[:, None, None] * np.eye(2), centre)
    return np.asarray(B, dtype=np.float64)


def _moment(a: Array, b: Array) -> Array:
    return np.swapaxes(a, 1, 2) @ b


def _symmetric(a: Array) -> Array:
    return (a + np.swapaxes(a, 1, 2)) / 2


def opencv(fit: Callable[[Any], Any]) -> Fit:
    """Return a function from sets of points in pixels, (D, N, 2), to ``B`` (D, 5), by one of OpenCV's fits."""

    def fitted(points: Array) -> Array:
        boxes = [fit(each) for each in points.astype(np.float32)]
        # Centre, diameters, and the first one's direction in degrees.
        numbers = np.array([[*centre, *size, turn] for centre, size, turn in boxes])
        found = np.asarray(np.isfinite(numbers).all(axis=1) & (numbers[:, 2:4] > 0).all(axis=1))
        x, y, width, height, turn = np.where(found, numbers.T, 1.0)
        B = conic_from_geometric(np.stack([x, y], axis=1), np.stack([width, height], axis=1) / 2, np.radians(turn))
        return np.asarray(np.where(found[:, None], B, np.nan), dtype=np.float64)

    return fitted


ellipse = opencv(cv2.fitEllipse)
ellipse_ams = opencv(cv2.fitEllipseAMS)
ellipse_direct = opencv(cv2.fitEllipseDirect)
