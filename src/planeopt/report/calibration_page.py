"""The page of a calibration, made from what `calibration.json` holds and nothing else."""

from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from planeopt.calibration.ladder import LEVEL
from planeopt.calibration.record import AdjustmentRecord, CalibrationFile
from planeopt.report import calibration_tables as tables
from planeopt.report.calibration_conditions import conditions
from planeopt.report.calibration_coverage import coverage, poses
from planeopt.report.calibration_geometry import beam, warp
from planeopt.report.calibration_numbers import correlation_matrix, correlations, cost
from planeopt.report.calibration_residuals import Left, histograms, strips, vectors
from planeopt.report.calibration_words import CAPTIONS, FORCED, JOINT, NOT_WRITTEN, VERDICTS
from planeopt.report.cells import facts
from planeopt.report.content import Block, Figure, Page, Picture, Section, Text
from planeopt.report.html import to_html
from planeopt.report.words import number, p_text
from planeopt.rig import BEAM_PARAMETERS

Data = Mapping[str, Any]

_STRONG = 0.9


def calibration_html(file: CalibrationFile) -> str:
    """Return the page of a calibration as HTML that refers to nothing outside itself."""
    return to_html(calibration_page(file))


def calibration_page(file: CalibrationFile) -> Page:
    """Return the page of a calibration."""
    data = file.to_dict()
    sections = [_verdict(file, data)]
    found = file.adjustment
    if found is not None:
        left = Left.of(file, found)
        sections += [
            _section("parameters", "Parameters", _parameters(file, data, found)),
            _section("cost", "What the calibration alone costs a plane", _cost(file, data)),
            _section("model", "Was the right model taken?", _model(file, data, found)),
            _section("residuals", "Residuals", _residuals(file, data, left, found)),
            _section("beam", "The beam", _beam(found)),
        ]
    sections += [
        _section("coverage", "What was covered", _covered(file, found)),
        _section("held-out", "Held-out check", _held_out(file, data)),
        _section("images", "Images", iter([tables.images(data)] if file.images else [])),
        _section("provenance", "Where this comes from", iter([_provenance(file)])),
    ]
    shown = tuple(section for section in sections if section.blocks)
    name = PurePath(file.provenance.session).name or file.provenance.session
    count = len(file.observations.views)
    time = "" if file.provenance.time is None else f", {_readable(file.provenance.time)}"
    return Page(f"Calibration: {name}", f"From {count} views; planeopt {file.planeopt}{time}", shown)


def _section(anchor: str, title: str, blocks: Iterator[Block]) -> Section:
    return Section(anchor, title, tuple(blocks), flows=True)


def _verdict(file: CalibrationFile, data: Data) -> Section:
    blocks: list[Block] = [Text(f"{VERDICTS[file.verdict]} {file.message}", file.verdict)]
    if file.verdict == "refused":
        blocks.append(Text(FORCED if file.forced else NOT_WRITTEN, "refused"))
    if file.next_view is not None:
        blocks.append(Text(file.next_view.sentence, "note"))
    if file.gates:
        blocks.append(conditions(data))
    return Section("verdict", "Verdict", tuple(blocks), tone=file.verdict, flows=True)


def _figure(key: str, title: str, drawn: Picture) -> Figure:
    return Figure(key, title, CAPTIONS[key], drawn)


def _parameters(file: CalibrationFile, data: Data, found: AdjustmentRecord) -> Iterator[Block]:
    yield tables.parameters(data)
    yield from _directions(file, found)
    yield tables.noise(data)
    yield _figure("correlations", "Correlations", correlations(found))
    strongest = _strongest(found)
    if strongest is not None:
        pair, value = strongest
        yield Text(JOINT.format(pair=pair, value=f"{value:+.4f}"), "note")


