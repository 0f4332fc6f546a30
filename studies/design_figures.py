"""The charts of the design study."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from studies.design_cells import DIRECTIONS_DEG, RANGES, TILTS_DEG, DrawRow, ImageRow, SweepRow
from studies.design_laws import HumpRow, OffsetRow, frontal
from studies.design_summary import limits
from studies.style import DARK, FAINT, LIGHT, RED, figure

_AXES = {
    "offset_mm": ("offset, mm", (3, 5, 10, 20, 40, 80)),
    "radius_mm": ("beam's radius, mm", (1.5, 3, 6, 12)),
    "f_mm": ("focal length, mm", (4, 8, 16, 32)),
    "distance_mm": ("distance, mm", (100, 200, 400, 1000)),
    "tilt_deg": ("tilt, degrees", (0, 15, 30, 45, 60, 75)),
}
_LOOKS = ((DARK, "-", "o"), (RED, "--", "s"), (LIGHT, "-.", "^"))
_QUANTITIES = (("sigma_z_L_um", "z_L", "sigma of z_L, um"), ("sigma_normal_deg", "normal", "sigma of normal, degrees"))


def sweeps_figure(
    rows: Sequence[SweepRow], draws: Sequence[DrawRow], images: Sequence[ImageRow], heading: str
) -> Figure:
    """Draw sigma of z_L and of the normal over each number of the rig, with the checks."""
    with figure(13.5, 7.2, heading) as made:
        axes = made.subplots(2, len(RANGES), sharey="row")
        for column, sweep in enumerate(RANGES):
            key = "toward_deg" if sweep == "tilt_deg" else "tilt_deg"
            for line, (name, short, label) in enumerate(_QUANTITIES):
                ax = axes[line, column]
                for value, (colour, dashes, _) in zip(_others(sweep), _LOOKS, strict=True):
                    part = [row for row in rows if row.sweep == sweep and getattr(row, key) == value]
                    _curve(ax, part, name, colour, dashes)
                _checks(ax, sweep, key, short, name, draws, images)
                _scales(ax, sweep)
                if not column:
                    ax.set_ylabel(label)
        _legend(axes[0, 0], "tilt", TILTS_DEG)
        _legend(axes[0, -1], "tilted toward", DIRECTIONS_DEG)
        _what_is_what(axes[1, 0])
    return made


def _others(sweep: str) -> Sequence[float]:
    return DIRECTIONS_DEG if sweep == "tilt_deg" else TILTS_DEG


def _curve(ax: Axes, part: Sequence[SweepRow], name: str, colour: str, dashes: str) -> None:
    x, y = [row.value for row in part], np.array([getattr(row, name) for row in part])
    ax.plot(x, y, color=colour, lw=0.7, ls=":")
    ax.plot(x, np.where([row.measurable for row in part], y, np.nan), color=colour, lw=1.9, ls=dashes)


def _checks(
    ax: Axes, sweep: str, key: str, short: str, name: str, draws: Sequence[DrawRow], images: Sequence[ImageRow]
) -> None:
    """RMS errors of draws, and images' own sigmas."""
    for value, (colour, _, marker) in zip(_others(sweep), _LOOKS, strict=True):
        part = [row for row in draws if row.sweep == sweep and getattr(row, key) == value]
        y = [getattr(row, name) * getattr(row, f"{short}_over") for row in part]
        ax.plot([row.value for row in part], y, ls="", marker=marker, color=colour, mfc="white", ms=6, mew=1.4)
    taken = [row for row in images if row.sweep == sweep]
    y = [getattr(row, name) * getattr(row, f"{short}_own_over") for row in taken]
    ax.plot([row.value for row in taken], y, ls="", marker="x", color="black", ms=7, mew=1.6, zorder=5)


def _scales(ax: Axes, sweep: str) -> None:
    label, ticks = _AXES[sweep]
    ax.set(xlabel=label, yscale="log", xscale="linear" if sweep == "tilt_deg" else "log")
    ax.xaxis.set_major_locator(FixedLocator(ticks))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter("{x:g}")
    _plain(ax)
    ax.grid(visible=True)


def _plain(ax: Axes) -> None:
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))


def _legend(ax: Axes, what: str, values: Sequence[float]) -> None:
    for value, (colour, dashes, marker) in zip(values, _LOOKS, strict=True):
        ax.plot([], [], color=colour, ls=dashes, marker=marker, mfc="white", label=f"{what} {value:g}")
    ax.legend(loc="best")


