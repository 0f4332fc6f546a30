"""The pieces of a report: words, numbers, figures at their limits, and what many inputs say together."""

import math
from dataclasses import replace
from enum import Enum
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pypdf
import pytest
from matplotlib.figure import Figure as Drawing
from PIL import Image

from example_rig import example_rig
from planeopt import equations as eq
from planeopt.errors import InputError
from planeopt.estimation import solve
from planeopt.estimation.sequence import Positions
from planeopt.record import from_solution
from planeopt.report.batch_figures import Trend, chi2_figure, trends
from planeopt.report.build import assemble
from planeopt.report.content import Bullets, Cell, Heading, Page, Picture, Section, Table, Text
from planeopt.report.corner_figure import corner_figure
from planeopt.report.examine import Examined, Options, examine
from planeopt.report.html import to_html
from planeopt.report.pdf import to_pdf
from planeopt.report.plane_figure import magnification, opening, plane_figure
from planeopt.report.pose_figures import overlay, residuals
from planeopt.report.pose_fit import pose_fit
from planeopt.report.record import FirstOrder, Provenance, first_order, report_record
from planeopt.report.style import drawable, page_figure, picture
from planeopt.report.words import CAPTIONS, decimals, flag_sentence, number, p_text, verdict
from planeopt.rig import Beam, Camera, Rig, RigCovariance
from planeopt.solution import Flag, Solution, Status
from planeopt.spot import NoSpotReason, Spot, SpotFlag, write_points

NOISE = 0.05


