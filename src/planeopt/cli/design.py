"""`planeopt design`: what a rig would measure, before it is built."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from planeopt.cli.files import output_folder, write_csv
from planeopt.cli.messages import tables
from planeopt.cli.rigs import load_measuring_rig
from planeopt.cli.tables import table, text_table
from planeopt.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from planeopt.design import Plan, Quality
    from planeopt.rig import Rig

Some = Annotated[list[float] | None, Parameter(consume_multiple=True, negative="")]

CSV, JSON, CHART = "design.csv", "design.json", "design.png"

_USUAL: dict[str, float] = {"contrast": 120.0, "noise": 2.0, "blur_px": 1.0}
"""Of a disc in an 8-bit image, where nothing is said."""

_NAMES = {
    "offset": "beam's offset",
    "radius": "beam's radius",
    "f": "focal length",
    "distance": "distance",
    "noise": "a pixel's noise",
    "contrast": "contrast",
    "blur_px": "blur",
    "sigma_px": "points' sigma",
}


def design(
    *,
    rig: Path | None = None,
    offset_mm: tuple[float, float] | None = None,
    radius_mm: float | None = None,
    f_mm: float | None = None,
    pitch_um: float | None = None,
    image: tuple[int, int] | None = None,
    centre_px: tuple[float, float] | None = None,
    direction: tuple[float, float, float] | None = None,
    distance_mm: Some = None,
    tilt_deg: Some = None,
    toward_deg: Some = None,
    kind: Literal["disc", "ring"] | None = None,
    contrast: float | None = None,
    noise: float | None = None,
    blur_px: float | None = None,
    line_mm: float | None = None,
    sigma_px: float | None = None,
    points: int | None = None,
    arc: float = 1.0,
    arc_deg: float = 0.0,
    sigma_f_px: float | None = None,
    sigma_centre_px: float | None = None,
    sigma_offset_mm: float | None = None,
    sigma_radius_mm: float | None = None,
    sigma_direction_deg: float | None = None,
    want_depth_um: float | None = None,
    want_normal_deg: float | None = None,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Predict how well a rig will measure planes, before it is built: the Cramer-Rao bound, with what would help most.

    Either an existing rig or the numbers of a planned one. Exit status: 0; 2 if some of the planes cannot be measured,
    or what is wanted cannot be reached. docs/design.md tells how to read it.

    Parameters
    ----------
    rig
        A rig file (rig.toml); with a covariance the calibration's part is counted.
    offset_mm
        Where the beam's axis crosses the camera's plane z = 0: x y.
    radius_mm
        Of the beam.
    f_mm
        Focal length.
    pitch_um
        Of the pixels.
    image
        Width and height of the image, px.
    centre_px
        Principal point; the middle of the image unless given.
    direction
        Of the beam, a unit vector; along the optical axis unless given.
    distance_mm
        Of the planes, along the beam: one or more.
    tilt_deg
        Of the planes against the beam: one or more; 0, 30 and 60 unless given.
    toward_deg
        Directions in which they recede, from that of the offset; 0, 90 and 180 unless given.
    kind
        Of the spot; as the rig says, or a disc.
    contrast
        Height of the spot's edge (of a ring's line) in the image, grey levels; 120 unless given.
    noise
        Standard deviation of a pixel, grey levels; 2 unless given.
    blur_px
        Standard deviation of the optics' blur; 1 unless given.
    line_mm
        Standard deviation of a ring's line in the beam.
    sigma_px
        Instead of contrast, noise and blur: standard deviation of a boundary point.
    points
        How many such points there are; 200 unless given.
    arc
        Fraction of the boundary that is seen.
    arc_deg
        Direction of its middle, from that of the offset.
    sigma_f_px
        Standard deviation that the calibration leaves the focal length.
    sigma_centre_px
        The same of cx and of cy.
    sigma_offset_mm
        The same of e_x and of e_y.
    sigma_radius_mm
        The same of the beam's radius.
    sigma_direction_deg
        The same of the beam's direction, in x and in y.
    want_depth_um
        Largest standard deviation of z_L: the offset, the radius and the focal length that reach it are looked for.
    want_normal_deg
        The same of the normal.
    output
        Folder for design.csv, design.json and design.png.
    force
        Write into an existing folder.
    """
    from planeopt.design import plan
    from planeopt.design.chart import design_chart

    built = {
        "--offset-mm": offset_mm,
        "--radius-mm": radius_mm,
        "--f-mm": f_mm,
        "--pitch-um": pitch_um,
        "--image": image,
        "--centre-px": centre_px,
        "--direction": direction,
    }
    left_uncertain: dict[str, float | None] = {
        "--sigma-f-px": sigma_f_px,
        "--sigma-centre-px": sigma_centre_px,
        "--sigma-offset-mm": sigma_offset_mm,
        "--sigma-radius-mm": sigma_radius_mm,
        "--sigma-direction-deg": sigma_direction_deg,
    }
    wanted_rig = _rig(rig, built, left_uncertain)
    quality = _quality(
        wanted_rig,
        {"--kind": kind, "--contrast": contrast, "--noise": noise, "--blur-px": blur_px, "--line-mm": line_mm},
        {"--sigma-px": sigma_px, "--points": points},
        (arc, arc_deg),
    )
    if not distance_mm:
        raise InputError("--distance-mm is needed: the distances of the planes, one or more")
    made = plan(
        wanted_rig,
        quality,
        distance_mm,
        tilt_deg or [0.0, 30.0, 60.0],
        toward_deg or [0.0, 90.0, 180.0],
        depth_mm=None if want_depth_um is None else want_depth_um / 1000,
        normal_deg=want_normal_deg,
    )
    if output is not None:
        chart = design_chart(wanted_rig, quality, made.distance_mm, made.tilt_deg, made.toward_deg)
        with output_folder(output, force=force) as folder:
            write_csv(folder / CSV, made.rows())
            (folder / JSON).write_text(f"{json.dumps(made.to_dict(), indent=1, allow_nan=False)}\n", encoding="utf-8")
            chart.savefig(folder / CHART, metadata={"Software": None})
    _show(tables(), made)
    unreached = any(each.factor is None for each in made.wanted)
    return 2 if unreached or not all(made.prediction.visible) else 0


