"""The chart of a design: sigma over distance for some tilts, and over factors on what is built."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from planeopt.design.levers import RIG_LEVERS, with_factors
from planeopt.design.prediction import Prediction, plane_at, predict
from planeopt.design.quality import Quality
from planeopt.look import CHART, DARK, LIGHT, RED
from planeopt.rig import Rig

Array = NDArray[np.float64]

LOOKS = ((DARK, "-", "o"), (RED, "--", "s"), (LIGHT, "-.", "^"), ("0.62", ":", "D"))
"""Colour, dashes and marker of each line: apart in lightness too, so that they survive a grey print."""

LEVER_NAMES = {"offset": "offset", "radius": "beam's radius", "f": "focal length", "distance": "distance"}

_PLACES = 49
_FACTORS = np.geomspace(0.5, 2.0, 25)


def design_chart(
    rig: Rig, quality: Quality, distances_mm: ArrayLike, tilts_deg: ArrayLike, toward_deg: ArrayLike
) -> Figure:
    """Draw the standard deviations of z_L and of the normal over distance, and over factors on what is built.

    Where a spot is not wholly in the image or too small there is no line; thin ones are where errors exceed the bound.

    Parameters
    ----------
    rig : Rig
    quality : Pixels or Points
    distances_mm, tilts_deg : sequences of numbers
        Up to four tilts are drawn, of more the ends and two between; each at its worst direction.
    toward_deg : sequence of numbers
        Directions of tilt, as of `plane_at`.
    """
    tilts = np.unique(np.asarray(tilts_deg, dtype=float))
    tilts = tilts[np.linspace(0, len(tilts) - 1, min(len(tilts), len(LOOKS))).round().astype(int)]
    near, far = float(np.min(distances_mm)), float(np.max(distances_mm))
    if near == far:
        near, far = near / 2, far * 2
    distance = np.geomspace(near, far, _PLACES)
    toward = np.unique(np.asarray(toward_deg, dtype=float))
    over_distance = predict(rig, plane_at(rig, distance[:, None, None], tilts[:, None], toward), quality)
    middle = float(np.sqrt(near * far))
    reference = plane_at(rig, middle, tilts[-1], toward)
    levers = [lever for lever in RIG_LEVERS if lever != "offset" or any(rig.require_beam().offset)]
    over_factors = {lever: with_factors(rig, reference, quality, lever, _FACTORS) for lever in levers}
    with mpl.rc_context(dict(CHART)):
        made = Figure(figsize=(10.5, 7.5), layout="constrained", dpi=130)
        made.suptitle(_heading(over_distance, distance), x=0.01, ha="left", fontsize=12, fontweight="bold")
        axes = made.subplots(2, 2, sharey="col")
        for column, (name, unit, scale) in enumerate(
            (("z_L_mm", "z_L, µm", 1e3), ("normal_deg", "the normal, degrees", 1))
        ):
            top, bottom = axes[0, column], axes[1, column]
            for tilt, look, place in zip(tilts, LOOKS, range(len(tilts)), strict=False):
                one = _worst(over_distance, name, np.s_[:, place])
                _line(top, distance, scale * one[0], one[1], look, f"tilt {tilt:g}°", every=8)
            parts = "" if rig.covariance is None else ", with the calibration's part"
            top.set(title=f"standard deviation of {unit.split(',')[0]}, worst direction of tilt{parts}")
            top.set(xlabel="distance along the beam, mm", ylabel=unit, yscale="log")
            for (lever, found), look in zip(over_factors.items(), LOOKS, strict=False):
                one = _worst(found, name, np.s_[:])
                _line(bottom, _FACTORS, scale * one[0], one[1], look, LEVER_NAMES[lever], every=6)
            bottom.set(title=f"what helps, at {middle:.4g} mm, {tilts[-1]:g}°: each by itself times a factor")
            bottom.set(xlabel="factor", ylabel=unit, yscale="log", xscale="log")
            bottom.set_xticks([0.5, 0.7, 1, 1.4, 2])
            bottom.xaxis.set_minor_locator(NullLocator())
            bottom.xaxis.set_major_formatter("{x:g}")
        for ax in axes.flat:
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_minor_locator(NullLocator())
            ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
            ax.grid(visible=True, which="both")
        axes[0, 0].legend()
        axes[1, 0].legend(ncols=2)
        made.canvas.draw()
    return made


def _worst(found: Prediction, name: str, part: Any) -> tuple[Array, NDArray[np.bool_]]:
    """The largest of a standard deviation over the directions of tilt, NaN where one is not visible, and what is ok."""
    sigma = np.where(found.visible, getattr(found, name), np.nan)[part]
    return np.max(sigma, axis=-1), np.all(found.ok[part], axis=-1)


def _line(
    axes: Axes, x: Array, y: Array, ok: NDArray[np.bool_], look: tuple[str, str, str], label: str, every: int
) -> None:
    colour, dashes, marker = look
    axes.plot(x, y, dashes, color=colour, lw=0.8)
    axes.plot(
        x, np.where(ok, y, np.nan), dashes, color=colour, lw=2.2, marker=marker, ms=5, markevery=every, label=label
    )


def _heading(found: Prediction, distance: Array) -> str:
    sigma, normal = _worst(found, "z_L_mm", np.s_[:])[0], _worst(found, "normal_deg", np.s_[:])[0]
    seen = np.isfinite(sigma)
    if not np.any(seen):
        return f"From {distance[0]:.4g} to {distance[-1]:.4g} mm no spot lies wholly in the image"
    worst = (1e3 * float(np.nanmax(sigma)), float(np.nanmax(normal)))
    return (
        f"Sigma of z_L {1e3 * float(np.nanmin(sigma)):.3g} to {worst[0]:.3g} µm, of the normal "
        f"{float(np.nanmin(normal)):.3g} to {worst[1]:.3g} degrees; {np.mean(seen):.0%} of these planes can be measured"
    )
