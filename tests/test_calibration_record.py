"""`calibration.json`: its schema, its way to disk and back, and that it holds all that the calibration started from."""

import json
import math
from dataclasses import replace
from pathlib import Path

import jsonschema
import msgspec
import numpy as np
import pytest

import planeopt.calibration
from calibration_files import calibration_file
from planeopt.board import Observations
from planeopt.calibration.adjusted import WITHIN, adjustment_record
from planeopt.calibration.adjustment import adjust
from planeopt.calibration.model import Model
from planeopt.calibration.observed import observations_from_record, observations_record
from planeopt.calibration.record import CalibrationFile, calibration_schema, load_record
from planeopt.calibration.sections import beam_sections
from planeopt.errors import InputError
from planeopt.rig import Rig, load_rig, save_rig
from planeopt.simulation.board_random import random_session


@pytest.fixture(scope="module")
def file() -> CalibrationFile:
    return calibration_file()


def same_observations(one: Observations, other: Observations) -> bool:
    if (one.board, one.image_size, one.spot, one.pixel_pitch_mm) != (
        other.board,
        other.image_size,
        other.spot,
        other.pixel_pitch_mm,
    ):
        return False
    for view, again in zip(one.views, other.views, strict=True):
        arrays = [(view.ids, again.ids), (view.corners, again.corners), (view.sigma, again.sigma)]
        if view.spot is not None and again.spot is not None:
            arrays += [(view.spot.points, again.spot.points), (view.spot.sigma, again.spot.sigma)]
        spots = (view.spot is None) == (again.spot is None)
        if view.name != again.name or not spots or not all(np.array_equal(a, b) for a, b in arrays):
            return False
    return True


def test_the_file_reads_back_equal(file: CalibrationFile, tmp_path: Path):
    text = file.to_json()
    (tmp_path / "calibration.json").write_text(text, encoding="ascii")
    again = load_record(tmp_path / "calibration.json")
    assert again == file
    assert again.to_json() == text
    # A line for each list of plain values: a tenth of the lines that indenting each number takes.
    assert max(map(len, text.splitlines())) < 20_000
    assert len(text.splitlines()) < len(json.dumps(file.to_dict(), indent=1).splitlines()) / 3


def test_the_file_is_as_its_schema_says(file: CalibrationFile):
    folder = Path(planeopt.calibration.__file__).parent
    shipped = json.loads((folder / "calibration.schema.json").read_text(encoding="utf-8"))
    assert shipped == json.loads(json.dumps(calibration_schema()))
    validator = jsonschema.Draft202012Validator(shipped)
    validator.check_schema(shipped)
    data = json.loads(file.to_json())
    validator.validate(data)
    validator.validate(json.loads(msgspec.structs.replace(file, adjustment=None, next_view=None).to_json()))
    assert not validator.is_valid(data | {"verdict": "fine"})
    assert not validator.is_valid({key: value for key, value in data.items() if key != "observations"})


def test_calculated_again_from_the_file_alone_the_rig_is_the_same(file: CalibrationFile, tmp_path: Path):
    (tmp_path / "calibration.json").write_text(file.to_json(), encoding="ascii")
    read = load_record(tmp_path / "calibration.json")
    found = adjust(observations_from_record(read), Model())
    # The same numbers go in, to the last bit: so do they come out.
    assert adjustment_record(found) == file.adjustment
    first = adjust(observations_from_record(file), Model())
    save_rig(first.rig, tmp_path / "rig.toml")
    assert load_rig(tmp_path / "rig.toml") == found.rig == first.rig


def test_observations_of_every_kind_survive(tmp_path: Path):
    session = random_session(5)
    for spot in ("disc", "ring", "none"):
        views = session.observations.views
        if spot == "none":
            views = tuple(replace(view, spot=None) for view in views)
        given = replace(session.observations, views=views, spot=spot, pixel_pitch_mm=None)
        file = msgspec.structs.replace(calibration_file(), observations=observations_record(given))
        (tmp_path / "c.json").write_text(file.to_json(), encoding="ascii")
        assert same_observations(observations_from_record(load_record(tmp_path / "c.json")), given)


def test_the_check_of_observations_would_notice():
    given = random_session(5).observations
    moved = replace(given.views[0], corners=given.views[0].corners + 1e-12)
    assert same_observations(given, given)
    assert not same_observations(given, replace(given, views=(moved, *given.views[1:])))


def test_intervals_and_angles_follow_from_values_and_covariance(file: CalibrationFile):
    found = file.adjustment
    assert found is not None
    matrix = np.array(found.covariance.matrix)
    for row, one in enumerate(found.parameters):
        assert one.sigma == pytest.approx(math.sqrt(matrix[row, row]))
        assert one.low95 == pytest.approx(one.value - WITHIN * math.sqrt(matrix[row, row]))
        assert one.high95 == pytest.approx(one.value + WITHIN * math.sqrt(matrix[row, row]))
    values = {one.name: one.value for one in (*found.parameters, *found.derived)}
    pitch = file.observations.pixel_pitch_mm
    assert pitch is not None
    assert values["f_mm"] == pytest.approx(pitch * values["f"])
    assert values["angle_mrad"] == pytest.approx(
        1e3 * math.asin(math.hypot(values["direction_x"], values["direction_y"]))
    )
    # The angles' sigmas against a Monte Carlo of the two components: 20,000 draws know a sigma to 0.5 %.
    rows = [found.covariance.parameters.index(name) for name in ("direction_x", "direction_y")]
    centre = [values["direction_x"], values["direction_y"]]
    drawn = np.random.default_rng(1).multivariate_normal(centre, matrix[np.ix_(rows, rows)], 20_000)
    z = np.sqrt(1 - np.sum(drawn**2, axis=1))
    expected = {
        "angle_x_mrad": np.arctan2(drawn[:, 0], z),
        "angle_y_mrad": np.arctan2(drawn[:, 1], z),
        "angle_mrad": np.arccos(z),
    }
    for one in found.derived:
        if one.name in expected:
            assert one.sigma == pytest.approx(1e3 * expected[one.name].std(), rel=0.03)


def test_sections_of_the_beam_lie_on_its_axis():
    session = random_session(3)
    found = adjust(session.observations, Model())
    rig: Rig = session.rig
    made = [section for section in beam_sections(found) if section is not None]
    assert len(made) == len(session.observations.views)
    pulls = []
    for section in made:
        away = (section.centre - section.axis)[:2] / section.sigma_centre
        pulls += [*away, (section.radius - rig.require_beam().radius) / section.sigma_radius]
        assert abs(section.radius - rig.require_beam().radius) < 6 * section.sigma_radius
    # 90 numbers of unit variance, less the beam's five: beyond 1.4 less often than once in a million.
    assert 0.6 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1, 2]", "must hold an object"),
        ("{", "not valid JSON"),
        ('{"format": 2}', "format 2"),
        ('{"format": 1}', "lacks the key"),
    ],
)
def test_what_is_no_calibration_is_one_line(text: str, said: str, tmp_path: Path):
    (tmp_path / "c.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        load_record(tmp_path / "c.json")
    assert "c.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_an_unknown_flag_are_named(file: CalibrationFile, tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        load_record(tmp_path / "none.json")
    view = file.observations.views[0]
    assert view.spot is not None
    odd = msgspec.structs.replace(view, spot=msgspec.structs.replace(view.spot, flags=("odd",)))
    seen = msgspec.structs.replace(file.observations, views=(odd,))
    with pytest.raises(InputError, match="odd"):
        observations_from_record(msgspec.structs.replace(file, observations=seen))
