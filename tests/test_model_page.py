"""docs/model.md: its names are in the code, and its numbers are those that the code computes."""

import importlib
import re
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from planeopt import paper
from planeopt.reproduction import Reproduction, compute

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
# Names of a row that stand without the module that the row's first name has.
MODULES = ("", "plane.", "rig.", "equations.", "closed_form.", "formulations.", "solution.")


def resolves(name: str) -> bool:
    for prefix in MODULES:
        head, *rest = f"{prefix}{name}".split(".")
        for depth in range(len(rest) + 1):
            try:
                module = importlib.import_module(".".join(["planeopt", head, *rest[:depth]]))
                reduce(getattr, rest[depth:], module)
            except (ModuleNotFoundError, AttributeError):
                continue
            return True
    return False


@pytest.mark.parametrize("name", re.findall(r"`([\w.]+)`", PAGE.partition("## 11.")[2]))
def test_table_names_what_is_in_the_code(name: str) -> None:
    assert resolves(name)


def test_a_name_that_is_not_there_does_not_resolve() -> None:
    assert not resolves("equations.eq99")


@pytest.mark.parametrize("path", re.findall(r"\]\(([^)#]+)\)", PAGE))
def test_links_lead_somewhere(path: str) -> None:
    assert (ROOT / "docs" / path).exists()


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return compute()


def in_text(value: float) -> str:
    """Two digits and a power of ten, as the page writes them."""
    digits, power = f"{value:.1e}".split("e")
    return rf"{digits}\times10^{{{int(power)}}}"


def test_numbers_of_the_worked_example(result: Reproduction) -> None:
    to_degrees = np.array([1.0, 1.0, 180 / np.pi, 180 / np.pi])
    R, z_L, alpha, beta = result.answers[0].found * to_degrees
    assert f"({R:.5f}, {z_L:.5f}, {alpha:.5f}°, {beta:.5f}°)" in PAGE
    for value in result.answers[0].allowance.worst * to_degrees:
        assert in_text(value) in PAGE
    second = result.second_plane.pose
    assert second.beta is not None
    angles = np.degrees([second.alpha, second.beta])
    assert f"({second.R:.4f}, {second.z_L:.4f}, {angles[0]:.4f}°, {angles[1]:.4f}°)" in PAGE
    condition = np.linalg.cond(result.problem.B_factor) ** 2
    assert in_text(condition).replace("{9}", "9") in PAGE
    assert rf"{result.fitted_B4.value:.3f} \pm {result.fitted_B4.sigma:.3f}" in PAGE


def test_numbers_of_the_misprints() -> None:
    table = PAGE.partition("| where |")[2]
    semi_axes, a_coefficients, _, constant, table_2 = (misprint.evidence() for misprint in paper.MISPRINTS)
    expected = [
        f"{semi_axes[0].printed:.2f} as printed",
        f"{semi_axes[1].printed:.3f}$ as printed, ${semi_axes[1].right:.5f}$ corrected, ${paper.TABLE_2[0]}$",
        f"{semi_axes[3].printed:.1f} mm",
        f"{a_coefficients[0].printed:.2f}$ as printed (${a_coefficients[1].printed:.2f}$",
        f"off by {a_coefficients[2].printed:.1f}",
        f"{constant[0].printed:.0f} mm²",
        f"${table_2[0].printed}$",
        f"${table_2[0].right}$",
        f"{table_2[0].expected:.6f}",
    ]
    for words in expected:
        assert words in table
