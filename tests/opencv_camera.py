"""The camera that OpenCV finds from a session's corners, all with equal weights and none left out: for tests only."""

import cv2
import numpy as np
from numpy.typing import NDArray

from planeopt.board import Observations


def opencv_camera(seen: Observations) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """fx, fy, cx, cy, k1, k2, p1, p2, k3 and their standard deviations; OpenCV takes corners in single precision."""
    board = np.column_stack([seen.board.corners, np.zeros(len(seen.board.corners))]).astype(np.float32)
    _, matrix, distortion, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
        [board[view.ids] for view in seen.views],
        [view.corners.astype(np.float32) for view in seen.views],
        seen.image_size,
        np.eye(3),
        np.zeros(5),
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-14),
    )
    values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(distortion)[:5]]
    return np.array(values), np.ravel(np.asarray(deviations, dtype=np.float64))[:9]