def _what_is_what(ax: Axes) -> None:
    ax.plot([], [], color="black", lw=1.9, label="predicted")
    ax.plot([], [], color="black", lw=0.7, ls=":", label="not wholly in the image")
    ax.plot([], [], ls="", marker="o", color="black", mfc="white", label="RMS error of draws")
    ax.plot([], [], ls="", marker="x", color="black", label="images' own sigma (tilt 30)")
    ax.legend(loc="upper right", fontsize=7.5, handlelength=1.4)


def offsets_figure(rows: Sequence[OffsetRow], humps: Sequence[HumpRow], heading: str) -> Figure:
    """Draw what an offset is worth against none."""
    with figure(10.5, 4.6, heading) as made:
        axes = made.subplots(1, 2, sharey=True)
        for ax, name, title in zip(axes, ("z_L", "normal"), ("z_L", "normal"), strict=True):
            ax.axhline(1, color="black", lw=0.8)
            ratio = np.geomspace(0.1, 20, 200)
            place = ("z_L", "normal").index(name)
            ax.plot(ratio, [frontal(x)[place] for x in ratio], color=FAINT, lw=5, label="closed form, frontal plane")
            for tilt, (colour, dashes, marker) in zip(TILTS_DEG, _LOOKS, strict=True):
                part = [row for row in rows if row.tilt_deg == tilt]
                look: dict[str, Any] = {"color": colour, "ls": dashes, "marker": marker, "ms": 4, "markevery": 3}
                x, y = [row.offset_over_radius for row in part], [getattr(row, f"{name}_over") for row in part]
                ax.plot(x, y, label=f"tilt {tilt:g}, worst direction", **look)
            even = humps[place].even_offset_over_radius
            ax.axvline(even, color="black", lw=0.8, ls=":")
            place_of_text = ax.get_xaxis_transform()
            ax.text(1.05 * even, 0.93, f"better from {even:.2f} radii", transform=place_of_text)
            ax.set(xscale="log", yscale="log", xlabel="offset over the beam's radius", title=f"sigma of {title}")
            ax.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 5, 10, 20]))
            ax.xaxis.set_minor_locator(NullLocator())
            ax.xaxis.set_major_formatter("{x:g}")
            _plain(ax)
            ax.grid(visible=True)
        axes[0].set_ylabel("over that of a coaxial beam")
        axes[0].legend(loc="lower left")
    return made


def checks_figure(draws: Sequence[DrawRow], images: Sequence[ImageRow], heading: str) -> Figure:
    """Draw squared errors of draws and images over the predicted, and the images' own sigmas."""
    with figure(10.5, 4.6, heading) as made:
        drawn, taken = made.subplots(1, 2)
        solved = min(row.draws - row.lost for row in draws)
        for freedoms, colour, label in (
            (solved, FAINT, "chance, z_L alone"),
            (3 * solved, LIGHT, "chance, all of (z_L, p, q)"),
        ):
            drawn.axhspan(*limits(freedoms, 2 * len(draws)), color=colour, alpha=0.35, lw=0, label=label)
        sigma = [row.sigma_z_L_um for row in draws]
        drawn.plot(sigma, [row.z_L_over**2 for row in draws], "^", color=RED, ms=5, mfc="white", label="z_L")
        drawn.plot(sigma, [row.squared for row in draws], "o", color=DARK, ms=5, label="(z_L, p, q)")
        drawn.axhline(1, color="black", lw=0.8)
        drawn.set(
            xscale="log",
            xlabel="predicted sigma of z_L, um; a marker is a plane",
            ylabel="squared errors over the predicted",
            title="maximum likelihood on drawn points",
        )
        drawn.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        drawn.legend(loc="best", ncols=2)
        place = np.arange(len(images))
        own = [(row.z_L_own_over, row.normal_own_over) for row in images]
        taken.plot(place, [one[0] for one in own], "s", color=RED, ms=6, mfc="white", label="own sigma of z_L")
        taken.plot(place, [one[1] for one in own], "x", color=DARK, ms=6, mew=1.8, label="own sigma of the normal")
        rms = np.sqrt([row.squared for row in images])
        chance = rms / np.sqrt([6 * max(row.images - row.refused, 1) for row in images])
        look: dict[str, Any] = {"fmt": "D", "color": LIGHT, "ms": 5, "capsize": 3, "zorder": 1}
        taken.errorbar(place, rms, chance, label="RMS error, one sigma of chance", **look)
        taken.axhline(1, color="black", lw=0.8)
        names = [f"{row.sweep.rpartition('_')[0]} {row.value:g}" for row in images]
        taken.set_xticks(place, names, rotation=60, ha="right")
        taken.set(
            ylabel="over the predicted", title="rendered images, the reference but for one number", ylim=(0, None)
        )
        taken.legend(loc="lower right")
        for ax in (drawn, taken):
            ax.grid(visible=True)
    return made
