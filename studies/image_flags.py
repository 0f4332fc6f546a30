"""Flags: raised where something is wrong with the image, and not where nothing is."""

import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import msgspec
import numpy as np

from planeopt.executors import ordered_map
from planeopt.simulation import Occlusion, Sensor, render
from planeopt.spot import SpotNotFound, find_spot
from studies.draws import Lit, Look, Range, View, draw_scene

_VIEW = View(Range(40.0, 120.0), image_size=(640, 480))
_LOOK = Look(Range(100, 200), Range(1, 2), blur_px=Range(0.7, 1.3), full_well_electrons=10_000.0)
"""Sharp enough for the beam's own softness, which nobody knows, not to matter."""


@dataclass(frozen=True)
class Fault:
    """Something that may be wrong with an image.

    Attributes
    ----------
    make : callable
        From a seed's generator to the scene.
    flags : tuple of str
        Any one of these says it; none: nothing is wrong.
    """

    make: Callable[[np.random.Generator], Lit]
    flags: tuple[str, ...]


@dataclass(frozen=True)
class FlagRow:
    """What was said about the images with one fault.

    Attributes
    ----------
    fault : str
    expected : str
        The flags that say it.
    images : int
    said : int
        Images with such a flag, or refused.
    refused : int
    raised : str
        Every flag and reason that was given, with its count.
    """

    fault: str
    expected: str
    images: int
    said: int
    refused: int
    raised: str


def _clean(rng: np.random.Generator) -> Lit:
    return draw_scene(_VIEW, _LOOK, rng)


def _uneven(rng: np.random.Generator) -> Lit:
    """What real surfaces and beams are like: no fault."""
    lit = draw_scene(_VIEW, _LOOK, rng)
    slope = rng.uniform(-0.15, 0.15, 2).tolist()
    beam = msgspec.structs.replace(lit.scene.beam, slope=(slope[0], slope[1]), bowl=float(rng.uniform(-0.15, 0.15)))
    surface = msgspec.structs.replace(lit.scene.surface, gradient=(0.03, -0.02))
    return lit.changed(beam=beam, surface=surface)


def _over(rng: np.random.Generator) -> Lit:
    return draw_scene(_VIEW, Look(Range.at(0.0), Range(1, 2), over=2.0), rng)


def _faint(rng: np.random.Generator) -> Lit:
    return draw_scene(_VIEW, Look(Range(20, 24), Range(3, 4)), rng)


def _hidden(rng: np.random.Generator) -> Lit:
    lit = draw_scene(_VIEW, _LOOK, rng)
    return lit.changed(occlusions=(Occlusion(shape="half_plane", share=0.25),))


def _dirty(rng: np.random.Generator) -> Lit:
    """A soft edge, a tenth of the radius wide, whose contours at 25 and 75 % differ by 15 % in their axes' ratio."""
    lit = draw_scene(_VIEW, _LOOK, rng)
    edge = 0.1 * lit.scene.rig.require_beam().radius
    beam = msgspec.structs.replace(
        lit.scene.beam, edge_mm=edge, astigmatism=0.15, astigmatism_deg=float(rng.uniform(-180, 180))
    )
    return lit.changed(beam=beam)


def _fringed(rng: np.random.Generator) -> Lit:
    lit = draw_scene(_VIEW, _LOOK, rng)
    period = lit.scene.rig.require_beam().radius / 2
    beam = msgspec.structs.replace(
        lit.scene.beam, fringes=0.5, fringe_mm=period, fringe_deg=float(rng.uniform(-180, 180)), edge_mm=period / 5
    )
    return lit.changed(beam=beam)


def _gamma(rng: np.random.Generator) -> Lit:
    """A response that is not linear, and that nobody told of; blurred enough to be seen."""
    look = Look(Range(140, 200), Range(1, 2), blur_px=Range(1.3, 2.0), full_well_electrons=10_000.0)
    return draw_scene(_VIEW, look, rng).changed(sensor=Sensor(gamma=2.2))


LEVEL = ("level_dependent", "not_an_ellipse", "many_outliers")

FAULTS: dict[str, Fault] = {
    "none": Fault(_clean, ()),
    "none, uneven": Fault(_uneven, ()),
    "over-exposed twice": Fault(_over, ("saturated",)),
    "faint": Fault(_faint, ("low_contrast",)),
    "a quarter hidden": Fault(_hidden, ("partial_arc",)),
    "gamma 2.2": Fault(_gamma, ("response",)),
    "dirty beam": Fault(_dirty, LEVEL),
    "fringes": Fault(_fringed, LEVEL),
}


def run_flags(images: int, executor: Executor | None) -> list[FlagRow]:
    """Measure so many images with each fault."""
    return [_summary(name, ordered_map(partial(_said, name), range(images), executor)) for name in FAULTS]


def _said(name: str, seed: int) -> tuple[bool, tuple[str, ...]]:
    """Return whether there is a spot, and what was said of it."""
    lit = FAULTS[name].make(np.random.default_rng([zlib.crc32(name.encode()), seed]))
    try:
        spot = find_spot(render(lit.scene).image, lit.scene.rig)
    except SpotNotFound as refusal:
        return False, (refusal.reason.name.lower(),)
    except (ArithmeticError, ValueError, RuntimeError) as broken:
        return False, (f"broken:{type(broken).__name__}",)
    return True, tuple(flag.name.lower() for flag in spot.flags)


def _summary(name: str, outcomes: Iterable[tuple[bool, tuple[str, ...]]]) -> FlagRow:
    outcomes, expected = list(outcomes), FAULTS[name].flags
    counts = Counter(flag for _, flags in outcomes for flag in flags)
    said = [not found or bool(set(flags) & set(expected) if expected else flags) for found, flags in outcomes]
    return FlagRow(
        name,
        " ".join(expected),
        len(outcomes),
        sum(said),
        sum(not found for found, _ in outcomes),
        " ".join(f"{flag}:{count}" for flag, count in sorted(counts.items())),
    )
