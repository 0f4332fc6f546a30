"""Tables of a calibration's page, made from the plain values of `calibration.json`: page and file say the same."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from planeopt.report.calibration_words import CAPTIONS, NAMES, TERMS
from planeopt.report.cells import DASH, cell, chance, pair, value_at
from planeopt.report.content import Cell, Table, Tone
from planeopt.report.words import decimals, fixed, number

Data = Mapping[str, Any]

STATES: dict[str, Tone] = {"ok": "ok", "warn": "degraded", "refuse": "refused"}


def digits(data: Data, key: str, count: int = 3) -> Cell:
    """Return the number at a key with so many significant digits; whole numbers of more digits as they are."""
    value = value_at(data, key)
    if value is None:
        return DASH
    if value and abs(value) < _TINY:
        return Cell(f"{value:.{count - 1}e}", key)
    power = math.floor(math.log10(abs(value))) if value else 0
    return cell(data, key, 0 if float(value).is_integer() else max(count - 1 - power, 0))


_TINY = 1e-4


def images(data: Data) -> Table:
    """Return what became of each image."""
    rows = []
    for i, image in enumerate(data["images"]):
        reasons = [text for text in (image["reason"], image["spot_reason"]) if text]
        used = image["status"] == "ok"
        board = Cell("used" if used else "refused", tone="ok" if used else "refused")
        rows.append(
            (
                Cell(image["name"]),
                board,
                Cell(_SPOTS[image["spot_status"]]),
                cell(data, f"images.{i}.n_corners", 0),
                Cell(" ".join(str(text) for text in reasons)),
            )
        )
    columns = ("image", "board", "spot", "corners", "")
    return Table(
        "What became of each image", columns, tuple(rows), CAPTIONS["images"], words=3, last_in_words=True, key="images"
    )


_SPOTS = {"ok": "measured", "refused": "refused", "none": "-"}


def parameters(data: Data) -> Table:
    """Return the parameters with their intervals, and what they would be with all observations."""
    places = [f"adjustment.parameters.{i}" for i in range(len(data["adjustment"]["parameters"]))]
    places += [f"adjustment.derived.{i}" for i in range(len(data["adjustment"]["derived"]))]
    before = {one["name"]: i for i, one in enumerate(data["adjustment"]["with_all"])}
    rows = []
    for at in places:
        one = value_at(data, at)
        count = decimals(one["sigma"])
        row = [Cell(_named(one["name"])), cell(data, f"{at}.value", count)]
        row += [_sigma(data, f"{at}.sigma"), pair(data, f"{at}.low95", f"{at}.high95", count)]
        if before:
            old = before.get(one["name"])
            row.append(DASH if old is None else cell(data, f"adjustment.with_all.{old}.value", count))
        rows.append(tuple(row))
    columns = ("", "value", "sigma", "95 % interval", *(("with all observations",) if before else ()))
    return Table("Values and intervals", columns, tuple(rows), CAPTIONS["parameters"], key="parameters")


def _named(name: str, names: Mapping[str, str] = NAMES) -> str:
    return names.get(name, name)


def _sigma(data: Data, key: str) -> Cell:
    return cell(data, key, decimals(value_at(data, key)))


def noise(data: Data) -> Table:
    """Return how well the model describes the observations."""
    at = "adjustment.noise"
    rows = []
    for label, key, style in (
        ("standard deviation of a corner's coordinate (px)", "corner_sigma_px", 3),
        ("that over what was stated", "corner_factor", 3),
        ("factor of the stated sigma of the spots' boundaries", "spot_factor", 3),
        ("corners used", "corners", 0),
        ("corners left out by rule", "corners_left_out", 0),
        ("spots used", "spots", 0),
        ("spots left out by rule", "spots_left_out", 0),
    ):
        rows.append((Cell(label), digits(data, f"{at}.{key}", style or 1)))
    rows.append((Cell("condition of the scaled equations"), digits(data, "adjustment.condition")))
    return Table("Noise and conditioning", ("", ""), tuple(rows), CAPTIONS["with_all"], key="noise")


def tests(data: Data, at: str, names: Sequence[str], title: str, key: str) -> Table:
    """Return tests of models against each other; `at` holds them, `names` are their keys or places in it."""
    rows = []
    for name in names:
        one, here = value_at(data, f"{at}.{name}"), f"{at}.{name}"
        degrees = Cell(f"{fixed(one['dof'][0], 0)}, {fixed(one['dof'][1], 0)}", f"{here}.dof.0 {here}.dof.1")
        focal = [_with_sigma(data, f"{here}.{which}") for which in ("smaller", "larger")]
        row = [
            Cell(_named(one["name"], TERMS)),
            Cell("yes" if one["used"] else "no"),
            digits(data, f"{here}.statistic"),
            degrees,
        ]
        rows.append((*row, chance(data, f"{here}.p_value"), *focal, Cell(one["sentence"])))
    columns = ("", "used", "F", "degrees of freedom", "p", "f without (px)", "f with (px)", "")
    return Table(title, columns, tuple(rows), CAPTIONS[key], words=2, last_in_words=True, key=key)


def _with_sigma(data: Data, at: str) -> Cell:
    """Return the focal length of a model with its standard deviation."""
    name = next((name for name in ("f", "fx") if value_at(data, f"{at}.{name}") is not None), None)
    if name is None:
        return DASH
    value, sigma = value_at(data, f"{at}.{name}")
    return Cell(f"{number(value, sigma)} ± {number(sigma, sigma)}", f"{at}.{name}.0 {at}.{name}.1")


def views(data: Data) -> Table:
    """Return the views with their residuals and poses."""
    rows = []
    seen = data["observations"]["views"]
    for i, view in enumerate(data["adjustment"]["views"]):
        at = f"adjustment.views.{i}"
        lost = sum(not kept for kept in view["corner_used"])
        spot = "-" if not view["spot_residuals_px"] else "used" if view["spot_used"] else "left out"
        rows.append(
            (
                Cell(str(i + 1)),
                Cell(seen[i]["name"]),
                Cell(f"{len(seen[i]['ids'])}" + (f", {lost} left out" if lost else "")),
                cell(data, f"{at}.corner_rms_px", 3),
                Cell(spot),
                cell(data, f"{at}.spot_rms_px", 3),
                cell(data, f"{at}.spot_chi2", 1),
                cell(data, f"{at}.depth_mm", 1),
                cell(data, f"{at}.tilt_deg", 1),
                cell(data, f"{at}.direction_deg", 0),
            )
        )
    columns = ("", "view", "corners", "RMS (px)", "spot", "RMS (px)", "chi-squared", "depth (mm)", "tilt", "towards")
    return Table("Views", columns, tuple(rows), CAPTIONS["views"], words=2, key="views")


def costs(data: Data) -> Table:
    """Return what the calibration costs planes."""
    rows = []
    for i in range(len(data["cost"])):
        at = f"cost.{i}"
        tilt = [cell(data, f"{at}.{name}", 0) for name in ("z_L_mm", "alpha_deg", "beta_deg")]
        sigmas = [
            digits(data, f"{at}.{kind}_{quantity}")
            for quantity in ("z_L_mm", "normal_deg")
            for kind in ("sigma", "independent", "offset")
        ]

        rows.append((*tilt, *sigmas))
    columns = (
        "z_L (mm)",
        "tilt",
        "beta",
        "sigma of z_L (mm)",
        "if independent",
        "e_x, e_y alone",
        "sigma of the normal (deg)",
        "if independent",
        "e_x, e_y alone",
    )
    return Table("What the calibration costs", columns, tuple(rows), CAPTIONS["costs"], words=0, key="costs")


def folds(data: Data) -> Table:
    """Return the predictions of what had no say."""
    rows = []
    for i, fold in enumerate(data["held_out"]["folds"]):
        at = f"held_out.folds.{i}"
        rows.append(
            (
                Cell(_some(fold["views"])),
                cell(data, f"{at}.error_px", 3),
                cell(data, f"{at}.expected_px", 3),
                cell(data, f"{at}.spot_error_px", 3),
                cell(data, f"{at}.spot_expected_px", 3),
                cell(data, f"{at}.largest_shift", 2),
                Cell(_named(fold["parameter"] or "-")),
            )
        )
    columns = ("left out", "corners (px)", "expected", "spots (px)", "expected", "largest shift (sigma)", "of")
    return Table("Folds", columns, tuple(rows), CAPTIONS["held_out"], last_in_words=True, key="held_out")


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_SHOWN])
    return shown if len(names) <= _SHOWN else f"{shown} and {len(names) - _SHOWN} more"


_SHOWN = 6
