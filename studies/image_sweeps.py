"""The boundary's bias and noise along one axis at a time: blur, contrast, over-exposure, speckle."""

import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from planeopt.executors import ordered_map
from planeopt.spot.points import Kind
from studies.boundaries import Deviation
from studies.draws import Look, Range, View, draw_scene
from studies.image_cells import add_up, measure
from studies.study import Mode

KINDS: tuple[Kind, ...] = ("disc", "ring")


@dataclass(frozen=True)
class Setting:
    """What an image is like, in the units of `studies.draws.Look`; tilt, distortion, rig and place are drawn for each.

    `speckle` is the standard deviation of the laser's intensity over its mean, with grains of 1.2 px.
    """

    kind: Kind
    radius_px: float = 40.0
    blur_px: float = 1.2
    contrast: float = 100.0
    noise: float = 2.0
    over: float = 1.0
    speckle: float = 0.0


AXES: Mapping[str, tuple[float, ...]] = {
    "blur_px": (0.5, 0.7, 1.0, 1.4, 2.0, 3.0),
    "contrast": (10.0, 20.0, 40.0, 80.0, 160.0, 230.0),
    "over": (1.0, 1.25, 1.5, 2.0, 3.0, 4.0),
    "speckle": (0.0, 0.1, 0.2, 0.35, 0.5),
}
_JUST_FULL = 230.0
"""Contrast of the first place of the axis `over`, where the light just about fills the scale."""

DRAWS: dict[Mode, int] = {"full": 12, "quick": 2}


@dataclass(frozen=True)
class SweepRow:
    """Images of one kind at one place of an axis.

    Attributes
    ----------
    axis : str
        `blur_px`: of the optics; `contrast`: grey levels, with noise of 2; `over`: light over full scale; `speckle`.
    value : float
    kind : str
    images, refused : int
    bias_px, bias_error_px : float
        Mean signed distance of the points from the true boundary, and its standard error from the images' scatter.
    least_error_px : float
        The least that this error could be without speckle.
    points_px : float
        RMS distance of the points from their mean.
    points_over_bound : float
        The same over its least, which knows of blur, pixels' noise and saturation, not of speckle.
    own, own_error : float
        Mean squared Mahalanobis distance of size, centre and axes over 5, by the points' own sigma: 1 is honest; and
        its standard error.
    reasons : str
        Why images were refused.
    """

    axis: str
    value: float
    kind: str
    images: int
    refused: int
    bias_px: float
    bias_error_px: float
    least_error_px: float
    points_px: float
    points_over_bound: float
    own: float
    own_error: float
    reasons: str


@dataclass(frozen=True)
class Place:
    """A place on an axis, for one kind of spot."""

    axis: str
    value: float
    kind: Kind

    @property
    def setting(self) -> Setting:
        base = Setting(self.kind, contrast=_JUST_FULL) if self.axis == "over" else Setting(self.kind)
        return replace(base, **{self.axis: self.value})


@dataclass(frozen=True)
class Image:
    """One image of a setting."""

    setting: Setting
    draw: int


def places_of(mode: Mode) -> list[Place]:
    """Return all places; quick: the end of each axis."""
    full = [Place(axis, value, kind) for axis, values in AXES.items() for value in values for kind in KINDS]
    return full if mode == "full" else [place for place in full if place.value == AXES[place.axis][-1]]


def run_sweeps(mode: Mode, executor: Executor | None) -> list[SweepRow]:
    """Measure the images of all places."""
    places, count = places_of(mode), DRAWS[mode]
    images = [Image(place.setting, draw) for place in places for draw in range(count)]
    measured = ordered_map(measure_image, images, executor)
    return [_row(place, [next(measured) for _ in range(count)]) for place in places]


def measure_image(image: Image) -> Deviation | str:
    """Render, measure and compare one image; the reason where there is no spot to be measured."""
    setting = image.setting
    rng = np.random.default_rng([zlib.crc32(repr(setting).encode()), image.draw])
    look = Look(
        Range.at(setting.contrast),
        Range.at(setting.noise),
        Range.at(setting.blur_px),
        line_px=Range.at(1.2),
        over=setting.over,
    )
    lit = draw_scene(View(Range.at(setting.radius_px), kind=setting.kind), look, rng)
    return measure(lit.changed(noise=msgspec.structs.replace(lit.scene.noise, speckle=setting.speckle)))


def _row(place: Place, outcomes: Sequence[Deviation | str]) -> SweepRow:
    added = add_up(outcomes)
    return SweepRow(
        axis=place.axis,
        value=place.value,
        kind=place.kind,
        images=len(outcomes),
        refused=len(outcomes) - added.found,
        bias_px=added.mean.bias,
        bias_error_px=added.error.bias,
        least_error_px=float(np.sqrt(added.mean.least_variance / added.found)) if added.found else np.nan,
        points_px=float(np.sqrt(added.mean.variance)),
        points_over_bound=float(np.sqrt(added.mean.points)),
        own=added.mean.own,
        own_error=added.error.own,
        reasons=added.reasons,
    )