def spot_on(rig: Rig, z_L: float, p: float, q: float, n: int = 60, *, seed: int = 0, arc: float = 1.0) -> Spot:
    """Boundary points of the spot on a plane, with noise across the boundary."""
    e_x, e_y = rig.laser_offset
    setup = eq.Setup(rig.focal_length, e_x, e_y, rig.require_beam().radius)
    variables = eq.SlopeVariables(None, z_L + rig.axial_shift, p, q)
    turn = np.linspace(0, 2 * np.pi * arc, n, endpoint=False)
    in_space = eq.spot_point_in_slopes(np, variables, setup, turn)
    pixels = rig.from_laser_plane(np.stack(eq.image_point(np, setup, *in_space), axis=1))
    outward = pixels - pixels.mean(axis=0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    noise = np.random.default_rng(seed).normal(0, NOISE, (n, 1))
    return Spot(pixels + noise * outward, np.full(n, NOISE))


def uncertain(rig: Rig) -> Rig:
    names = ("e_x", "e_y", "direction_x", "direction_y")
    return replace(rig, covariance=RigCovariance(names, np.diag([1e-3, 1e-3, 4e-8, 4e-8])))


def size_of(drawn: Picture) -> tuple[int, int]:
    with Image.open(BytesIO(drawn.png)) as image:
        return image.size


@pytest.mark.parametrize(
    ("sigma", "places"),
    [(None, 4), (0.0, 4), (42.0, 0), (9.96, 0), (9.94, 1), (1.0, 1), (0.0996, 2), (0.0994, 3), (2.3e-3, 4), (1e-30, 9)],
)
def test_two_digits_of_the_sigma_are_shown(sigma: float | None, places: int):
    assert decimals(sigma) == places
    if sigma is not None and 1e-8 < sigma < 10:
        shown = number(sigma, sigma).lstrip("0.").replace(".", "")
        assert len(shown) == 2


def test_p_values_are_short():
    assert [p_text(p) for p in (0.94562, 0.001, 0.00099, 3e-17)] == ["0.946", "0.001", "9.9e-04", "3.0e-17"]


@pytest.mark.parametrize("kind", [Status, Flag, SpotFlag])
def test_flags_have_their_sentences(kind: type[Enum]):
    for flag in kind:
        assert flag_sentence(flag.name.lower(), "degraded") == flag.value


def test_one_name_for_two_things_is_told_apart_by_the_status():
    assert flag_sentence("not_an_ellipse", "refused") == NoSpotReason.NOT_AN_ELLIPSE.value
    assert flag_sentence("not_an_ellipse", "degraded") == SpotFlag.NOT_AN_ELLIPSE.value
    assert "outside" in flag_sentence("outside_image", "refused")
    assert flag_sentence("unheard_of", "ok") == "unheard_of"
    for reason in NoSpotReason:
        assert flag_sentence(reason.name.lower(), "refused") == reason.value


def test_an_ok_with_remarks_does_not_say_that_there_are_none():
    assert "nothing against it" in verdict("ok", flagged=False)
    assert "nothing against it" not in verdict("ok", flagged=True)
    assert verdict("refused", flagged=True) == verdict("refused", flagged=False)


def test_captions_say_what_good_looks_like():
    assert all("Good" in caption for caption in CAPTIONS.values())


def test_residuals_are_those_of_the_fit():
    rig = example_rig()
    spot = spot_on(rig, 240.0, 0.3, -0.6)
    solution = solve(spot, rig)
    assert solution.pose is not None
    fit = pose_fit(spot, rig, solution.pose)
    assert fit is not None
    # Chi-squared of the points is computed elsewhere, at the efficient plane: a tenth of a sigma away at most.
    assert np.sum(fit.whitened**2) == pytest.approx(solution.chi2_points, abs=0.05)
    np.testing.assert_allclose(fit.judged.residuals / NOISE, fit.whitened, rtol=1e-9)
    # The signed distances, taken back along the normals, lead onto the drawn curve.
    onto = spot.points - fit.judged.residuals[:, None] * fit.judged.normals
    nearest = np.min(np.linalg.norm(onto[:, None] - fit.judged.curve, axis=2), axis=1)
    spacing = np.max(np.linalg.norm(np.diff(fit.judged.curve, axis=0), axis=1))
    assert np.all(nearest < spacing)
    outside = np.linalg.norm(spot.points - fit.judged.curve.mean(axis=0), axis=1) > np.linalg.norm(
        onto - fit.judged.curve.mean(axis=0), axis=1
    )
    np.testing.assert_array_equal(outside, fit.judged.residuals > 0)


RIGS = {
    "example": example_rig(),
    "uncertain": uncertain(example_rig()),
    "on the axis": replace(example_rig(), beam=Beam(6.0, (0.0, 0.0), (0.0, 0.0, 1.0))),
    "at its own radius": replace(example_rig(), beam=Beam(6.0, (6.0, 0.0), (0.0, 0.0, 1.0))),
}


@pytest.mark.parametrize(
    ("name", "z_L", "p", "q", "n"),
    [
        ("example", 200.0, 0.0, 0.0, 60),
        ("uncertain", 230.0, -0.4, 0.1, 5),
        ("on the axis", 150.0, 2.5, -1.0, 60),
        ("at its own radius", 1000.0, 0.5, 0.1, 400),
    ],
)
def test_figures_of_a_pose_are_drawn_whatever_it_is(name: str, z_L: float, p: float, q: float, n: int):
    rig = RIGS[name]
    spot = spot_on(rig, z_L, p, q, n)
    solution = solve(spot, rig)
    assert solution.pose is not None
    fit = pose_fit(spot, rig, solution.pose)
    assert fit is not None
    image = np.zeros((720, 960, 3), np.uint8)
    for drawn in (
        plane_figure(rig, solution),
        overlay(None, spot, fit.judged, "points", posed=True),
        overlay(image, spot, None, "image", posed=False),
        residuals(spot, fit),
    ):
        assert drawn is not None
        width, height = size_of(drawn)
        assert width / height == pytest.approx(drawn.width / drawn.height, rel=0.01)


def test_of_two_planes_the_heavier_is_drawn_and_both_are_told(tmp_path: Path):
    camera = Camera((4000, 4000), 5000.0, 5000.0, 1500.0, 1000.0, (0.0, 0.0, 0.0, 0.0, 0.0), 0.005)
    rig = Rig(camera, Beam(10.0, (30.0, 40.0), (0.0, 0.0, 1.0)))
    # Its second plane is tilted by 82 deg, within the prior's bounds.
    write_points(spot_on(rig, 215.0, 0.9, 1.2), tmp_path / "two.csv")
    one = examine(tmp_path / "two.csv", rig, Options(draws=300, both_sides=True))
    assert one.record.posterior is not None
    first, second = one.record.posterior.modes
    assert first.lit_side
    assert not second.lit_side
    titles = {figure.key: figure.title for figure in one.figures}
    assert titles["corner"].endswith("of the heavier plane")
    page = to_html(assemble([one], rig, CAME, Options(draws=300, both_sides=True)).page)
    assert f"z_L = {second.plane[0]:.4f} mm" in page
    assert "from behind, through the plane" in page


def test_no_plane_no_picture_of_it():
    assert plane_figure(example_rig(), Solution(Status.NO_PLANE, "", "", "")) is None


def test_a_normal_that_may_point_anywhere_is_drawn():
    rig = example_rig()
    solution = solve(spot_on(rig, 240.0, 0.3, -0.6), rig)
    assert solution.uncertainty is not None
    wide = replace(solution.uncertainty, normal_spot=1e3 * np.eye(3))
    assert plane_figure(rig, replace(solution, uncertainty=wide)) is not None
    assert plane_figure(rig, replace(solution, uncertainty=None)) is not None


def test_magnification_is_round_and_never_below_one():
    assert magnification(1.0) == 1.0
    for size in 10.0 ** np.linspace(-9, -0.7, 50):
        times = magnification(size)
        assert f"{times:.6e}"[0] in "125"
        assert times * size <= math.radians(14.0) * (1 + 1e-6)
    assert all(magnification(a) >= magnification(b) for a, b in pairwise(10.0 ** np.linspace(-9, 0, 40)))
    # 5.99 is the 95 % quantile of chi-squared with two degrees of freedom.
    assert opening(np.diag([4e-6, 1e-6, 0.0])) == pytest.approx(2e-3 * math.sqrt(5.991), rel=1e-3)


@pytest.mark.parametrize(("n", "spread", "known"), [(3, 1e-7, True), (50, 1e-2, False), (2000, 30.0, True)])
def test_corner_plots_of_few_and_many_draws(n: int, spread: float, known: bool):
    rng = np.random.default_rng(5)
    sigma = np.array([spread, 1e-3, 0.4])
    samples = np.array([250.0, 0.2, -1.0]) + sigma * rng.standard_normal((n, 3))
    samples[0, 0] += 20 * spread
    middle, covariance = (np.array([250.0, 0.2, -1.0]), np.diag(sigma**2)) if known else (None, None)
    drawn = corner_figure(samples, middle, covariance)
    assert size_of(drawn)[0] > 1000


def test_trends_are_drawn_with_gaps_and_with_nothing():
    nan = math.nan
    some = Trend("z (mm)", [1.0, nan, 3.0], [0.9, nan, 2.0], [1.1, nan, 5.0])
    none = Trend("beta (deg)", [nan] * 3, [nan] * 3, [nan] * 3)
    assert size_of(trends([1, 2, 5], "image", [some, none], [False, False, True]))[0] > 1000
    assert size_of(trends([0.0, 1.5, 2.5], "time, s", [some], [False] * 3))[0] > 1000
    assert size_of(trends([1], "image", [Trend("z", [1.0], [1.0], [1.0])], [False]))[0] > 1000


@pytest.mark.parametrize("p_values", [[0.5], [1.0, 0.0], [1e-300, 0.2, 0.9], list(np.linspace(0.01, 0.99, 40))])
def test_chi_squared_is_drawn_for_any_p(p_values: list[float]):
    assert size_of(chi2_figure(range(1, len(p_values) + 1), p_values))[0] > 1000


def test_figures_repeat_byte_for_byte_and_leave_matplotlib_as_it_was():
    style = dict(mpl.rcParams)
    first, second = (chi2_figure([1, 2], [0.3, 0.6]).png for _ in range(2))
    assert first == second
    assert dict(mpl.rcParams) == style


def test_letters_that_the_font_lacks_do_no_harm():
    assert drawable("Ω 図.png") == "Ω ?.png"
    with page_figure(3, 2) as figure:
        figure.text(0.1, 0.5, drawable("図"))
        assert isinstance(figure, Drawing)
        assert size_of(picture(figure, "a name"))[0] > 100


NASTY = "<script>alert(1)</script> & \"quotes\" 'both' 図 \u202e"


def page_of(*blocks: Text | Table | Bullets | Heading) -> Page:
    sections = (Section("one", NASTY, tuple(blocks), "degraded"), Section("two", "short", (Text("end"),)))
    return Page(NASTY, NASTY, sections)


def test_names_are_text_wherever_they_stand():
    cells = (Cell(NASTY, link="two"), Cell("1.5"))
    page = page_of(Text(NASTY, "error"), Bullets((NASTY,)), Heading(NASTY), Table(NASTY, ("", NASTY), (cells,), NASTY))
    html = to_html(page)
    assert "<script" not in html
    assert html.count("&lt;script&gt;") >= 8
    assert to_pdf(page, "2026-01-02T03:04:05Z").startswith(b"%PDF-")


def test_a_long_table_goes_over_pages_and_a_wide_word_fits():
    rows = tuple((Cell("x" * 300), Cell(str(i)), Cell("-1.2345 to 1.2345")) for i in range(150))
    table = Table("many", ("input", "number", "interval"), rows)
    first = to_pdf(page_of(table), "2026-01-02T03:04:05Z")
    assert first == to_pdf(page_of(table), "2026-01-02T03:04:05Z")
    pages = [page.extract_text() for page in pypdf.PdfReader(BytesIO(first)).pages]
    assert len(pages) > 5
    assert all(f"page {i} of {len(pages)}" in " ".join(text.split()) for i, text in enumerate(pages, start=1))
    # The table's head is repeated.
    assert sum("interval" in text for text in pages) >= 5
    assert b"D:20260102030405" in first


def test_parts_of_sigma_add_up_and_the_calibrations_is_unknown_without_a_covariance():
    for rig in (example_rig(), uncertain(example_rig())):
        found = first_order(solve(spot_on(rig, 240.0, 0.3, -0.6), rig))
        for name in FirstOrder.__struct_fields__:
            share = getattr(found, name)
            if rig.covariance is None:
                assert (share.sigma, share.calibration) == (share.spot, None)
            else:
                assert share.sigma == pytest.approx(math.hypot(share.spot, share.calibration))
                assert share.calibration > 0
    assert first_order(Solution(Status.NO_PLANE, "", "", "")) == FirstOrder()


def examined(name: str, solution: Solution) -> Examined:
    record = report_record(
        from_solution(name, solution), first_order=first_order(solution), posterior=None, missing="-", comparison=()
    )
    return Examined(record, solution, ())


CAME = Provenance(
    versions={}, rig_file="rig.toml", rig_sha256="0" * 64, command="-", seed=0, time="2026-01-02T03:04:05Z"
)


def test_many_inputs_are_summarised_by_their_places():
    rig = example_rig()
    solutions = [solve(spot_on(rig, 240.0 + 2 * i, 0.3, -0.6, seed=i), rig) for i in range(6)]
    lost = Solution(Status.NO_PLANE, "none", "Constrained", "Ipopt")
    moved = replace(rig, beam=Beam(6.0, (24.0, 15.8), rig.require_beam().direction))
    wrong = solve(spot_on(moved, 240.0, 0.3, -0.6), rig)
    assert wrong.status is Status.INCONSISTENT
    inputs = [examined(f"{i}.png", one) for i, one in enumerate([*solutions, lost, wrong])]
    report = assemble(
        inputs, rig, CAME, Options(draws=None), combined=True, positions=Positions(tuple(map(float, range(8))))
    )
    summary = report.file.summary
    assert summary.counts == {"degraded": 1, "ok": 6, "refused": 1}
    assert summary.outliers == (7,)
    assert summary.drift is not None
    assert summary.drift.state == "degraded"
    assert summary.combined is not None
    assert summary.sequence is not None
    assert [trend.name for trend in summary.sequence.trends][:3] == ["z_L", "p", "q"]
    assert summary.sequence.positions == tuple(map(float, range(8)))
    words = " ".join(
        item
        for block in report.page.blocks()
        for item in ([block.text] if isinstance(block, Text) else block.items if isinstance(block, Bullets) else [])
    )
    assert "image 8, 7.png" in words
    assert summary.drift.verdict in words
    assert to_html(report.page).count("<section") == 10


def test_nothing_to_report_on_and_positions_that_do_not_fit_are_refused():
    rig = example_rig()
    with pytest.raises(InputError, match="at least one"):
        assemble([], rig, CAME, Options())
    one = examined("a", Solution(Status.NO_PLANE, "none", "", ""))
    with pytest.raises(InputError, match="position"):
        assemble([one], rig, CAME, Options(), positions=Positions((1.0, 2.0)))
    # Inputs without any plane still make a report.
    report = assemble([one, one], rig, CAME, Options(draws=None), combined=True)
    assert report.file.summary.combined is None
    assert report.file.summary.drift is not None
    assert report.file.summary.drift.state == "untested"
    assert report.pdf.startswith(b"%PDF-")
