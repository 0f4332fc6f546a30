"""`planeopt spot`: files, records, options, exit status, and the picture."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import matplotlib.image
import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from example_rig import RIG_FILE, TARGETS, example_rig
from planeopt.batch import measure_spot
from planeopt.cli import main
from planeopt.cli.spot import names_of
from planeopt.report import refusal_picture, spot_overlay
from planeopt.rig import SpotDefinition, save_rig
from planeopt.spot import NoSpotReason, Spot, SpotFlag, SpotNotFound, read_image, read_points
from planeopt.spot.fitted import ellipse_of, fit_ellipse
from planeopt.spot.record import HARMLESS, SpotRecord, no_spot, spot_record, unusable
from spot_scene import Scene

FILES = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
RIG = ["--rig", str(RIG_FILE)]


def disc(path: Path, **changes: Any) -> Path:
    cv2.imwrite(str(path), Scene(**changes).image(2.0))
    return path


def black(path: Path) -> Path:
    cv2.imwrite(str(path), np.zeros((110, 120), np.uint8))
    return path


def records_in(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "spots.jsonl").read_text("ascii").splitlines()]


def one_complaint(captured: str, *words: str) -> None:
    assert captured.count("\n") == 1, captured
    assert captured.startswith("planeopt: ")
    for word in words:
        assert word in captured


def test_an_image_gives_its_points_its_picture_and_its_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main(["spot", str(TARGETS[4]), *RIG, "-o", str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "target04.png" in captured.out
    assert sorted(path.name for path in out.iterdir()) == ["spots.jsonl", "target04.csv", "target04.png"]
    (record,) = records_in(out)
    assert (record["input"], record["status"]) == (str(TARGETS[4]), "ok")
    assert (record["points_file"], record["picture_file"]) == ("target04.csv", "target04.png")
    points = read_points(out / "target04.csv")
    assert points.sigma is not None
    assert record["n_points"] == len(points)
    assert record["sigma_px"] == np.median(points.sigma)
    assert record["full_scale"] == 255
    fitted = ellipse_of(points)
    assert fitted is not None
    assert record["ellipse"]["semi_axes_px"] == fitted.semi_axes.tolist()
    picture = matplotlib.image.imread(out / "target04.png")
    assert picture.shape[0] > 600
    assert picture.shape[1] > 900


def test_its_points_give_the_pose_of_the_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["spot", str(TARGETS[4]), *RIG, "-o", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    assert main(["pose", str(TARGETS[4]), str(tmp_path / "out" / "target04.csv"), *RIG]) == 0
    image, points = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert image["z_L_mm"] == points["z_L_mm"]


def test_without_a_rig(tmp_path: Path):
    assert main(["spot", str(disc(tmp_path / "a.png")), "-o", str(tmp_path / "out")]) == 0
    (record,) = records_in(tmp_path / "out")
    scene = Scene()
    sigma = record["ellipse"]["sigma"]
    # 4.9 standard deviations: one in a million for each of the five.
    np.testing.assert_array_less(
        np.abs(np.subtract(record["ellipse"]["centre_px"], scene.centre)), 4.9 * np.array(sigma["centre_px"])
    )
    np.testing.assert_array_less(
        np.abs(np.subtract(record["ellipse"]["semi_axes_px"], scene.semi_axes)), 4.9 * np.array(sigma["semi_axes_px"])
    )
    assert abs(record["ellipse"]["angle_deg"] - np.degrees(scene.angle)) < 4.9 * sigma["angle_deg"]


def test_every_outcome_is_recorded_in_order_and_costs_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "words.png").write_text("these are words")
    images = [disc(tmp_path / "a.png"), tmp_path / "words.png", black(tmp_path / "b.png"), disc(tmp_path / "c.jpg")]
    assert main(["spot", *map(str, images), "-o", str(tmp_path / "out")]) == 1
    captured = capsys.readouterr()
    complaint, tally = captured.err.splitlines()
    assert complaint.startswith(f"planeopt: {tmp_path / 'words.png'}: ")
    assert tally == "planeopt: 4 inputs: 1 degraded, 1 error, 1 ok, 1 refused; each record's message says why"
    records = records_in(tmp_path / "out")
    assert [record["input"] for record in records] == [str(image) for image in images]
    assert [record["status"] for record in records] == ["ok", "error", "refused", "degraded"]
    assert records[2]["flags"] == ["too_dark"]
    assert records[2]["sentences"] == [NoSpotReason.TOO_DARK.value]
    assert records[3]["flags"] == ["encoded"]
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"spots.jsonl", "a.csv", "a.png", "b.png", "c.csv", "c.png"}


def test_two_processes_write_what_one_does(tmp_path: Path):
    images = [str(disc(tmp_path / "a.png")), str(black(tmp_path / "b.png"))]
    digests = []
    for jobs in ("1", "2"):
        out = tmp_path / f"out{jobs}"
        assert main(["spot", *images, "-o", str(out), "--jobs", jobs]) == 2
        digests.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir()})
    assert digests[0] == digests[1]


def test_alone_and_refused_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["spot", str(black(tmp_path / "b.png")), "-o", str(tmp_path / "out")]) == 2
    one_complaint(capsys.readouterr().err, "b.png: refused: ", NoSpotReason.TOO_DARK.value)


def test_names_of_files():
    assert names_of(["x/a.png", "y/a.tif", "A.bmp", "b.png"]) == ["a", "a-2", "A-3", "b"]
    # An image that is called so keeps its name.
    assert names_of(["a.png", "a.tif", "a-2.png", "a.bmp"]) == ["a", "a-3", "a-2", "a-4"]
    assert names_of(["a.b.png", "a.png"]) == ["a.b", "a"]


def test_images_of_one_name(tmp_path: Path):
    (tmp_path / "second").mkdir()
    images = [disc(tmp_path / "a.png"), disc(tmp_path / "second" / "a.png", angle=1.2)]
    assert main(["spot", *map(str, images), "-o", str(tmp_path / "out")]) == 0
    first, second = records_in(tmp_path / "out")
    assert (first["points_file"], second["points_file"]) == ("a.csv", "a-2.csv")
    assert second["ellipse"]["angle_deg"] == pytest.approx(np.degrees(1.2), abs=1.0)


def test_existing_folder_is_refused_without_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    image, out = str(disc(tmp_path / "a.png")), tmp_path / "out"
    out.mkdir()
    (out / "other.txt").write_text("precious")
    assert main(["spot", image, "-o", str(out)]) == 1
    one_complaint(capsys.readouterr().err, "--force")
    assert main(["spot", image, "-o", str(out), "--force"]) == 0
    assert (out / "other.txt").read_text() == "precious"
    assert (out / "a.csv").exists()


@pytest.mark.parametrize("what", ["image", "dark"])
def test_no_image_is_written_over(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    image = disc(tmp_path / "a.png")
    arguments = ["spot", str(image), "-o", str(tmp_path), "--force"]
    if what == "dark":
        other = tmp_path / "other"
        other.mkdir()
        arguments = ["spot", str(shutil.copy(image, other / "b.png")), "--dark", str(tmp_path / "b.png")]
        arguments += ["-o", str(tmp_path), "--force"]
        black(tmp_path / "b.png")
    before = {path: path.read_bytes() for path in tmp_path.glob("*.png")}
    assert main(arguments) == 1
    one_complaint(capsys.readouterr().err, "would be written over")
    assert {path: path.read_bytes() for path in tmp_path.glob("*.png")} == before


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--region", "1,2,3"], "x0,y0,x1,y1"),
        (["--region", "a,b,c,d"], "x0,y0,x1,y1"),
        (["--region", "9,0,1,5"], "x0 < x1"),
        (["--region", "nan,0,1,5"], "x0 < x1"),
        (["--kind", "square"], "square"),
        (["--channel", "infrared"], "infrared"),
        (["--gamma", "-1"], "gamma"),
        (["--gamma", "nan"], "gamma"),
        (["--level", "1.5"], "level"),
        (["--camera-blur-px", "0"], "0"),
        (["--jobs", "0"], "0"),
        (["--dark", "nothing.png"], "no such image"),
        (["--rig", "nothing.toml"], "no such file"),
        (["--nonsense"], "--nonsense"),
    ],
    ids=" ".join,
)
def test_options_that_cannot_be_used(
    options: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    disc(tmp_path / "a.png")
    assert main(["spot", "a.png", "-o", "out", *options]) == 1
    captured = capsys.readouterr()
    one_complaint(captured.err, word)
    assert captured.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    ("option", "other", "own"),
    [("--kind", "ring", "disc"), ("--level", "0.4", "0.5"), ("--channel", "red", "gray"), ("--gamma", "2.2", "1.0")],
)
def test_options_that_contradict_the_rig(
    option: str, other: str, own: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_rig(replace(example_rig(), spot=SpotDefinition()), tmp_path / "rig.toml")
    arguments = ["spot", str(TARGETS[2]), "--rig", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "out")]
    assert main([*arguments, option, other]) == 1
    one_complaint(capsys.readouterr().err, option, other, own)
    if option == "--gamma":
        assert main([*arguments, option, own]) == 0


def test_a_definition_may_be_given_with_a_rig_that_has_none(tmp_path: Path):
    out = tmp_path / "out"
    assert main(["spot", str(TARGETS[2]), *RIG, "--level", "0.3", "--kind", "disc", "-o", str(out)]) == 0
    outer = records_in(out)[0]["ellipse"]["semi_axes_px"][1]
    assert main(["spot", str(TARGETS[2]), *RIG, "-o", str(out), "--force"]) == 0
    assert outer > records_in(out)[0]["ellipse"]["semi_axes_px"][1]


def test_gamma_undoes_the_response_and_the_flag(tmp_path: Path):
    light = Scene().clean() / 255
    cv2.imwrite(str(tmp_path / "a.jpg"), np.rint(255 * light ** (1 / 2.2)), [cv2.IMWRITE_JPEG_QUALITY, 100])
    sizes = {}
    for name, options in {"as it is": [], "linear": ["--gamma", "2.2"]}.items():
        status = main(["spot", str(tmp_path / "a.jpg"), "-o", str(tmp_path / name), *options])
        (record,) = records_in(tmp_path / name)
        assert ("encoded" in record["flags"], status) == ((True, 2) if name == "as it is" else (False, 0))
        sizes[name] = record["ellipse"]["semi_axes_px"]
    # The level of half the coded height lies well outside: by several tenths of the blur of 1.2 px.
    assert sizes["as it is"][0] > Scene().semi_axes[0] + 0.2
    assert sizes["linear"] == pytest.approx(Scene().semi_axes, abs=0.03)


def test_channel_region_and_dark(tmp_path: Path):
    """Two discs, one in red and one in blue, and a lamp that is on without the laser too."""
    first, second = (Scene(centre=(x, 55.8), size=(240, 110)).clean() - 30 for x in (60.3, 180.3))
    dark = np.full((110, 240), 30.0)
    cv2.circle(dark, (120, 60), 18, 160.0, -1)
    lamp = cv2.GaussianBlur(dark, (0, 0), 1.2)

    def write(name: str, image: np.ndarray) -> str:
        path = tmp_path / name
        noise = np.random.default_rng(5).normal(0, 1.5, image.shape)
        cv2.imwrite(str(path), np.clip(np.rint(image + noise), 0, 255).astype(np.uint8))
        return str(path)

    both = write("both.png", np.dstack([second + 30, np.full_like(dark, 30), first + 30]))
    lit, off = write("lit.png", first / 2 + lamp), write("off.png", lamp)
    two = write("two.png", first + second + 30)

    def centre(*arguments: str) -> list[float] | None:
        assert main(["spot", *arguments, "-o", str(tmp_path / "out"), "--force"]) in (0, 2)
        return records_in(tmp_path / "out")[0]["ellipse"]["centre_px"]

    assert centre(both, "--channel", "blue") == pytest.approx([180.3, 55.8], abs=0.1)
    assert centre(two, "--region", "120,0,240,110") == pytest.approx([180.3, 55.8], abs=0.1)
    assert centre(lit, "--dark", off) == pytest.approx([60.3, 55.8], abs=0.1)


def test_a_dark_image_of_another_size_is_an_error_of_each_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros((10, 10), np.uint8))
    dark = ["--dark", str(tmp_path / "dark.png")]
    assert main(["spot", str(disc(tmp_path / "a.png")), "-o", str(tmp_path / "out"), *dark]) == 1
    one_complaint(capsys.readouterr().err, "a.png", "laser-off")
    assert main(["pose", str(TARGETS[2]), *RIG, *dark]) == 1
    one_complaint(capsys.readouterr().err, "target02.png", "laser-off")


def test_pose_subtracts_a_dark_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    image = read_image(TARGETS[2])
    lamp = np.zeros_like(image)
    cv2.circle(lamp, (250, 300), 70, 90, -1)
    lamp = np.asarray(cv2.GaussianBlur(lamp, (0, 0), 1.0))
    cv2.imwrite(str(tmp_path / "lit.png"), cv2.add(image, lamp))
    cv2.imwrite(str(tmp_path / "dark.png"), lamp)
    assert main(["pose", str(tmp_path / "lit.png"), *RIG, "--dark", str(tmp_path / "dark.png")]) == 0
    assert main(["pose", str(TARGETS[2]), *RIG]) == 0
    lit, plain = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert lit["z_L_mm"] == pytest.approx(plain["z_L_mm"], abs=plain["sigma"]["z_L_mm"])


def keys_in(document: str) -> list[str]:
    section = document.split("## The spot record\n", 1)[1].split("\n## ", 1)[0]
    return [
        key for line in section.splitlines() if line[:3] == "| `" for key in re.findall(r"`(\w+)`", line.split("|")[1])
    ]


def spot_of(**changes: Any) -> Spot:
    found = measure_spot(TARGETS[0]).spot
    assert found is not None
    return replace(found, **changes)


@pytest.mark.parametrize("case", ["ok", "degraded", "refused", "error", "bare"])
def test_every_record_has_the_documented_keys(case: str):
    nine = np.stack([9 * np.cos(np.arange(9)), 6 * np.sin(np.arange(9))], axis=1)
    records = {
        "ok": lambda: spot_record("a", spot_of(), 255.0),
        "degraded": lambda: spot_record("a", spot_of(flags=(SpotFlag.SATURATED, SpotFlag.PARTIAL_ARC))),
        "refused": lambda: no_spot("a", SpotNotFound(NoSpotReason.SEVERAL, "At (1, 2)."), 255.0),
        "error": lambda: unusable("a", "a: there is no such image"),
        "bare": lambda: spot_record("a", Spot(nine)),
    }
    record = records[case]()
    assert record.status == ("ok" if case == "bare" else case)
    plain = json.loads(record.to_json())
    assert list(plain) == keys_in(FILES) == [field.name for field in msgspec.structs.fields(SpotRecord)]
    ellipse = ["centre_px", "semi_axes_px", "angle_deg"]
    assert list(plain["ellipse"]) == [*ellipse, "sigma"]
    assert list(plain["ellipse"]["sigma"]) == ellipse
    assert len(plain["flags"]) == len(plain["sentences"])
    assert plain["message"].endswith((".", "image"))
    if case == "degraded":
        assert SpotFlag.SATURATED.value in plain["message"]
    if case == "bare":
        assert plain["ellipse"]["semi_axes_px"] == pytest.approx([9, 6])
        assert plain["ellipse"]["sigma"] == dict.fromkeys(ellipse)


def test_flags_that_do_not_degrade_are_the_documented_ones():
    sentence = re.search(r"degraded` by each flag but ([^.]*)", FILES)
    assert sentence is not None
    named = set(re.findall(r"`(\w+)`", sentence[1])) | {"sigma_unknown"}  # which no image gives
    assert named == {flag.name.lower() for flag in HARMLESS}


@pytest.mark.parametrize("ratio", [1.0, 0.98, 0.4])
def test_sigmas_of_the_ellipse_are_those_of_many_draws(ratio: float):
    theta = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    rng = np.random.default_rng(11)
    clean = np.stack([40 * np.cos(theta), 40 * ratio * np.sin(theta)], axis=1)
    normal = np.stack([ratio * np.cos(theta), np.sin(theta)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sigma = np.full(80, 0.05)
    draws = []
    for _ in range(400):
        fitted = fit_ellipse(clean + rng.normal(0, 0.05, (80, 1)) * normal, sigma)
        assert fitted is not None
        assert fitted.sigma_centre is not None
        assert fitted.sigma_semi_axes is not None
        draws.append((fitted, np.concatenate([fitted.sigma_centre, fitted.sigma_semi_axes])))
    first, deviations = draws[0]
    values = np.array([np.concatenate([fitted.centre, fitted.semi_axes]) for fitted, _ in draws])
    # The standard deviation of 400 draws is known to 3.5 %: four of those. The axes of a circle are sorted by size,
    # so that their spread is another.
    known = slice(0, 2 if ratio == 1.0 else 4)
    np.testing.assert_allclose(values.std(axis=0)[known], deviations[known], rtol=0.15)
    without_direction = sum(fitted.sigma_angle is None for fitted, _ in draws)
    if ratio == 1.0:
        # Of 400 circles noise gives four a direction, twelve at the most but for once in a thousand times.
        assert without_direction >= 388
    else:
        assert without_direction == 0
        assert first.sigma_angle is not None
        assert np.std([fitted.angle for fitted, _ in draws]) == pytest.approx(first.sigma_angle, rel=0.15)


def test_the_picture_repeats_byte_for_byte_and_leaves_matplotlib_as_it_was(tmp_path: Path):
    image, style = read_image(TARGETS[1]), dict(mpl.rcParams)
    spot = measure_spot(TARGETS[1]).spot
    assert spot is not None
    for name in ("a.png", "b.png"):
        spot_overlay(image, spot, "a", camera=example_rig().camera).savefig(tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert dict(mpl.rcParams) == style


def test_the_picture_says_what_has_to_be_known():
    flags = tuple(SpotFlag)
    spot = spot_of(rejected=np.array([[600.0, 400.0], [610.0, 420.0]]), flags=flags)
    figure = spot_overlay(read_image(TARGETS[0]), spot, "target00.png", camera=example_rig().camera)
    words = [text for axes in figure.axes for item in axes.texts for text in [" ".join(item.get_text().split())]]
    assert all(flag.value in " ".join(words) for flag in flags)
    legends = [text.get_text() for axes in figure.axes if (legend := axes.get_legend()) for text in legend.get_texts()]
    assert "2 rejected" in legends
    titles = " ".join(axes.get_title() for axes in figure.axes)
    assert re.search(r"residuals along the normals, drawn [125]0* times as long", titles)
    labels = {label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if axes.axison}
    assert all(re.search(r"\((px|deg)", label) for label in labels)
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [box for axes in figure.axes if axes.axison and (box := axes.get_tightbbox(renderer)) is not None]
    for i, one in enumerate(boxes):
        # Half a pixel less, for the rounding of the layout.
        assert not any(one.padded(-0.5).overlaps(other) for other in boxes[i + 1 :])


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((1, 1), np.uint8),
        np.full((3, 900), 7, np.uint16),
        np.full((40, 50, 4), np.nan, np.float32),
        np.random.default_rng(0).integers(0, 255, (900, 1400, 3), dtype=np.uint8),
    ],
    ids=["1x1", "flat", "nan", "colour"],
)
def test_a_refused_image_is_drawn_with_its_reason(image: np.ndarray, tmp_path: Path):
    figure = refusal_picture(image, NoSpotReason.NO_CONTRAST.value, "a.png")
    figure.savefig(tmp_path / "a.png")
    assert NoSpotReason.NO_CONTRAST.value in " ".join(figure.axes[1].texts[0].get_text().split())
