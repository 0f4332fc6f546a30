"""`calibration.html`: complete, in agreement with the file, and shown by a browser."""

import json
import re
from pathlib import Path

import msgspec
import pypdf
import pytest

from browser import browse, needs_chromium, show
from calibration_files import calibration_file
from planeopt.calibration.record import CalibrationFile
from planeopt.report.calibration_page import calibration_html
from planeopt.report.calibration_words import CAPTIONS, FORCED, NAMES, NOT_WRITTEN, SYMBOLS
from report_page import PageReader, differing

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


def test_a_refused_calibration_says_whether_its_rig_was_written(file: CalibrationFile):
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
