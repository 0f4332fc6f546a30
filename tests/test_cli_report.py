"""`planeopt report`: its page, its paper, its numbers, and what it refuses."""

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import msgspec
import numpy as np
import pypdf
import pytest

import planeopt.report
from browser import browse, needs_chromium, show
from example_rig import example_rig
from planeopt.cli import INTERRUPTED, main
from planeopt.example import example_folder, example_targets
from planeopt.posterior import Posterior, Stop, sample_posterior
from planeopt.report.record import ReportFile
from planeopt.report.schema import report_schema
from planeopt.report.words import CAPTIONS
from planeopt.rig import Mount, RigCovariance, save_rig
from planeopt.spot import Spot, find_spot, read_image, write_points
from report_page import PageReader, differing, undrawn

RIG = str(example_folder() / "truth_rig.toml")
TARGETS = [str(path) for path in example_targets()]
REPORTED = TARGETS[:4]
"""All six are reported on by the demo."""
OF_A_POSE = ["overlay", "quantities", "residuals", "plane", "corner", "tests", "comparison"]
OF_MANY = ["overview", "drift", "chi2", "trends"]
FEW = ["--draws", "100"]


@dataclass(frozen=True)
class Made:
    """A report on disk."""

    folder: Path
    data: dict[str, Any]
    page: PageReader
    paper: pypdf.PdfReader

    @classmethod
    def of(cls, folder: Path) -> "Made":
        page = PageReader((folder / "report.html").read_text(encoding="utf-8"))
        data = json.loads((folder / "poses.json").read_bytes())
        return cls(folder, data, page, pypdf.PdfReader(folder / "report.pdf"))

    def keys_after(self, number: int | None) -> list[str]:
        """Keys of the figures of one input's section (counted from 1), or of the summary."""
        html = (self.folder / "report.html").read_text(encoding="utf-8")
        section = html.split(f'<section id="{"summary" if number is None else f"image-{number}"}"', 1)[1]
        return re.findall(r'<figure[^>]* data-(?:figure|table)="(\w+)"', section.split("<section", 1)[0])


def run(folder: Path, *arguments: str) -> int:
    return main(["report", *arguments, "-o", str(folder), "--force"])


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Bundled targets."""
    folder = tmp_path_factory.mktemp("targets")
    assert run(folder, *REPORTED, "--rig", RIG, *FEW, "--sequence") == 0
    return Made.of(folder)


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are written with blank pictures."""
    undrawn(monkeypatch)


def sparse_spot() -> Spot:
    """Some boundary points of a target."""
    spot = find_spot(read_image(TARGETS[3]), example_rig())
    assert spot.sigma is not None
    return Spot(spot.points[::12], spot.sigma[::12])


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A target, boundary points, what cannot be measured, and what cannot be read; with a rig's covariance."""
    folder = tmp_path_factory.mktemp("mixed")
    sigmas = {"e_x": 0.04, "e_y": 0.04, "direction_x": 2e-4, "direction_y": 2e-4}
    covariance = RigCovariance(tuple(sigmas), np.diag(np.square(list(sigmas.values()))))
    mount = Mount(np.array([[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1.0]]), "flange")
    save_rig(replace(example_rig(), covariance=covariance, mount=mount), folder / "rig.toml")
    cv2.imwrite(str(folder / "black.png"), np.zeros((720, 960), np.uint8))
    (folder / "notes.png").write_text("no image", encoding="utf-8")
    write_points(sparse_spot(), folder / "<b>&'\".csv")
    inputs = [TARGETS[5], *(str(folder / name) for name in ("black.png", "notes.png", "none.png", "<b>&'\".csv"))]
    assert run(folder, *inputs, "--rig", str(folder / "rig.toml"), *FEW, "--combine") == 1
    return Made.of(folder)


@pytest.fixture(params=["targets", "mixed"])
def made(request: pytest.FixtureRequest) -> Made:
    return request.getfixturevalue(request.param)


def test_the_page_refers_to_nothing_outside_itself(made: Made):
    page = made.page
    assert page.tags.isdisjoint({"script", "iframe", "object", "embed", "base", "form"})
    assert all(reference.startswith(("#", "data:")) for reference in page.references)
    assert {reference[1:] for reference in page.references if reference.startswith("#")} <= page.anchors
    assert not re.search(r"url\(|@import|https?:|expression", page.style)
    assert (made.folder / "report.html").stat().st_size < 6e6


