"""`planeopt spot`: the boundary of the spot in each image, with a picture to judge it by."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.types import PositiveFloat, PositiveInt

from planeopt.cli.files import output_folder, spare_inputs
from planeopt.cli.messages import report, tables
from planeopt.cli.tables import table
from planeopt.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from planeopt.batch import Search, SpotMeasurement
    from planeopt.rig import Rig
    from planeopt.spot.record import SpotRecord

RECORDS = "spots.jsonl"

_COLUMNS = [
    ("points", "n_points", "d"),
    ("arc %", "arc", ".1f"),
    ("sigma px", "sigma_px", ".4f"),
    ("blur px", "blur_px", ".2f"),
    ("contrast %", "contrast", ".1f"),
]


def spot(
    *images: Annotated[str, Parameter(required=True)],
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    rig: Path | None = None,
    kind: Literal["disc", "ring"] | None = None,
    region: str | None = None,
    dark: Path | None = None,
    camera_blur_px: PositiveFloat | None = None,
    level: float | None = None,
    channel: Literal["gray", "red", "green", "blue"] | None = None,
    gamma: float | None = None,
    jobs: PositiveInt = 1,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Measure the boundary of the spot in each image: DIR/NAME.csv, a picture DIR/NAME.png, a line of DIR/spots.jsonl.

    NAME is the image's, without its suffix; of several images with one name the second becomes NAME-2, and so on.
    Exit status: 0 all ok; 2 some degraded or refused; 1 some image cannot be used.

    Parameters
    ----------
    images
        PNG, TIFF, JPEG, BMP or PGM; grey or colour.
    output
        Folder for the points, the pictures and the records.
    rig
        The rig file (rig.toml): its camera, how its spot is defined, and where its beam can be seen.
    kind
        What the spot is; told from the image unless given here or in the rig.
    region
        Part of the image where the spot's centre is: x0,y0,x1,y1 in px.
    dark
        An image of the same view with the laser off, to be subtracted from each.
    camera_blur_px
        Standard deviation of what optics and pixels blur, if known.
    level
        Fraction of the plateau that is a disc's boundary, 0.5 unless given; with a rig it is the rig's.
    channel
        Of a colour image, "gray" unless given; with a rig it is the rig's.
    gamma
        Of the camera's response, 1 (linear) unless given; with a rig it is the rig's.
    jobs
        Processes to work in.
    force
        Write into an existing folder.
    """
    import msgspec

    from planeopt.batch import Search
    from planeopt.executors import ordered_map, processes
    from planeopt.rig import load_rig
    from planeopt.spot import read_image

    loaded = None if rig is None else load_rig(rig)
    _check_definition(loaded, kind=kind, level=level, channel=channel, gamma=gamma)
    search = Search(
        kind=kind,
        region=None if region is None else _region(region),
        dark=None if dark is None else read_image(dark),
        camera_blur=camera_blur_px,
        level=level,
        channel=channel,
        gamma=gamma,
    )
    names = names_of(images)
    written = [output / RECORDS, *(output / f"{name}{suffix}" for name in names for suffix in (".csv", ".png"))]
    spare_inputs(written, [*images, *(file for file in (rig, dark) if file is not None)])
    with output_folder(output, force=force) as folder, processes(jobs) as executor:
        work = partial(_measure, rig=loaded, search=search, folder=folder)
        kept: list[SpotRecord] = []
        status = report(_kept(ordered_map(work, zip(images, names, strict=True), executor), kept), len(images), "spot")
        (folder / RECORDS).write_text("".join(f"{record.to_json()}\n" for record in kept), encoding="ascii")
    rows = [_row(msgspec.to_builtins(record)) for record in kept]
    words = [("status", "status"), ("kind", "kind"), ("flags", "flags")]
    tables().print(table("spots", "image", rows, _COLUMNS, words=words))
    return status


def names_of(images: Sequence[str]) -> list[str]:
    """Return the name of each image's files: its own, or with -2, -3, ... where an image before it has that name.

    Upper and lower case count as the same: on some systems they are.
    """
    stems = [Path(image).stem for image in images]
    own = {stem.casefold() for stem in stems}
    taken: set[str] = set()
    names = []
    for stem in stems:
        name, number = stem, 2
        while name.casefold() in taken or (number > 2 and name.casefold() in own):
            name, number = f"{stem}-{number}", number + 1
        taken.add(name.casefold())
        names.append(name)
    return names


def _region(text: str) -> tuple[float, float, float, float]:
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--region must be four numbers x0,y0,x1,y1 in px, not {text!r}") from None
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"--region must have x0 < x1 and y0 < y1, not {text!r}")
    return x0, y0, x1, y1


def _check_definition(rig: "Rig | None", **asked: str | float | None) -> None:
    """See to it that what is asked for is possible and not contrary to the rig's definition of its spot."""
    from planeopt.rig import SpotDefinition

    given: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
    SpotDefinition(**given)
    if rig is None or rig.spot is None:
        return
    for name, value in given.items():
        own = getattr(rig.spot, name)
        if own != value:
            raise InputError(f"--{name} {value}: the rig's radius was calibrated with {own}; leave the option out")


def _measure(item: tuple[str, str], *, rig: "Rig | None", search: "Search", folder: Path) -> "SpotRecord":
    """Measure one image, write its files, and return its record."""
    import msgspec

    from planeopt.batch import measure_spot
    from planeopt.spot import write_points

    image, name = item
    measured = measure_spot(image, rig, search)
    points, picture = None, None
    if measured.spot is not None:
        points = f"{name}.csv"
        write_points(measured.spot, folder / points)
    figure = _picture(measured, rig, search)
    if figure is not None:
        picture = f"{name}.png"
        figure.savefig(folder / picture)
    return msgspec.structs.replace(measured.record, points_file=points, picture_file=picture)


def _picture(measured: "SpotMeasurement", rig: "Rig | None", search: "Search") -> "Figure | None":
    from planeopt.report import refusal_picture, spot_overlay

    name = Path(measured.record.input).name
    if measured.image is None or measured.record.status == "error":
        return None
    if measured.spot is None:
        return refusal_picture(measured.image.pixels, measured.record.message, name)
    channel = rig.spot.channel if rig is not None and rig.spot is not None else search.channel
    camera = None if rig is None else rig.camera
    return spot_overlay(measured.image.pixels, measured.spot, name, camera=camera, channel=channel or "gray")


def _kept(records: Iterator["SpotRecord"], kept: list["SpotRecord"]) -> Iterator["SpotRecord"]:
    for record in records:
        kept.append(record)
        yield record


def _row(record: dict[str, Any]) -> dict[str, Any]:
    """Return what the table shows of a record: shares as percent."""
    shares = {name: None if record[key] is None else 100 * record[key] for name, key in _SHARES.items()}
    return record | shares | {"image": Path(record["input"]).name, "flags": ", ".join(record["flags"])}


_SHARES = {"arc": "arc_fraction", "contrast": "contrast"}
