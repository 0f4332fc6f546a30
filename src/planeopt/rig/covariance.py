"""One joint covariance of camera and beam.

The beam's offset is as uncertain as the camera that saw it (their correlation can reach -0.999), so the two are never
described by independent covariances.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.errors import InputError

FloatArray = NDArray[np.float64]

CAMERA_PARAMETERS = ("f", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Parameters of the camera: px, and 1 for the distortion. `f` stands for fx and fy where these are one number."""

BEAM_PARAMETERS = ("e_x", "e_y", "radius", "direction_x", "direction_y")
"""Parameters of the beam: mm, and 1 for the direction, whose z is +sqrt(1 - x^2 - y^2)."""

PARAMETERS = CAMERA_PARAMETERS + BEAM_PARAMETERS
"""Every parameter that a calibration can leave free."""

# Of one sigma times the other: what a hand-rounded file may differ by across the diagonal.
_SYMMETRY_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class RigCovariance:
    """Joint covariance of the rig's free parameters.

    Parameters
    ----------
    parameters : tuple of str
        Names from `PARAMETERS`, in the order of the matrix.
    matrix : array_like, shape (n, n)
        Positive definite; units px, mm and 1, as the parameters have. It is kept exactly symmetric.

    Raises
    ------
    InputError
        If a name is unknown, stands twice or contradicts another, or the matrix is no covariance of these parameters.
    """

    parameters: tuple[str, ...]
    matrix: FloatArray

    def __post_init__(self) -> None:
        names = tuple(self.parameters)
        _check_names(names)
        matrix = _covariance(self.matrix, names)
        matrix.setflags(write=False)
        object.__setattr__(self, "parameters", names)
        object.__setattr__(self, "matrix", matrix)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RigCovariance):
            return NotImplemented
        return self.parameters == other.parameters and bool(np.array_equal(self.matrix, other.matrix))

    def __hash__(self) -> int:
        return hash((self.parameters, self.matrix.tobytes()))

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviation (n,) of each parameter, in its own unit."""
        return np.sqrt(np.diagonal(self.matrix))

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (n, n)."""
        return self.matrix / np.outer(self.sigmas, self.sigmas)


def _check_names(names: tuple[str, ...]) -> None:
    if not names:
        raise InputError("covariance.parameters is empty: name at least one parameter, or leave [covariance] out")
    for name in names:
        if name not in PARAMETERS:
            raise InputError(f"covariance.parameters: {name!r} is not a parameter; known are {', '.join(PARAMETERS)}")
        if names.count(name) > 1:
            raise InputError(f"covariance.parameters: {name!r} stands there more than once")
    if "f" in names and ("fx" in names or "fy" in names):
        raise InputError("covariance.parameters: 'f' is fx and fy in one; give either 'f' or 'fx' and 'fy'")


def _covariance(values: object, names: tuple[str, ...]) -> FloatArray:
    """Return the checked matrix, exactly symmetric."""
    try:
        matrix = np.array(values, dtype=np.float64)
    except ValueError as error:
        raise InputError("covariance.matrix must have rows of equal length, one number per parameter") from error
    n = len(names)
    if matrix.shape != (n, n):
        found = " x ".join(map(str, matrix.shape)) if matrix.size else "empty"
        raise InputError(f"covariance.matrix must be {n} x {n}, one row per parameter, not {found}")
    if not np.all(np.isfinite(matrix)):
        row, column = np.argwhere(~np.isfinite(matrix))[0].tolist()
        raise InputError(
            f"covariance.matrix must be finite, but ({names[row]}, {names[column]}) is {matrix[row, column]}"
        )
    variances = np.diagonal(matrix)
    if np.any(variances <= 0):
        row = int(np.argmax(variances <= 0))
        raise InputError(
            f"covariance.matrix must be positive definite, but the variance of {names[row]} is {variances[row]}"
        )
    sigmas = np.sqrt(variances)
    scale = np.outer(sigmas, sigmas)
    skew = np.abs(matrix - matrix.T) / scale
    if np.max(skew) > _SYMMETRY_TOLERANCE:
        row, column = np.unravel_index(int(np.argmax(skew)), skew.shape)
        raise InputError(
            f"covariance.matrix must be symmetric, but ({names[row]}, {names[column]}) is {matrix[row, column]} "
            f"and its mirror {matrix[column, row]}"
        )
    matrix = (matrix + matrix.T) / 2
    try:
        # Of the correlations, so that the answer does not depend on the units.
        np.linalg.cholesky(matrix / scale)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "covariance.matrix must be positive definite: some mix of its parameters has no variance"
        ) from error
    return matrix
