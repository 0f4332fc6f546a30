"""The sections of a report: one for each input, and what was assumed."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from planeopt.report import tables
from planeopt.report.cells import facts, value_at
from planeopt.report.content import Block, Bullets, Figure, Heading, Section, Table, Text
from planeopt.report.examine import Examined
from planeopt.report.words import BLIND, SEES, SHORT, VERDICTS, flag_sentence, p_text, verdict
from planeopt.solution import Flag


def anchor_of(number: int) -> str:
    """Return the anchor of an input's section, counted from 1."""
    return f"image-{number}"


def image_section(data: Mapping[str, Any], i: int, examined: Examined) -> Section:
    """Return the section of one input.

    Parameters
    ----------
    data : mapping
        Plain values of `poses.json`.
    i : int
        Its place in the records.
    examined : Examined
    """
    name = Path(examined.input).name
    title = name if len(data["records"]) == 1 else f"{i + 1}. {name}"
    return Section(anchor_of(i + 1), title, tuple(_image_blocks(data, i, examined)), tone=_tone(examined.status))


def _tone(status: str) -> Any:
    return status if status in VERDICTS else "plain"


def _image_blocks(data: Mapping[str, Any], i: int, examined: Examined) -> Iterator[Block]:
    record, at = data["records"][i], f"records.{i}"
    flags = tuple(_flags(record))
    said = verdict(examined.status, flagged=bool(set(record["flags"]) - _HARMLESS))
    yield Text(f"{said} {examined.message}", _tone(examined.status))
    if examined.status != "error":
        yield Text(_measured(record))
    if flags:
        yield Bullets(flags)
    figures = {figure.key: figure for figure in examined.figures}
    yield from (figures[key] for key in ("overlay", "refusal") if key in figures)
    if not examined.has_pose:
        yield from _comparison(data, at, record)
        return
    yield tables.quantities(data, at)
    if record["mount"] is not None:
        yield tables.mount(data, f"{at}.mount")
    yield from (figures[key] for key in ("residuals", "plane") if key in figures)
    yield from _other_plane(record)
    yield from _posterior(data, at, figures)
    yield tables.evidence(data, at)
    yield from (Text(text) for text in _tests(record, alone=len(data["records"]) == 1))
    yield from _comparison(data, at, record)


_HARMLESS = {Flag.RIG_WITHOUT_COVARIANCE.name.lower()}  # of all inputs alike, and nothing against the plane


def _measured(record: Mapping[str, Any]) -> str:
    if record["n_points"] is None:
        return "No boundary was measured."
    covered = (
        "" if record["arc_fraction"] is None else f", which cover {100 * record['arc_fraction']:.1f} % of the ellipse"
    )
    solved = "" if record["formulation"] is None else f"; solved by {_method(record)}"
    return f"{record['n_points']} boundary points{covered}{solved}."


def _method(record: Mapping[str, Any]) -> str:
    solver = record["solver"]
    return record["formulation"] if solver in (None, "none") else f"{record['formulation']} with {solver}"


def _flags(record: Mapping[str, Any]) -> Iterator[str]:
    for flag in record["flags"]:
        sentence = flag_sentence(flag, record["status"])
        # The verdict has it already.
        if sentence not in record["message"]:
            yield f"{flag.replace('_', ' ')}: {sentence}"


def _other_plane(record: Mapping[str, Any]) -> Iterator[Block]:
    other = record["other_plane"]
    if other is None:
        yield Text("There is no second plane with the same image.")
        return
    angles = f"alpha = {other['alpha_deg']:.3f} deg"
    angles += "" if other["beta_deg"] is None else f", beta = {other['beta_deg']:.3f} deg"
    yield Text(
        f"The second plane with the same image: z_L = {other['z_L_mm']:.3f} mm, {angles}; excluded: {other['reason']}."
    )


