"""docs/calibration.md: its names are in the code, its options are the command's, its formulas are what is used."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from planeopt.board import Board
from planeopt.calibration import Model
from planeopt.calibration.adjustment import adjust
from planeopt.cli import main
from planeopt.simulation.board_random import Shooting, random_session

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sorted(set(re.findall(r"\(`(\w+)`(?:, `\w+`)?[);]", PAGE))))
def test_modules_that_are_named_are_there(name: str):
    importlib.import_module(f"planeopt.calibration.{name}")


@pytest.mark.parametrize("path", re.findall(r"\]\(([^)#]+)(?:#[\w-]+)?\)", PAGE))
def test_links_lead_somewhere(path: str):
    assert (ROOT / "docs" / path).exists()


def test_options_are_the_commands(capsys: pytest.CaptureFixture[str]):
    assert main(["calibrate", "--help"]) == 0
    options = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out)) - {"--output", "--no-force"}
    named = set(re.findall(r"--[a-z][a-z-]+", PAGE.partition("## 7. Options")[2].partition("## 8.")[0]))
    assert {option for option in options if option not in ("--help", "--version")} == named


def test_the_bow_is_the_one_of_the_page():
    board = Board((9, 7), (10.0, 12.0), 7.0, "DICT_4X4_100")
    width, height = board.size_mm
    x, y = 13.0, 70.0
    expected = [1 - (2 * x / width - 1) ** 2, 1 - (2 * y / height - 1) ** 2]
    np.testing.assert_allclose(board.bow([x, y]), expected, rtol=1e-12)


def test_a_boundarys_residual_is_its_distance_from_the_beam_over_the_gradient():
    session = random_session(3, shooting=Shooting(views=10))
    found = adjust(session.observations, Model(warp=False))
    view = session.observations.views[0]
    assert view.spot is not None
    rotation, translation = found.rotations[0], found.translations[0]
    e = np.array([found.value("e_x"), found.value("e_y"), 0.0])
    d, r = found.state.direction, found.value("radius")

    def g(pixels: np.ndarray) -> np.ndarray:
        rays = np.concatenate([found.camera.normalise(pixels)[0], np.ones((len(pixels), 1))], axis=1)
        normal = rotation[:, 2]
        X = rays * (normal @ translation / (rays @ normal))[:, None]
        away = X - e
        return np.linalg.norm(away - np.outer(away @ d, d), axis=1) - r

    pixels, h = view.spot.points, 1e-3
    gradient = [(g(pixels + step) - g(pixels - step)) / (2 * h) for step in h * np.eye(2)]
    # Central differences of a smooth function at 1e-3 px: right to about 1e-9 of it, and to rounding over the step.
    expected = g(pixels) / np.hypot(*gradient)
    np.testing.assert_allclose(found.spot_residuals[0], expected, rtol=0, atol=1e-6)
