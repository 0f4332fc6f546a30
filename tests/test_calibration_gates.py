"""Sessions that must be refused or warned of, with the right reason, and good ones that must pass."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from calibrated import FLAT, good, good_session
from planeopt.board import Observations
from planeopt.calibration.adjustment import adjust
from planeopt.calibration.equations import AdjustmentError
from planeopt.calibration.gate import Gate, verdict
from planeopt.calibration.gates import hopelessly_frontal, judge, judge_unadjusted
from planeopt.calibration.gates_poses import tilt_directions
from planeopt.calibration.gates_seen import image_gate
from planeopt.calibration.mixture import mixture
from planeopt.calibration.model import Model
from planeopt.calibration.packed import Packed
from planeopt.calibration.projection import linear_corners
from planeopt.errors import InputError
from planeopt.simulation import board_faults
from planeopt.simulation.board_random import Shooting, random_session
from planeopt.simulation.board_sessions import SimulatedSession


def judged(observations: Observations) -> tuple[Gate, ...]:
    """Adjust a session and judge it, as `calibrate` does."""
    if hopelessly_frontal(observations):
        return judge_unadjusted(observations, reason="All views are frontal")
    beam = "free" if any(view.spot is not None for view in observations.views) else "none"
    try:
        adjustment = adjust(observations, Model(beam=beam))
    except (AdjustmentError, InputError) as error:
        return judge_unadjusted(observations, reason=str(error))
    return judge(adjustment)


@cache
def gates_of_good() -> dict[str, Gate]:
    return _gates(good_session().observations)


def states(gates: tuple[Gate, ...]) -> dict[str, str]:
    return {gate.name: gate.state for gate in gates if gate.state != "ok"}


@dataclass(frozen=True)
class Image:
    name: str
    status: str = "ok"
    reason: str = ""
    marker_share: float | None = None


REFUSED: dict[str, tuple[Any, str, str]] = {
    "frontal": (board_faults.frontal_session, "tilt", "All views are frontal"),
    "one depth": (board_faults.one_depth_session, "spot distances", "one depth only"),
    "two views": (board_faults.short_session, "views", "2 views show the board: too few views"),
    "no spots": (board_faults.spotless_session, "spots", "missing in most of them"),
    "two cameras": (board_faults.mixed_session, "one camera", "two cameras"),
    "mirrored": (board_faults.mirrored_session, "mirror", "mirrored"),
}


@pytest.mark.parametrize("fault", REFUSED)
@pytest.mark.parametrize("seed", [1])
def test_degenerate_sessions_are_refused_with_the_right_reason(fault: str, seed: int):
    make, name, words = REFUSED[fault]
    gates = judged(make(seed).observations)
    status, message = verdict(gates)
    assert status == "refused"
    assert words in message
    assert next(gate for gate in gates if gate.state == "refuse").name == name


@pytest.mark.parametrize("seed", [4])
def test_squares_of_another_size_are_told_by_what_is_stated(seed: int):
    session = board_faults.wrong_scale_session(seed, 1.02, 1.02)
    radius = session.rig.require_beam().radius
    adjustment = adjust(session.observations, Model())
    assert verdict(judge(adjustment))[0] != "refused"
    status, message = verdict(judge(adjustment, expect={"radius_mm": (radius, 0.002 * radius)}))
    assert status == "refused"
    x, y = session.board.square_mm
    # The ratio comes out as well as the radius is known: to a few parts in ten thousand.
    assert "the size of the squares is wrong" in message
    stated = [float(number) for number in message.split("if it were [")[1].split("]")[0].split(", ")]
    np.testing.assert_allclose(stated, [x, y], rtol=1e-3)


def test_squares_of_another_proportion_are_told_by_the_images():
    session = board_faults.wrong_scale_session(1, 1.0, 1.01)
    gates = judged(session.observations)
    status, message = verdict(gates)
    assert status == "refused"
    assert "squares are not" in message
    found = next(gate for gate in gates if gate.name == "square proportion").value
    # 1 / 1.01 - 1, known to a few parts in ten thousand of the board's height.
    assert found == pytest.approx(0.0099, abs=1e-3)


@pytest.mark.parametrize("seed", [1])
def test_a_bowed_board_is_warned_of_and_compensated(seed: int):
    session = board_faults.bowed_session(seed)
    adjustment = adjust(session.observations, Model())
    gates = judge(adjustment)
    assert states(gates) == {"board bow": "warn"}
    status, message = verdict(gates)
    assert status == "degraded"
    assert "bowed" in message
    # 4.9 sigma: a chance of 1e-6, twice.
    for name, truth in (("f", session.rig.camera.fx), ("warp_x", 0.5), ("warp_y", 0.25)):
        assert abs(adjustment.value(name) - truth) < 4.9 * adjustment.sigma(name)


def test_frontal_views_are_told_from_tilted_ones():
    """By a camera that is hardly known: the foreshortening tells the tilt."""
    for seed in range(4):
        assert hopelessly_frontal(board_faults.frontal_session(seed).observations)
        assert not hopelessly_frontal(shots(seed, tilt_deg=(0.0, 8.0)).observations)


@pytest.mark.parametrize("seed", range(6))
def test_good_sessions_pass(seed: int):
    shooting = Shooting(10 + 2 * seed)
    session = random_session(300 + seed, shooting=shooting, warp=FLAT)
    gates = judged(session.observations)
    assert not states(gates), states(gates)
    assert verdict(gates)[0] == "ok"


def test_few_views_are_warned_of():
    session = random_session(11, shooting=Shooting(7), warp=FLAT)
    gates = judged(session.observations)
    assert states(gates)["views"] == "warn"
    assert verdict(gates)[0] == "degraded"


def test_views_of_two_cameras_are_named():
    session = board_faults.mixed_session(2, longer=1.02)
    found = mixture(adjust(session.observations, Model()))
    assert found is not None
    # Every second view is the other camera's; the larger group comes first.
    assert found.second.tolist() == [bool(index % 2) for index in range(len(session.observations.views))]
    assert found.focal[1] / found.focal[0] == pytest.approx(1.02, rel=2e-3)


def test_one_camera_is_not_two():
    assert mixture(good()) is None


def test_a_view_that_does_not_fit_is_named():
    session = good_session()
    views = list(session.observations.views)
    rng = np.random.default_rng(5)
    # 0.4 px where 0.1 px is the rule: the board moved during the exposure.
    views[4] = replace(views[4], corners=views[4].corners + 0.4 * rng.standard_normal(views[4].corners.shape))
    gates = judged(replace(session.observations, views=tuple(views)))
    warned = {gate.name: gate.sentence for gate in gates if gate.state == "warn"}
    assert views[4].name in warned["single views"]


def test_scattered_corners_are_warned_of_and_refused():
    session = good_session()

    def noisy(sigma: float) -> str:
        again = replace(session, corner_sigma=sigma).again(3)
        return states(judged(again.observations)).get("residuals", "ok")

    assert [noisy(sigma) for sigma in (0.3, 0.7, 1.5)] == ["ok", "warn", "refuse"]


def test_outliers_are_told_with_what_they_change():
    session = good_session()
    views = list(session.observations.views)
    moved = views[0].corners.copy()
    moved[3] += [6.0, -4.0]
    views[0] = replace(views[0], corners=moved)
    gates = judged(replace(session.observations, views=tuple(views)))
    gate = next(gate for gate in gates if gate.name == "outliers")
    assert gate.state == "ok"
    assert gate.value == pytest.approx(1 / sum(len(view) for view in views))
    assert "with all" in gate.sentence


def test_the_reason_of_most_images_is_the_sessions():
    images = [Image(f"view{n}.png", "refused", "The image is mirrored. Marker 3 reads backwards.") for n in range(8)]
    enough_left = image_gate([*images, *(Image(f"more{n}.png") for n in range(12))])
    assert enough_left is not None
    assert enough_left.state == "warn"
    images += [Image("view8.png"), Image("view9.png", "refused", "No marker was found.")]
    gate = image_gate(images)
    assert gate is not None
    assert gate.state == "refuse"
    assert "mirrored" in gate.sentence
    assert "9 of 10" in gate.sentence
    assert verdict([gate, Gate("views", "refuse", 1.0, (10, 5), "too few")])[1] == gate.sentence


def test_a_single_bad_image_is_no_reason_to_warn():
    gate = image_gate([Image("a.png", "refused", "Blank."), *(Image(f"{n}.png") for n in range(11))])
    assert gate is not None
    assert gate.state == "ok"
    assert "Blank" in gate.sentence
    assert image_gate([]) is None


def test_tilt_directions_are_counted_by_what_lies_apart():
    def directions(*azimuths: float) -> int:
        tilt = np.radians(30)
        normals = [[np.sin(tilt) * np.cos(a), np.sin(tilt) * np.sin(a)] for a in np.radians(azimuths)]
        rotations = np.zeros((len(azimuths), 3, 3))
        rotations[:, :2, 2], rotations[:, 2, 2] = normals, np.cos(tilt)
        return tilt_directions(replace(good().state, rotations=rotations, translations=np.zeros((len(azimuths), 3))))

    assert directions(0, 90, 180, 270) == 4
    assert directions(350, 10) == 1
    assert directions(0, 40, 80) == 2
    assert directions(10, 55, 100, 145, 190, 235, 280, 325) == 8


def test_a_symptom_names_its_cause_first():
    cause = Gate("tilt", "warn", 1.0, (5, None), "Tilt more.")
    symptom = Gate("focal length", "refuse", 0.02, (0.003, 0.01), "f is not known.", symptom=True)
    assert verdict([cause, symptom]) == ("refused", "Tilt more. f is not known.")
    assert verdict([cause]) == ("degraded", "Tilt more.")
    own = Gate("mirror", "refuse", 1.0, (0, 0), "Mirrored.")
    assert verdict([cause, own, symptom]) == ("refused", "Mirrored.")


def test_all_gates_are_json_and_sentences():
    for gate in judge(good(), expect={"radius_mm": (good().value("radius"), 0.1)}):
        assert gate.state in ("ok", "warn", "refuse")
        assert gate.value is None or np.isfinite(gate.value)
        assert len(gate.limits) == 2
        assert gate.sentence.endswith(".")
        assert "nan" not in gate.sentence


@pytest.mark.parametrize("name", ["colour", "f_mm"])
def test_what_is_stated_must_be_there(name: str):
    adjustment = replace(good(), observations=replace(good().observations, pixel_pitch_mm=None))
    with pytest.raises(InputError, match="expect"):
        judge(adjustment, expect={name: (1.0, 0.1)})


def test_a_wrong_focal_length_is_not_blamed_on_the_squares():
    adjustment = replace(good(), observations=replace(good().observations, pixel_pitch_mm=0.005))
    stated = 1.1 * 0.005 * adjustment.value("f")
    status, message = verdict(judge(adjustment, expect={"f_mm": (stated, 0.1)}))
    assert status == "refused"
    assert "pixel_pitch_mm" in message


def test_a_session_without_a_beam_has_no_gates_of_the_beam():
    observations = replace(
        good_session().observations,
        views=tuple(replace(view, spot=None) for view in good_session().observations.views),
        spot="none",
    )
    assert not {gate.name for gate in judged(observations)} & {"spots", "spot distances", "spot residuals"}


def shots(seed: int, **shooting: Any) -> SimulatedSession:
    return random_session(seed, shooting=Shooting(12, **shooting), warp=FLAT)


def test_little_tilt_and_little_depth_are_warned_of():
    assert "tilt" in states(judged(shots(3, tilt_deg=(0.0, 15.0)).observations))
    assert states(judged(shots(3, depth_ratio=1.25).observations)).get("spot distances") == "warn"


def _displaced(session: SimulatedSession, offsets: np.ndarray) -> Observations:
    """Corners of a board whose places are off by (K, 3), mm, to first order, seen with the session's noise."""
    state = adjust(session.observations, Model(distortion="k3")).state
    packed = Packed.of(session.observations)
    by_place = linear_corners(session.board, packed.corners, state).pose[..., 3:]
    moved = np.einsum("vkci,vij,kj->vkc", by_place.reshape(len(packed), -1, 2, 3), state.rotations, offsets)
    views = tuple(
        replace(view, corners=view.corners - moved[row, view.ids])
        for row, view in enumerate(session.observations.views)
    )
    return replace(session.observations, views=views)