def _posterior(data: Mapping[str, Any], at: str, figures: Mapping[str, Figure]) -> Iterator[Block]:
    record = value_at(data, at)
    posterior = record["posterior"]
    if posterior is None:
        if record["posterior_missing"] is not None:
            yield Text(f"There is no posterior. {record['posterior_missing']}", "note")
        return
    if "corner" in figures:
        yield figures["corner"]
    prior = posterior["prior"]
    yield Text(prior["effect"], "degraded" if prior["dominated"] else "plain")
    yield Text(posterior["laplace"]["sentence"], "plain" if posterior["laplace"]["agrees"] else "note")
    yield from _modes(posterior["modes"])
    if posterior["rig_parameters"]:
        yield tables.split(data, f"{at}.posterior.split", ", ".join(posterior["rig_parameters"]))
    sampling = posterior["diagnostics"]
    yield Text(sampling["sentence"], "plain" if sampling["stopped"] == "converged" else "degraded")
    yield Text(posterior["noise"])


def _modes(modes: Sequence[Mapping[str, Any]]) -> Iterator[Block]:
    """Say which planes share the posterior, where there is more than one."""
    if len(modes) < _TWO:
        return
    yield Bullets(
        tuple(
            f"{100 * mode['weight']:.1f} ± {100 * mode['error']:.1f} % of the posterior: "
            f"z_L = {mode['plane'][0]:.4f} mm, p = {mode['plane'][1]:.5f}, q = {mode['plane'][2]:.5f}, seen "
            f"{'on its lit side' if mode['lit_side'] else 'from behind, through the plane'}."
            for mode in modes
        )
    )


_TWO = 2


def _tests(record: Mapping[str, Any], *, alone: bool) -> Iterator[str]:
    p = record["p_value"]
    if p is None:
        yield "There is no chi-squared: the noise of the points is not known."
        return
    if p >= _SUSPECT:
        meaning = "as a right rig and right points give it"
    elif p >= _IMPROBABLE:
        meaning = "rare with a right rig: look whether other images say the same"
    else:
        meaning = "not to be explained by chance: rig, points or their sigma are wrong"
    yield f"p = {p_text(p)}: {meaning}. {'' if alone else SHORT}".rstrip()
    if alone:
        # Else the summary of all inputs says it, once.
        yield f"{SEES} {BLIND}"


_SUSPECT, _IMPROBABLE = 0.01, 1e-6


def _comparison(data: Mapping[str, Any], at: str, record: Mapping[str, Any]) -> Iterator[Block]:
    table = tables.comparison(data, at)
    if table is None:
        return
    yield table
    failed = [row for row in record["comparison"] if row["status"] != "ok"]
    if failed:
        yield Bullets(tuple(f"{_method(row)}: {row['message']}" for row in failed))


def assumptions(data: Mapping[str, Any]) -> Section:
    """Return the section that says how intervals were made, and from what."""
    provenance, settings = data["provenance"], data["settings"]
    versions = ", ".join(f"{name} {version}" for name, version in provenance["versions"].items())
    blocks: list[Block] = [*_intervals(data["prior"], settings)]
    blocks.append(_provenance(provenance, versions))
    return Section("provenance", "What was assumed, and where this comes from", tuple(blocks))


def _intervals(prior: str, settings: Mapping[str, Any]) -> Iterator[Block]:
    if settings["draws"] is None:
        yield Text("No posterior was asked for: all uncertainties are of first order.")
        return
    yield Heading("Prior")
    yield Text(prior)
    noise = (
        "Gaussian"
        if settings["robust_dof"] is None
        else f"Student's t with {settings['robust_dof']:g} degrees of freedom, which gross errors sway little"
    )
    sentences = [
        f"Likelihood: the distances of the boundary points from the image of the plane's spot; {noise}.",
        "The rig's numbers were taken as exact."
        if settings["condition_on_rig"]
        else "The rig's numbers were let vary with its covariance, where its file has one.",
    ]
    if settings["both_sides"]:
        sentences.append("The spot may be seen from either side of the plane, as on a translucent screen.")
    sentences.append(f"{settings['draws']} effective draws were asked for.")
    yield Bullets(tuple(sentences))


def _provenance(provenance: Mapping[str, Any], versions: str) -> Table:
    return facts(
        "Provenance",
        [
            ("time", provenance["time"]),
            ("command", provenance["command"]),
            ("seed", str(provenance["seed"])),
            ("rig", provenance["rig_file"]),
            ("SHA-256 of the rig's file", provenance["rig_sha256"]),
            ("versions", versions),
        ],
        "provenance",
    )


def contents(sections: Sequence[Section]) -> tuple[tuple[str, str, str], ...]:
    """Return anchor, title and tone of the sections."""
    return tuple((section.anchor, section.title, section.tone) for section in sections)
