"""`calibration.html`: complete, in agreement with the file, and shown by a browser."""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pypdf
import pytest

from browser import browse, needs_chromium, show
from calibrated import good
from calibration_files import calibration_file
from planeopt.calibration.gates import judge
from planeopt.calibration.record import CalibrationFile
from planeopt.report.calibration_conditions import conditions, from_below
from planeopt.report.calibration_page import calibration_html
from planeopt.report.calibration_residuals import Left, strips
from planeopt.report.calibration_words import CAPTIONS, FORCED, NAMES, NOT_WRITTEN, SYMBOLS, UNITS
from report_page import PageReader, differing, undrawn

FIGURES = ["correlations", "cost", "warp", "vectors", "strips", "histogram", "beam", "coverage", "poses"]
TABLES = ["gates", "parameters", "noise", "costs", "ladder", "tests", "views", "held_out", "images", "provenance"]


@pytest.fixture(scope="module")
def file() -> CalibrationFile:
    return calibration_file()


@pytest.fixture(scope="module")
def html(file: CalibrationFile) -> str:
    return calibration_html(file)


@pytest.fixture(scope="module")
def page(html: str) -> PageReader:
    return PageReader(html)


def test_it_refers_to_nothing_outside_itself(page: PageReader, html: str):
    assert page.tags.isdisjoint({"script", "iframe", "object", "embed", "base", "form"})
    assert all(reference.startswith(("#", "data:")) for reference in page.references)
    assert {reference[1:] for reference in page.references if reference.startswith("#")} <= page.anchors
    assert not re.search(r"url\(|@import|https?:|expression", page.style)
    assert len(html) < 3e6


def test_every_figure_is_there_with_what_good_looks_like(page: PageReader):
    assert [figure.key for figure in page.figures if not figure.table] == FIGURES
    assert [figure.key for figure in page.figures if figure.table] == TABLES
    for figure in page.figures:
        assert figure.heading
        if figure.key != "provenance":
            assert figure.caption
        if not figure.table:
            assert figure.caption == CAPTIONS[figure.key]
            assert "Good:" in figure.caption
            assert figure.images[0].startswith("data:image/png;base64,iVBORw0KGgo")


def test_numbers_are_those_of_the_file(page: PageReader, file: CalibrationFile):
    assert differing(page.cells, json.loads(file.to_json())) == []
    shown = {key for keys, _ in page.cells for key in keys.split()}
    assert file.adjustment is not None
    for i in range(len(file.adjustment.parameters)):
        assert {f"adjustment.parameters.{i}.{part}" for part in ("value", "sigma", "low95", "high95")} <= shown
    for i in range(len(file.cost)):
        assert f"cost.{i}.sigma_z_L_mm" in shown
        assert f"cost.{i}.independent_normal_deg" in shown


def test_what_it_says(page: PageReader, file: CalibrationFile):
    words = " ".join(page.words)
    assert file.message in words
    assert file.next_view is not None
    assert file.next_view.sentence in words
    # Names and sentences are not taken for HTML.
    assert "<b>.png" in words
    assert "So <so>: views." in words
    assert "b" not in page.tags
    assert "No marker was found." in words
    assert "have a correlation of" in words
    assert "focal length f (mm)" in words
    assert "mrad" in words


@pytest.mark.parametrize(
    ("gate", "said"),
    [
        (("views", "ok", 12.0, (10.0, 5.0)), ("views", "at least 10", "below 5")),
        (("residuals", "ok", 0.1, (0.5, 1.0)), ("px", "at most 0.5", "above 1")),
        (("coverage", "ok", 0.9, (0.5, None)), ("share of the cells", "at least 0.5", "-")),
        (("board bow", "ok", 0.0, (0.25, None)), ("mm", "at most 0.25", "-")),
        (("marker size", "ok", 0.01, (None, 0.08)), ("relative", "at most 0.08", "above 0.08")),
        (("mirror", "refuse", 0.2, (0.0, 0.0)), ("share of the views", "none", "any")),
        (("tilt", "refuse", 2.0, (20.0, 3.0)), ("degrees", "at least 20", "below 3")),
        (("stated radius", "ok", 0.1, (0.125, 0.125)), ("", "at most 0.125", "above 0.125")),
        (("camera conditioning", "ok", 366.0, (3000.0, 1e4)), ("condition number", "at most 3000", "above 10000")),
    ],
)
def test_a_condition_says_on_which_side_of_its_limits_good_lies(gate: tuple[Any, ...], said: tuple[str, ...]):
    name, state, value, limits = gate
    record = {"name": name, "state": state, "value": value, "limits": limits, "sentence": "So."}
    row = conditions({"gates": [record]}).rows[0]
    assert (row[2].text, row[4].text, row[5].text) == said


