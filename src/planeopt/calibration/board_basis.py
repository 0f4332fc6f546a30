"""What of a rig new views of a board can find changed: which parameters, how large a change, how well known before."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planeopt.calibration.equations import Prior
from planeopt.calibration.model import Model
from planeopt.calibration.rig_evidence import Extra, RigEvidence
from planeopt.rig import BEAM_PARAMETERS, Rig, RigCovariance

Array = NDArray[np.float64]


def changes_worth_finding(rig: Rig, model: Model, bow_mm: float) -> dict[str, float]:
    """Return, for each parameter of a model (and for `f`), a change that is worth finding.

    A hundredth of the focal length or of the picture, for the lens at the picture's corner; a fifth of the radius for
    the offset, a twentieth for the radius, 10 mrad.
    """
    width, height = rig.camera.image_size
    f = rig.camera.fx
    corner = float(np.hypot(width, height)) / 2 / f
    lens = 0.01 * corner
    worth = {"f": 0.01 * f, "fx": 0.01 * f, "fy": 0.01 * f, "cx": 0.01 * width, "cy": 0.01 * width}
    worth |= {"k1": lens / corner**3, "k2": lens / corner**5, "k3": lens / corner**7}
    worth |= {"p1": lens / corner**2, "p2": lens / corner**2, "warp_x": 5 * bow_mm, "warp_y": 5 * bow_mm}
    if rig.beam is not None:
        r = rig.beam.radius
        worth |= {"e_x": 0.2 * r, "e_y": 0.2 * r, "radius": 0.05 * r, "direction_x": 0.01, "direction_y": 0.01}
    return {name: worth[name] for name in (*model.names, "f")}


LOOSE = (3.0, 1.0, 0.3)
"""Priors that decide nothing, in changes that are worth finding: a narrower one keeps a single view from nonsense."""


def hardly_known(rig: Rig, model: Model, reach: dict[str, float], loose: float) -> Prior:
    """Return a prior so wide that it decides nothing that the views can decide."""
    names = model.names
    own = {} if rig.covariance is None else dict(zip(rig.covariance.parameters, rig.covariance.sigmas, strict=True))
    own |= {name: own["f"] for name in ("fx", "fy") if "f" in own}
    values = np.array([0.0 if name.startswith("warp") else rig.parameter(name) for name in names])
    variances = np.array([(loose * reach[name]) ** 2 + own.get(name, 0.0) ** 2 for name in names])
    return Prior(names, values, np.diag(1 / variances))


@dataclass(frozen=True, eq=False)
class Basis:
    """The parameters that may have changed, and those that the calibration lacks, as mixtures of a model's.

    Attributes
    ----------
    model : Model
        With g free parameters.
    names : tuple of str
        Of n parameters: the calibration's, and the board's bow.
    fixed : tuple of str
        Of what the calibration held fixed.
    free, extra : (g, n), (g, m)
        Mixtures: d model's parameter / d parameter.
    before : (n,)
        Values before.
    full : (g,)
        Values before of the model's parameters.
    sigma : (n, n)
        Covariance before.
    reach, fixed_reach : (n,), (m,)
        Changes that are worth finding.
    """

    model: Model
    names: tuple[str, ...]
    fixed: tuple[str, ...]
    free: Array
    extra: Array
    before: Array
    full: Array
    sigma: Array
    reach: Array
    fixed_reach: Array

    def evidence(self, information: Array, pull: Array) -> RigEvidence:
        """Return what a model's information (g, g) and pull (g,) say of the parameters."""
        return RigEvidence(self.free.T @ information @ self.free, self.free.T @ pull, self.sigma, self.reach)

    def loosened(self, loose: Sequence[str]) -> Array:
        """Return the covariance (n, n) before, where next to nothing is known of the parameters named."""
        wide = [name in loose for name in self.names]
        return self.sigma + np.diag(np.where(wide, (LOOSE[0] * self.reach) ** 2, 0.0))

    def prior(self, loose: Sequence[str] = ()) -> Prior:
        """Return what is known of the model's parameters; of those named `loose` next to nothing."""
        known = self.loosened(loose)
        held = (_HELD * self.fixed_reach) ** 2
        square = np.column_stack([self.free, self.extra])
        back = np.linalg.inv(square)
        count = len(self.names)
        information = back[:count].T @ np.linalg.solve(known, back[:count]) + back[count:].T @ (
            back[count:] / held[:, None]
        )
        return Prior(self.model.names, self.full, information)

    def beyond(self, information: Array, pull: Array) -> Extra:
        """Return what they say of those that the calibration held fixed."""
        across = self.extra.T @ information
        return Extra(across @ self.extra, across @ self.free, self.extra.T @ pull)


def basis_of(rig: Rig, model: Model, reach: dict[str, float], bow_mm: float) -> Basis:
    """Return the parameters of a rig as calibrated and of a board that may be bowed.

    Parameters
    ----------
    rig : Rig
    model : Model
        With all of a rig that the views show free.
    reach : dict
        From `changes_worth_finding`.
    bow_mm : float
        Standard deviation of the board's bow.
    """
    calibrated = _calibrated(rig, model, reach)
    names = (*calibrated.parameters, "warp_x", "warp_y")
    sigma = np.zeros((len(names), len(names)))
    sigma[:-2, :-2] = calibrated.matrix
    sigma[-2:, -2:] = bow_mm**2 * np.eye(2)
    free = np.zeros((len(model.names), len(names)))
    for column, name in enumerate(names):
        for target in ("fx", "fy") if name == "f" else (name,):
            free[model.names.index(target), column] = 1.0
    # A second focal length is a change of fy alone: that of both is free already.
    fixed = [name for name in model.names if name not in names and not (name == "fx" and "f" in names)]
    extra = np.zeros((len(model.names), len(fixed)))
    for column, name in enumerate(fixed):
        extra[model.names.index(name), column] = 1.0
    before = np.array([*(rig.parameter(name) for name in calibrated.parameters), 0.0, 0.0])
    full = np.array([0.0 if name.startswith("warp") else rig.parameter(name) for name in model.names])
    return Basis(
        model,
        names,
        tuple(fixed),
        free,
        extra,
        before,
        full,
        sigma,
        np.array([reach[name] for name in names]),
        np.array([reach[name] for name in fixed]),
    )


_HELD = 1e-4
"""Of a change that is worth finding: how firmly the adjustment holds what the calibration held fixed."""

_EXACT = 1e-6
"""Of a change that is worth finding: the standard deviation of a rig that claims to be exact."""


def _calibrated(rig: Rig, model: Model, reach: dict[str, float]) -> RigCovariance:
    """The rig's covariance over what these views see; of a rig without one, of everything, and next to nothing."""
    has_beam = model.beam != "none"
    if rig.covariance is None:
        focal = ("f",) if rig.camera.fx == rig.camera.fy else ("fx", "fy")
        names = (*focal, "cx", "cy", "k1", "k2", "p1", "p2", *(BEAM_PARAMETERS if has_beam else ()))
        return RigCovariance(names, np.diag([(_EXACT * reach[name]) ** 2 for name in names]))
    rows = [row for row, name in enumerate(rig.covariance.parameters) if has_beam or name not in BEAM_PARAMETERS]
    names = tuple(rig.covariance.parameters[row] for row in rows)
    return RigCovariance(names, rig.covariance.matrix[np.ix_(rows, rows)])
