"""From images of a ChArUco board with the laser's spot on it to a rig with one joint covariance, or the reason why not.

The data goes one way: a session's images are measured (`detection`), all that was seen is adjusted jointly
(`adjustment`, on the ladder of distortions), the result is judged (`gates`, `held_out`, `pose_cost`, `next_view`) and
recorded (`record`). `calibrate` does all of it.
"""

from planeopt.calibration.adjustment import Adjustment, adjust, refit
from planeopt.calibration.board_check import check_board
from planeopt.calibration.detection import Detected, ImageStatus, detect, detect_image
from planeopt.calibration.equations import AdjustmentError, Prior
from planeopt.calibration.gate import Gate
from planeopt.calibration.ladder import Tested
from planeopt.calibration.model import Model
from planeopt.calibration.noise import Noise
from planeopt.calibration.recalibration import recalibrate
from planeopt.calibration.routine import Calibration, Options, calibrate
from planeopt.calibration.session import Session, load_session

__all__ = [
    "Adjustment",
    "AdjustmentError",
    "Calibration",
    "Detected",
    "Gate",
    "ImageStatus",
    "Model",
    "Noise",
    "Options",
    "Prior",
    "Session",
    "Tested",
    "adjust",
    "calibrate",
    "check_board",
    "detect",
    "detect_image",
    "load_session",
    "recalibrate",
    "refit",
]