def test_every_figure_is_there_with_its_caption_and_its_picture(made: Made):
    for i, record in enumerate(made.data["records"], start=1):
        keys = made.keys_after(i)
        if record["z_L_mm"] is not None:
            extra = {"split"} if record["posterior"]["rig_parameters"] else set()
            extra |= {"mount"} if record["mount"] else set()
            assert sorted(keys) == sorted({*OF_A_POSE, *extra})
        elif record["status"] == "refused":
            assert keys == ["refusal"]
        else:
            assert keys == []
    assert set(OF_MANY) <= set(made.keys_after(None))
    for figure in made.page.figures:
        assert figure.heading
        assert figure.table or len(figure.images) == 1
        if figure.key in CAPTIONS and figure.key != "quantities":
            assert figure.caption == CAPTIONS[figure.key]
            assert "Good" in figure.caption
        if not figure.table:
            assert figure.images[0].startswith("data:image/png;base64,iVBORw0KGgo")


def test_numbers_on_the_page_are_those_of_the_file(made: Made):
    assert differing(made.page.cells, made.data) == []
    shown = {key for keys, _ in made.page.cells for key in keys.split()}
    for i, record in enumerate(made.data["records"]):
        if record["z_L_mm"] is None:
            continue
        for name in ("z_L_mm", "alpha_deg", "beta_deg", "R_mm"):
            ends = ("median", "low68", "high68", "low95", "high95")
            wanted = {f"records.{i}.{name}", *(f"records.{i}.posterior.{name}.{end}" for end in ends)}
            missing = wanted - shown
            assert not missing or (name == "beta_deg" and record["posterior"]["beta_deg"] is None)


def test_the_check_of_numbers_would_notice():
    data = {"a": {"b": [1.25, -2e-9]}}
    assert differing([("a.b.0", "1.3 mm"), ("a.b.0 a.b.1", "1.25 to -2.0e-09")], data) == []
    assert len(differing([("a.b.0", "1.4"), ("a.b.0 a.b.1", "1.25"), ("a.b.1", "-2.2e-09")], data)) == 3


def test_the_file_is_as_its_schema_says(made: Made):
    shipped = json.loads(Path(planeopt.report.__file__).with_name("poses.schema.json").read_text(encoding="utf-8"))
    assert shipped == json.loads(json.dumps(report_schema()))
    validator = jsonschema.Draft202012Validator(shipped)
    validator.check_schema(shipped)
    validator.validate(made.data)
    broken = made.data | {"records": [made.data["records"][0] | {"z_L_mm": "far"}]}
    assert not validator.is_valid(broken)
    assert json.loads(msgspec.convert(made.data, ReportFile).to_json()) == made.data


def test_paper_says_what_the_page_says(made: Made):
    pages = [page.extract_text() for page in made.paper.pages]
    paper = re.sub(r"\s", "", "".join(pages))
    captions = {figure.caption for figure in made.page.figures}
    cells = {word for figure in made.page.figures for word in figure.words}
    for text in captions | cells:
        assert re.sub(r"\s", "", text) in paper, text
    for number, text in enumerate(pages, start=1):
        assert f"page {number} of" in text
        assert len(text) > 100
    count = len(pages)
    # Each input that has a plane takes three pages or four; the summary two or three.
    posed = sum(record["z_L_mm"] is not None for record in made.data["records"])
    assert 3 * posed + 2 <= count <= 4 * posed + 6
    images = sum(len(page.images) for page in made.paper.pages)
    assert images == sum(len(figure.images) for figure in made.page.figures)
    assert made.paper.metadata is not None
    assert made.paper.metadata.title == next(word for word in made.page.words if word.startswith("Plane report"))
    assert [float(side) for side in made.paper.pages[0].mediabox[2:]] == pytest.approx([595.28, 841.89], abs=0.01)


def test_the_bundled_targets_are_ok_and_their_truth_is_within_the_intervals(targets: Made):
    outside = 0
    for path, record in zip(REPORTED, targets.data["records"], strict=True):
        truth = json.loads(Path(path).with_suffix(".json").read_bytes())
        assert record["status"] == "ok"
        for name in ("z_L_mm", "alpha_deg", "beta_deg"):
            interval = record["posterior"][name]
            outside += not interval["low95"] <= truth[name] <= interval["high95"]
    # Of 12 intervals of 95 % more than 4 miss less often than once in a thousand times.
    assert outside <= 4
    assert targets.data["summary"]["counts"] == {"ok": 4}
    assert targets.data["summary"]["outliers"] == []
    assert targets.data["summary"]["drift"]["state"] == "ok"
    assert len(targets.data["summary"]["sequence"]["trends"]) == 4
    assert "slopes" in targets.keys_after(None)
    words = " ".join(targets.page.words)
    assert "All 4 inputs are ok." in words
    for sentence in (targets.data["prior"], targets.data["summary"]["drift"]["verdict"]):
        assert sentence in words
    assert "the focal length" in words


