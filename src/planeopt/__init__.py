"""Measure a plane with one camera and one cylindrical laser beam.

Names are imported on first use, so that ``planeopt --help`` starts without CasADi, SciPy or OpenCV.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planeopt.calibration.routine import Calibration, calibrate
    from planeopt.calibration.session import load_session
    from planeopt.comparison import Comparison, compare
    from planeopt.errors import InputError
    from planeopt.estimation import BatchSolution, Combined, combine, solve, solve_batch
    from planeopt.formulations import (
        AsPrinted,
        ClosedForm,
        Constrained,
        EitherSide,
        Elastic,
        LeastSquares,
        Penalty,
        Reprojection,
    )
    from planeopt.plane import Plane, SpotPose
    from planeopt.posterior import Posterior, Prior, sample_posterior
    from planeopt.rig import Beam, Camera, Rig, load_rig, save_rig
    from planeopt.solution import Solution, SolveError, Status
    from planeopt.solvers import Ipopt, Penalised, Sqp, Swift
    from planeopt.spot import Spot, SpotNotFound, find_spot, read_image, read_points, write_points

__version__ = "0.1.0"

__all__ = [
    "AsPrinted",
    "BatchSolution",
    "Beam",
    "Calibration",
    "Camera",
    "ClosedForm",
    "Combined",
    "Comparison",
    "Constrained",
    "EitherSide",
    "Elastic",
    "InputError",
    "Ipopt",
    "LeastSquares",
    "Penalised",
    "Penalty",
    "Plane",
    "Posterior",
    "Prior",
    "Reprojection",
    "Rig",
    "Solution",
    "SolveError",
    "Spot",
    "SpotNotFound",
    "SpotPose",
    "Sqp",
    "Status",
    "Swift",
    "__version__",
    "calibrate",
    "combine",
    "compare",
    "find_spot",
    "load_rig",
    "load_session",
    "read_image",
    "read_points",
    "sample_posterior",
    "save_rig",
    "solve",
    "solve_batch",
    "write_points",
]

_CONTENTS = {
    "planeopt.calibration.routine": ("Calibration", "calibrate"),
    "planeopt.calibration.session": ("load_session",),
    "planeopt.comparison": ("Comparison", "compare"),
    "planeopt.errors": ("InputError",),
    "planeopt.estimation": ("BatchSolution", "Combined", "combine", "solve", "solve_batch"),
    "planeopt.formulations": (
        "AsPrinted",
        "ClosedForm",
        "Constrained",
        "EitherSide",
        "Elastic",
        "LeastSquares",
        "Penalty",
        "Reprojection",
    ),
    "planeopt.plane": ("Plane", "SpotPose"),
    "planeopt.posterior": ("Posterior", "Prior", "sample_posterior"),
    "planeopt.rig": ("Beam", "Camera", "Rig", "load_rig", "save_rig"),
    "planeopt.solution": ("Solution", "SolveError", "Status"),
    "planeopt.solvers": ("Ipopt", "Penalised", "Sqp", "Swift"),
    "planeopt.spot": ("Spot", "SpotNotFound", "find_spot", "read_image", "read_points", "write_points"),
}
_HOMES = {name: home for home, names in _CONTENTS.items() for name in names}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'planeopt' has no attribute {name!r}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