def _rig(path: Path | None, built: dict[str, Any], left_uncertain: dict[str, float | None]) -> "Rig":
    from planeopt.design import planned_rig

    if path is not None:
        given = next((flag for flag, value in (built | left_uncertain).items() if value is not None), None)
        if given is not None:
            raise InputError(f"{given} is a number of a planned rig, and --rig an existing one: give one or the other")
        return load_measuring_rig(path)
    missing = [flag for flag, value in list(built.items())[:5] if value is None]
    if missing:
        raise InputError(f"{missing[0]} is needed where no existing rig is given by --rig")
    direction = left_uncertain["--sigma-direction-deg"]
    sigmas = {
        "f": left_uncertain["--sigma-f-px"],
        "cx": left_uncertain["--sigma-centre-px"],
        "cy": left_uncertain["--sigma-centre-px"],
        "e_x": left_uncertain["--sigma-offset-mm"],
        "e_y": left_uncertain["--sigma-offset-mm"],
        "radius": left_uncertain["--sigma-radius-mm"],
        "direction_x": None if direction is None else math.radians(direction),
        "direction_y": None if direction is None else math.radians(direction),
    }
    return planned_rig(
        offset_mm=built["--offset-mm"],
        radius_mm=built["--radius-mm"],
        f_mm=built["--f-mm"],
        pitch_um=built["--pitch-um"],
        image=built["--image"],
        centre_px=built["--centre-px"],
        direction=built["--direction"] or (0.0, 0.0, 1.0),
        sigmas={name: sigma for name, sigma in sigmas.items() if sigma is not None},
    )


def _quality(rig: "Rig", pixels: Mapping[str, Any], points: Mapping[str, Any], arc: tuple[float, float]) -> "Quality":
    from planeopt.design import Pixels, Points

    given = next((flag for flag, value in pixels.items() if value is not None), None)
    if points["--sigma-px"] is not None:
        if given is not None:
            raise InputError(f"{given} is of pixels, and --sigma-px of points: give one or the other")
        count = 200 if points["--points"] is None else points["--points"]
        return Points(points["--sigma-px"], count, *arc)
    if points["--points"] is not None:
        raise InputError("--points goes with --sigma-px: pixels say by themselves how much they know")
    ring = (pixels["--kind"] or ("disc" if rig.spot is None else rig.spot.kind)) == "ring"
    if ring and pixels["--line-mm"] is None:
        raise InputError("--line-mm is needed for a ring: the standard deviation of its line in the beam")
    usual = {
        name: _USUAL[name] if value is None else value
        for name, value in ((name, pixels[f"--{name.replace('_', '-')}"]) for name in _USUAL)
    }
    return Pixels(**usual, kind="ring" if ring else "disc", line_mm=pixels["--line-mm"], arc=arc[0], arc_deg=arc[1])


