"""The section at the head of a report of many inputs."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from planeopt.report import tables
from planeopt.report.batch_figures import Trend, chi2_figure, trends
from planeopt.report.content import Block, Bullets, Figure, Heading, Section, Text, Tone
from planeopt.report.words import BLIND, CAPTIONS, SEES, p_text

_TRENDS = {"z_L_mm": "$z_L$ (mm)", "alpha_deg": r"$\alpha$ (deg)", "beta_deg": r"$\beta$ (deg)"}
_WITHIN = 1.959963984540054  # sigmas: 95 % of a Gaussian


def batch_section(data: Mapping[str, Any], anchors: Sequence[str]) -> Section:
    """Return the summary of all inputs.

    Parameters
    ----------
    data : mapping
        Plain values of `poses.json`.
    anchors : sequence of str
        Of the inputs' sections.
    """
    return Section("summary", "All inputs", tuple(_blocks(data, anchors)))


def _blocks(data: Mapping[str, Any], anchors: Sequence[str]) -> Iterator[Block]:
    records, summary = data["records"], data["summary"]
    yield Text(_verdict(summary["counts"], len(records)), _tone(summary["counts"]))
    yield tables.overview(data, anchors)
    yield Heading("Outliers")
    yield from _outliers(data)
    yield Heading("Is the rig still as calibrated?")
    yield from _drift(data)
    tested = [(i + 1, record["p_value"]) for i, record in enumerate(records) if record["p_value"] is not None]
    if tested:
        numbers, p_values = zip(*tested, strict=True)
        drawing = chi2_figure(numbers, p_values)
        yield Figure("chi2", "Chi-squared against its distribution", CAPTIONS["chi2"], drawing)
    if any(record["z_L_mm"] is not None for record in records):
        yield from _trends(data)
    yield from _combined(data)


def _verdict(counts: Mapping[str, int], n: int) -> str:
    if counts.get("ok", 0) == n:
        return f"All {n} inputs are ok."
    return f"{n} inputs: {', '.join(f'{count} {status}' for status, count in counts.items())}."


def _tone(counts: Mapping[str, int]) -> Any:
    return next((status for status in ("error", "refused", "degraded") if counts.get(status)), "ok")


def _outliers(data: Mapping[str, Any]) -> Iterator[Block]:
    found = data["summary"]["outliers"]
    if not found:
        yield Text("None: no image's chi-squared is too improbable for one of so many.")
        return
    records = data["records"]
    yield Bullets(
        tuple(
            f"image {i + 1}, {records[i]['input']}: chi-squared {records[i]['chi2']:.1f}, "
            f"p = {p_text(records[i]['p_value'])}: its ellipse is of no plane that this rig could show."
            for i in found
        )
    )


def _drift(data: Mapping[str, Any]) -> Iterator[Block]:
    drift = data["summary"]["drift"]
    yield Text(drift["verdict"], _STATES[drift["state"]])
    if drift["tests"]:
        yield tables.drift_tests(data, "summary.drift.tests")
    for key, title in (
        ("shift", "The beam against the rig's file"),
        ("trend", "Change from the first image to the last"),
    ):
        if drift[key]:
            yield tables.changes(data, f"summary.drift.{key}", title)
    yield Text(f"{SEES} {BLIND}")


_STATES: dict[str, Tone] = {"ok": "ok", "degraded": "degraded", "untested": "note"}


def _trends(data: Mapping[str, Any]) -> Iterator[Block]:
    records, sequence = data["records"], data["summary"]["sequence"]
    found = [Trend(label, *_with_ends(records, name)) for name, label in _TRENDS.items()]
    doubtful = [record["status"] == "degraded" for record in records]
    places, along = [float(i + 1) for i in range(len(records))], "image"
    if sequence is not None:
        places, along = sequence["positions"], sequence["label"]
    yield Figure("trends", "Depth and angles", CAPTIONS["trends"], trends(places, along, found, doubtful))
    if sequence is None:
        return
    yield Text(sequence["message"])
    if sequence["trends"]:
        yield tables.slopes(data, "summary.sequence")


def _with_ends(records: Sequence[Mapping[str, Any]], name: str) -> tuple[list[float], list[float], list[float]]:
    """Values with the ends of their 95 % intervals: the posterior's, else of first order; NaN where there is none."""
    rows = [_ends(record, name) for record in records]
    middle, low, high = (list(column) for column in zip(*rows, strict=True))
    return middle, low, high


def _ends(record: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    interval = None if record["posterior"] is None else record["posterior"].get(name)
    if interval is not None:
        middle = interval["median"]
        return middle, *_around(middle, interval["low95"], interval["high95"], name)
    value, sigma = record[name], record["sigma"].get(name)
    if value is None:
        return math.nan, math.nan, math.nan
    reach = 0.0 if sigma is None else _WITHIN * sigma
    return value, value - reach, value + reach


def _around(middle: float, low: float, high: float, name: str) -> tuple[float, float]:
    """Ends of an interval; of a direction next to its middle, also across 180 deg."""
    if name != "beta_deg":
        return low, high
    return middle - (middle - low) % 360, middle + (high - middle) % 360


def _combined(data: Mapping[str, Any]) -> Iterator[Block]:
    found = data["summary"]["combined"]
    if found is None:
        return
    yield Heading("All frames as one plane")
    yield Text(found["message"], "ok" if found["ok"] else "degraded")
    yield tables.quantities(
        data,
        "summary.combined",
        caption=(
            "Of all frames together. Good: the spot's part is well below that of a single frame; the calibration's, "
            "which all frames share, is as it was."
        ),
    )