def test_what_is_wrong_with_one_input_costs_that_input_alone(mixed: Made):
    statuses = [record["status"] for record in mixed.data["records"]]
    assert statuses == ["ok", "refused", "error", "error", "ok"]
    words = " ".join(mixed.page.words)
    for record in mixed.data["records"]:
        assert record["message"] in words
    assert "<b>&'\".csv" in words
    assert "b" not in mixed.page.tags
    # The image that has no spot is shown with the reason, its name is not taken for HTML.
    assert mixed.keys_after(2) == ["refusal"]
    combined = mixed.data["summary"]["combined"]
    assert combined["n_frames"] == 2
    # Two different planes, and the numbers of the inputs count those that have none.
    assert "scatter" in combined["message"]
    assert mixed.data["summary"]["drift"]["state"] == "ok"
    split = mixed.data["records"][0]["posterior"]["split"]["z_L_mm"]
    first = mixed.data["records"][0]["first_order"]["z_L_mm"]
    assert split["calibration"] > 0
    assert first["sigma"] ** 2 == pytest.approx(first["spot"] ** 2 + first["calibration"] ** 2)


def test_the_same_command_writes_the_same_bytes_in_any_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    monkeypatch.chdir(tmp_path)
    spot = sparse_spot()
    write_points(spot, "a.csv")
    write_points(Spot(spot.points), "b.csv")
    contents = []
    for jobs in ("1", "2"):
        assert run(Path("out"), "a.csv", "b.csv", "--rig", RIG, "--draws", "60", "--jobs", jobs) == 0
        contents.append({path.name: path.read_bytes() for path in Path("out").iterdir()})
    assert sorted(contents[0]) == ["poses.json", "report.html", "report.pdf"]
    assert contents[0] == contents[1]
    came = json.loads(contents[0]["poses.json"])["provenance"]
    assert came["time"] == "2023-11-14T22:13:20Z"
    assert "--jobs" not in came["command"]
    assert came["command"].startswith("planeopt report ")
    assert re.fullmatch(r"[0-9a-f]{64}", came["rig_sha256"])
    assert {"planeopt", "python", "numpy", "casadi", "opencv", "emcee"} <= set(came["versions"])
    assert b"D:20231114221320" in contents[0]["report.pdf"]


@pytest.mark.usefixtures("blank")
def test_a_single_input_without_a_posterior(tmp_path: Path):
    assert run(tmp_path, TARGETS[1], "--rig", RIG, "--no-posterior") == 0
    single = Made.of(tmp_path)
    (record,) = single.data["records"]
    assert record["posterior"] is None
    assert record["posterior_missing"] in " ".join(single.page.words)
    assert "corner" not in single.keys_after(1)
    assert "summary" not in single.page.anchors
    assert differing(single.page.cells, single.data) == []