_PREDICTED = [
    ("tilt deg", "tilt_deg", "g"),
    ("toward deg", "toward_deg", "g"),
    ("sigma z_L um", "z_L_um", ".3g"),
    ("spot's", "z_L_spot_um", ".3g"),
    ("sigma normal deg", "sigma_normal_deg", ".3g"),
    ("spot's", "sigma_normal_spot_deg", ".3g"),
    ("sigma tilt deg", "sigma_tilt_deg", ".3g"),
    ("axis px", "axis_px", ".1f"),
    ("margin px", "margin_px", ".0f"),
    ("of the limits", "excess", ".2g"),
]


def _show(console: "Console", made: "Plan") -> None:
    rows = [
        row
        | {"distance mm": f"{row['distance_mm']:g}"}
        | {"z_L_um": _thousand(row["sigma_z_L_mm"]), "z_L_spot_um": _thousand(row["sigma_z_L_spot_mm"])}
        for row in made.rows()
    ]
    parts = made.rig.covariance is not None
    columns = [column for column in _PREDICTED if parts or column[0] != "spot's"]
    console.print(table("predicted standard deviations", "distance mm", rows, columns))
    for view, count in _views(made).items():
        console.print(f"{count} of {len(rows)} planes: {view}", highlight=False)
    if made.hardest is not None:
        console.print(_levers(made, made.hardest))
    if made.wanted:
        console.print(_wanted(made))


def _thousand(value: float | None) -> float | None:
    return None if value is None else 1000 * value


def _views(made: "Plan") -> dict[str, int]:
    from planeopt.design import View

    views = [str(view) for view in made.prediction.views]
    return {view: views.count(view) for view in dict.fromkeys(views) if view != View.OK}


def _levers(made: "Plan", place: int) -> "Table":
    """What helps, at one of the planes: a tenth more of each."""
    rows = [
        {"lever": _NAMES[lever.lever]}
        | {
            f"{name}_{kind}": value
            for name, exponent in (("z_L", float(lever.z_L[place])), ("normal", float(lever.normal[place])))
            for kind, value in (("exponent", exponent), ("change", 1.1**exponent - 1))
        }
        for lever in made.levers
    ]
    title = (
        f"what would help, at {made.distance_mm[place]:g} mm, tilt {made.tilt_deg[place]:g} toward "
        f"{made.toward_deg[place]:g} degrees"
    )
    columns = [
        ("sigma of z_L goes with its power", "z_L_exponent", "+.2f"),
        ("a tenth more changes it by", "z_L_change", "+.1%"),
        ("sigma of the normal", "normal_exponent", "+.2f"),
        ("a tenth more", "normal_change", "+.1%"),
    ]
    return table(title, "lever", rows, columns)


def _wanted(made: "Plan") -> "Table":
    beam, camera = made.rig.require_beam(), made.rig.camera
    pitch = camera.pixel_pitch_mm
    now = {
        "offset": (math.hypot(*beam.offset), "mm"),
        "radius": (beam.radius, "mm"),
        "f": (camera.fx, "px") if pitch is None else (camera.fx * pitch, "mm"),
    }
    rows = []
    for each in made.wanted:
        value, unit = now[each.lever]
        found = "-" if each.factor is None else f"{each.factor * value:.4g} {unit}"
        best = "-" if each.best_factor is None else f"{each.best:.2g} at {each.best_factor * value:.4g} {unit}"
        rows.append((_NAMES[each.lever], f"{value:.4g} {unit}", found, best, each.reason))
    headings = ("what is changed alone", "now", "smallest that reaches it", "worst sigma over wanted", "why not less")
    return text_table("what is wanted of all planes", [(heading, "left") for heading in headings], rows)
