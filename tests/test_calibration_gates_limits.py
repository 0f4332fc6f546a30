"""Where the limits of the gates on conditioning come from: lenses, tilts, depths; and the null direction's words."""

from typing import Any

import numpy as np
import pytest

from calibrated import FLAT, good
from planeopt.calibration.adjustment import Adjustment, adjust
from planeopt.calibration.gates import BEAM_CONDITION, CAMERA_CONDITION
from planeopt.calibration.model import FULL, Model
from planeopt.calibration.null_direction import in_words, null_direction, null_directions
from planeopt.simulation.board_random import Shooting, random_session


def shot(seed: int, **shooting: Any) -> Adjustment:
    session = random_session(seed, shooting=Shooting(12, **shooting), warp=FLAT, corner_sigma=0.1)
    return adjust(session.observations, Model())


def camera_and_beam(adjustment: Adjustment) -> tuple[float, float]:
    camera, beam = null_directions(adjustment)
    return camera.condition, beam.condition


@pytest.mark.parametrize("seed", range(5))
def test_good_sessions_are_well_within(seed: int):
    camera, beam = camera_and_beam(good(seed))
    assert camera < 0.5 * CAMERA_CONDITION[0]
    assert beam < 0.5 * BEAM_CONDITION[0]


@pytest.mark.parametrize("seed", [1, 3])
def test_one_depth_is_beyond_and_named(seed: int):
    adjustment = shot(seed, depth_ratio=1.02)
    _, beam = null_directions(adjustment)
    assert beam.condition > BEAM_CONDITION[0]
    assert beam.words in ("the beam's offset against its direction", "the beam's direction against its offset")
    assert "distances" in beam.cure


def test_the_beam_is_told_as_the_logarithm_of_the_ratio_of_distances():
    """From which the limit of the spot's distances is taken; the extent of the spot itself helps at small ratios."""
    conditions = [camera_and_beam(shot(2, depth_ratio=ratio))[1] for ratio in (2.0, 1.5, 1.3)]
    expected = conditions[0] * np.log(2.0) / np.log([2.0, 1.5, 1.3])
    # Distances are drawn, evenly but for chance, and tilted spots are long.
    np.testing.assert_allclose(conditions, expected, rtol=0.3)


def test_little_tilt_leaves_the_focal_length_against_the_distance():
    conditions = []
    for tilt in (40.0, 6.0, 3.0):
        camera, _ = null_directions(shot(2, tilt_deg=(0.0, tilt)))
        conditions.append(camera.condition)
    assert camera.words == "the focal length against the distance of the board"
    assert "tilt" in camera.cure
    assert conditions[0] < conditions[1] < conditions[2]


def test_it_does_not_depend_on_units_nor_on_the_noise():
    session = random_session(2, shooting=Shooting(12), warp=FLAT, corner_sigma=0.1, spot_sigma=0.1)
    loud = random_session(2, shooting=Shooting(12), warp=FLAT, corner_sigma=0.2, spot_sigma=0.2)
    louder = adjust(loud.observations, Model())
    quiet = adjust(session.observations, Model())
    # The noise moves the parameters a little, and corners left out by rule differ.
    np.testing.assert_allclose(camera_and_beam(louder), camera_and_beam(quiet), rtol=0.05)


def test_the_worse_of_camera_and_beam_is_the_null_direction():
    found = null_direction(good())
    assert found.condition == max(camera_and_beam(good()))
    assert np.linalg.norm(found.vector) == pytest.approx(1.0)
    assert len(found.names) == len(found.vector)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"f": 1.0}, "the focal length against the distance of the board"),
        ({"cx": 0.8, "p2": -0.6}, "the principal point against the tangential distortion"),
        ({"cx": 1.0}, "the principal point against the tilt of the board"),
        ({"direction_x": 0.8, "e_x": -0.6}, "the beam's direction against its offset"),
        ({"f": 0.8, "warp_x": 0.6}, "the focal length against the board's bow"),
        ({"k1": 0.7, "k2": -0.7, "k3": 0.14}, "the coefficients of the radial distortion against each other"),
        ({"radius": 0.9, "divergence": -0.44}, "the beam's radius against its divergence"),
    ],
)
def test_mixes_in_words(parts: dict[str, float], words: str):
    names = ("f", *FULL[2:])
    assert in_words(names, np.array([parts.get(name, 0.0) for name in names]))[0] == words