def test_conditions_of_a_good_session_are_shown_as_met():
    # A gate that came without its name among those that ask for enough would show a limit that is not met.
    judged = judge(good())
    for gate in judged:
        assert gate.state == "ok", gate.name
        assert gate.value is not None
        limit = next(limit for limit in gate.limits if limit is not None)
        below = from_below({"name": gate.name, "limits": gate.limits})
        assert gate.value >= limit if below else gate.value <= limit, gate.name
        assert gate.name in UNITS, gate.name


def test_bars_of_spots_are_what_their_ellipses_expect(file: CalibrationFile):
    found = file.adjustment
    assert found is not None
    noise = found.noise
    bars = Left.of(file, found).spot_rms
    # Over all spots chi-squared is as large as its degrees of freedom, to the per mille to which the factor settles,
    # unless that was held at 1: five of each spot, less what the beam takes.
    wanted = min(noise.chi2_spots, noise.dof_spots)
    assert 5 * np.nansum(bars**2) == pytest.approx(wanted, rel=2e-3)
    unused = msgspec.structs.replace(found.views[0], spot_used=False)
    without = Left.of(file, msgspec.structs.replace(found, views=(unused, *found.views[1:])))
    assert np.isnan(without.spot_rms[0])
    assert np.array_equal(without.spot_rms[1:], bars[1:], equal_nan=True)
    assert strips(without).png


def test_a_refused_calibration_says_whether_its_rig_was_written(file: CalibrationFile, monkeypatch: pytest.MonkeyPatch):
    undrawn(monkeypatch)
    refused = msgspec.structs.replace(
        file, verdict="refused", adjustment=None, ladder=(), tests={}, held_out=None, cost=()
    )
    page = PageReader(calibration_html(refused))
    assert NOT_WRITTEN in " ".join(page.words)
    assert [figure.key for figure in page.figures if not figure.table] == ["coverage"]
    forced = msgspec.structs.replace(file, verdict="refused", forced=True)
    assert FORCED in " ".join(PageReader(calibration_html(forced)).words)


def test_a_calibration_without_anything_seen_still_has_a_page(file: CalibrationFile):
    seen = msgspec.structs.replace(file.observations, views=())
    nothing = msgspec.structs.replace(
        file, verdict="refused", adjustment=None, observations=seen, ladder=(), tests={}, held_out=None, cost=()
    )
    page = PageReader(calibration_html(nothing))
    assert "No marker was found." in " ".join(page.words)
    assert not [figure for figure in page.figures if not figure.table]


def test_every_parameter_has_a_name_and_a_symbol(file: CalibrationFile):
    assert file.adjustment is not None
    assert {one.name for one in (*file.adjustment.parameters, *file.adjustment.derived)} <= set(NAMES)
    assert set(file.adjustment.covariance.parameters) <= set(SYMBOLS)


def test_the_same_file_gives_the_same_page(file: CalibrationFile, html: str):
    assert calibration_html(file) == html


@needs_chromium
@pytest.mark.parametrize("width", [1280, 500])
def test_a_browser_shows_it_without_complaint_and_without_overflow(html: str, width: int, tmp_path: Path):
    shown = show(tmp_path, html, width)
    assert shown.complaints == ""
    assert shown.client == width
    assert (shown.scroll <= shown.client, shown.wide, shown.broken) == (True, 0, 0)


@needs_chromium
def test_a_browser_prints_it(html: str, tmp_path: Path):
    (tmp_path / "calibration.html").write_text(html, encoding="utf-8")
    browse(tmp_path, tmp_path / "calibration.html", f"--print-to-pdf={tmp_path / 'print.pdf'}")
    pages = pypdf.PdfReader(tmp_path / "print.pdf").pages
    assert [float(side) for side in pages[0].mediabox[2:]] == pytest.approx([595, 842], abs=1)
    assert all(page.extract_text().strip() or page.images for page in pages)
    assert len(pages) <= 14