def _directions(file: CalibrationFile, found: AdjustmentRecord) -> Iterator[Block]:
    """Say how far the beam is from parallel, and from a cylinder."""
    angle = next((one for one in found.derived if one.name == "angle_mrad"), None)
    parallel, divergence = file.tests.get("parallel"), file.tests.get("divergence")
    if angle is not None and parallel is not None:
        known = "" if angle.sigma is None else f" ± {number(angle.sigma, angle.sigma)}"
        yield Text(
            f"The beam and the optical axis make an angle of {number(angle.value, angle.sigma)}{known} mrad: "
            f"{'not parallel' if parallel.p_value < LEVEL else 'parallel, as far as can be told'} "
            f"(F = {parallel.statistic:.3g}, p = {p_text(parallel.p_value)}, of its two components together)."
        )
    if divergence is not None and "divergence" in divergence.larger:
        value, sigma = (1e3 * part for part in divergence.larger["divergence"])
        yield Text(
            f"Were its radius free to grow along it, the beam would diverge by {number(value, sigma)} ± "
            f"{number(sigma, sigma)} mrad, half angle (p = {p_text(divergence.p_value)}): "
            f"{'it is not a cylinder' if divergence.p_value < LEVEL else 'a cylinder, as far as can be told'}."
        )


def _strongest(found: AdjustmentRecord) -> tuple[str, float] | None:
    """Return the strongest correlation between camera and beam, where there is a strong one."""
    names = found.covariance.parameters
    of_beam = np.array([name in BEAM_PARAMETERS for name in names])
    of_camera = np.array([name in _CAMERA for name in names])
    between = np.where(of_camera[:, None] & of_beam, correlation_matrix(found), 0.0)
    row, column = np.unravel_index(int(np.argmax(np.abs(between))), between.shape)
    value = float(between[row, column])
    return (f"{names[row]} and {names[column]}", value) if abs(value) > _STRONG else None


_CAMERA = ("f", "fx", "fy", "cx", "cy")


def _cost(file: CalibrationFile, data: Data) -> Iterator[Block]:
    if file.cost:
        yield _figure("cost", "Joint covariance, or parts as if independent", cost(file.cost))
        yield tables.costs(data)


def _model(file: CalibrationFile, data: Data, found: AdjustmentRecord) -> Iterator[Block]:
    if file.ladder:
        places = [str(i) for i in range(len(file.ladder))]
        yield tables.tests(data, "ladder", places, "Lens models", "ladder")
    if file.tests:
        yield tables.tests(data, "tests", list(file.tests), "Further tests", "tests")
    drawn = warp(file, found)
    if drawn is None:
        yield Text("The board was taken as flat.")
    else:
        yield _figure("warp", "The bow of the board", drawn)


def _residuals(file: CalibrationFile, data: Data, left: Left, found: AdjustmentRecord) -> Iterator[Block]:
    yield _figure("vectors", "Residuals over the image", vectors(file, left))
    yield _figure("strips", "Residuals of each view", strips(left))
    yield tables.views(data)
    yield _figure("histogram", "Distribution of the residuals", histograms(left, found))


def _beam(found: AdjustmentRecord) -> Iterator[Block]:
    drawn = beam(found)
    if drawn is None:
        yield Text("No beam was calibrated: this rig is a camera alone.")
    else:
        yield _figure("beam", "The beam against depth", drawn)


def _covered(file: CalibrationFile, found: AdjustmentRecord | None) -> Iterator[Block]:
    if file.observations.views:
        yield _figure("coverage", "Corners and spots in the image", coverage(file))
    if found is not None:
        yield _figure("poses", "Tilts and depths", poses(found))


def _held_out(file: CalibrationFile, data: Data) -> Iterator[Block]:
    if file.held_out is not None:
        yield Text(file.held_out.sentence, "ok" if file.held_out.ok else "degraded")
        if file.held_out.folds:
            yield tables.folds(data)


def _provenance(file: CalibrationFile) -> Block:
    came, asked = file.provenance, file.options
    wanted = [f"focal {asked.focal}", f"distortion {asked.distortion}", f"beam {asked.beam}"]
    wanted.append("the board's bow free" if asked.warp else "a flat board")
    wanted.append(f"corners weighted {'as measured' if asked.corner_weights == 'measured' else 'equally'}")
    wanted += [] if asked.reject else ["no outliers left out"]
    wanted += [f"{name} = {value:g} ± {room:g}" for name, (value, room) in asked.expect.items()]
    pairs = [("session", came.session), ("command", came.command), ("asked for", ", ".join(wanted))]
    pairs.append(("seed", str(came.seed)))
    if came.time is not None:
        pairs.append(("time", came.time))
    pairs.append(("versions", ", ".join(f"{name} {version}" for name, version in came.versions.items())))
    return facts("Provenance", pairs, "provenance")


def _readable(time: str) -> str:
    return time.replace("T", " ").replace("Z", " UTC")