def _gates(observations: Observations) -> dict[str, Gate]:
    return {gate.name: gate for gate in judge(adjust(observations, Model(distortion="k3")))}


def test_a_board_that_is_twisted_or_misprinted_is_named_and_not_two_cameras():
    session = good_session()
    u, v = ((2 * session.board.corners / session.board.size_mm) - 1).T
    size = max(session.board.size_mm)
    twist = np.stack([0 * u, 0 * u, 2e-3 * size * u * v], axis=1)
    misprint = np.random.default_rng(0).normal(0, 5e-4 * size, (len(u), 3)) * [1, 1, 0]
    for offsets, along in ((twist, "out of it"), (misprint, "in its plane")):
        gates = _gates(_displaced(session, offsets))
        assert gates["board shape"].state == "warn", along
        assert gates["one camera"].state == "ok"
    assert gates_of_good()["board shape"].state == "ok"


def test_a_laser_that_moved_in_the_session_is_warned_of():
    session = good_session()
    beam = session.rig.require_beam()
    # A twentieth of the radius: far more than the boundaries' noise, far less than half a pixel or so.
    off = replace(beam, offset=(beam.offset[0] + beam.radius / 20, beam.offset[1]))
    moved = replace(session, rig=replace(session.rig, beam=off)).again(5)
    half = len(session.observations.views) // 2
    views = (*session.observations.views[:half], *moved.observations.views[half:])
    gates = _gates(replace(session.observations, views=views))
    assert gates["one beam"].state == "warn"
    assert gates["one camera"].state == "ok"
    assert gates_of_good()["one beam"].state == "ok"


def test_the_verdict_names_what_brings_a_symptom_about():
    lost = Gate("coverage", "warn", 0.4, (0.5, None), "Coverage.")
    two = Gate("one camera", "warn", 0.004, (0.0, 0.01), "Two cameras.")
    scatter = Gate("residuals", "refuse", 3.0, (0.5, 1.0), "Scatter.", symptom=True)
    assert verdict((lost, two, scatter)) == ("refused", "Two cameras. Scatter.")
    assert verdict((lost, scatter)) == ("refused", "Scatter.")