@pytest.mark.usefixtures("blank")
def test_options_reach_the_sampler(tmp_path: Path):
    options = ["--robust", "4", "--both-sides", "--condition-on-rig", "--seed", "3"]
    assert run(tmp_path, TARGETS[2], "--rig", RIG, *FEW, *options) == 0
    data = json.loads((tmp_path / "poses.json").read_bytes())
    assert data["settings"] == {
        "seed": 3,
        "draws": 100,
        "robust_dof": 4.0,
        "condition_on_rig": True,
        "both_sides": True,
    }
    assert data["records"][0]["posterior"]["robust"] == 4
    assert all(option in data["provenance"]["command"] for option in options)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([TARGETS[0], "--rig", "no.toml"], "no.toml"),
        ([TARGETS[0], "--rig", RIG, "--draws", "0"], "draws"),
        ([TARGETS[0], "--rig", RIG, "--seed", "-1"], "seed"),
        ([TARGETS[0], "--rig", RIG, "--robust", "0"], "robust"),
        ([TARGETS[0], "--rig", RIG, "--robust", "inf"], "robust"),
        ([TARGETS[0], "--rig", RIG, "--dark", "no.png"], "no.png"),
        ([TARGETS[0], "--rig", RIG, "--times", "no.csv"], "no.csv"),
        (["--rig", RIG], "INPUTS"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["report", *arguments, "-o", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert said.lower() in error.lower()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["report", "pose", "check"])
def test_a_time_that_is_none_is_one_line(command: str, tmp_path: Path):
    # In a process of its own: libraries look at the environment when they are imported.
    arguments = [command, TARGETS[0], "--rig", RIG, "-o", str(tmp_path / "out")]
    run = subprocess.run(
        [sys.executable, "-m", "planeopt", *arguments],
        env={**os.environ, "SOURCE_DATE_EPOCH": "yesterday"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert len(run.stderr.splitlines()) == 1
    assert "SOURCE_DATE_EPOCH" in run.stderr


def test_an_existing_folder_and_what_is_read_are_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "poses.json").write_text("mine", encoding="utf-8")
    assert main(["report", TARGETS[0], "--rig", RIG, "-o", str(tmp_path)]) == 1
    assert "--force" in capsys.readouterr().err
    assert run(tmp_path, str(tmp_path / "poses.json"), "--rig", RIG) == 1
    assert "would be written over" in capsys.readouterr().err
    assert (tmp_path / "poses.json").read_text(encoding="utf-8") == "mine"


@needs_chromium
def test_a_browser_shows_the_page_without_complaint_and_without_overflow(made: Made, tmp_path: Path):
    shown = show(tmp_path, (made.folder / "report.html").read_text(encoding="utf-8"))
    assert shown.complaints == ""
    assert shown.client == 1280
    assert (shown.scroll <= shown.client, shown.wide, shown.broken) == (True, 0, 0)


@needs_chromium
def test_a_browser_prints_the_page(targets: Made, tmp_path: Path):
    browse(tmp_path, targets.folder / "report.html", f"--print-to-pdf={tmp_path / 'print.pdf'}")
    pages = pypdf.PdfReader(tmp_path / "print.pdf").pages
    # A4, no page empty, and about as many as the PDF that is shipped beside it.
    assert [float(side) for side in pages[0].mediabox[2:]] == pytest.approx([595, 842], abs=1)
    assert all(page.extract_text().strip() or page.images for page in pages)
    assert len(pages) <= 1.5 * len(targets.paper.pages)


@pytest.mark.usefixtures("blank")
def test_a_sampler_that_breaks_down_costs_its_posterior_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def broken(*_: Any, **__: Any) -> None:
        raise np.linalg.LinAlgError("singular\nmatrix")

    monkeypatch.setattr("planeopt.report.examine.sample_posterior", broken)
    monkeypatch.setattr("planeopt.report.examine.plane_figure", broken)
    write_points(sparse_spot(), tmp_path / "a.csv")
    assert run(tmp_path / "out", str(tmp_path / "a.csv"), "--rig", RIG) == 0
    (record,) = json.loads((tmp_path / "out" / "poses.json").read_bytes())["records"]
    assert (record["status"], record["posterior"]) == ("ok", None)
    assert "singular matrix" in record["posterior_missing"]
    page = PageReader((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert record["posterior_missing"] in " ".join(page.words)
    assert [figure.key for figure in page.figures if not figure.table] == ["overlay", "residuals"]


@pytest.mark.usefixtures("blank")
def test_an_interrupt_while_sampling_ends_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*arguments: Any, **options: Any) -> Posterior:
        posterior = sample_posterior(*arguments, **options)
        return replace(posterior, diagnostics=replace(posterior.diagnostics, stopped=Stop.INTERRUPTED))

    monkeypatch.setattr("planeopt.report.examine.sample_posterior", interrupted)
    write_points(sparse_spot(), tmp_path / "a.csv")
    inputs = [str(tmp_path / "a.csv")] * 3
    assert main(["report", *inputs, "--rig", RIG, "--draws", "50", "-o", str(tmp_path / "out")]) == INTERRUPTED
    assert not (tmp_path / "out").exists()


def test_help_says_what_the_options_are(capsys: pytest.CaptureFixture[str]):
    assert main(["report", "--help"]) == 0
    said = capsys.readouterr().out
    for option in ("--draws", "--robust", "--both-sides", "--combine", "--sequence", "--condition-on-rig"):
        assert option in said
    assert "SOURCE_DATE_EPOCH" in said
