"""Tables of a report, made from the plain values of `poses.json`, so that page and file say the same."""

from collections.abc import Mapping, Sequence
from typing import Any

from planeopt.report.cells import DASH, cell, chance, pair, value_at
from planeopt.report.content import Cell, Table
from planeopt.report.words import CAPTIONS, decimals, fixed, number

_PLAIN_DECIMALS = 4
_NAMES = {
    "z_L_mm": "depth z_L along the beam (mm)",
    "alpha_deg": "tilt alpha (deg)",
    "beta_deg": "direction beta of the tilt (deg)",
    "R_mm": "long semi-axis R of the spot (mm)",
    "p": "slope p",
    "q": "slope q",
    "normal_x": "normal, x",
    "normal_y": "normal, y",
    "normal_z": "normal, z",
    "a_mm": "intercept a (mm)",
    "b_mm": "intercept b (mm)",
    "c_mm": "intercept c (mm)",
}
_PLACES = {
    "p": "slopes.p",
    "q": "slopes.q",
    "normal_x": "normal.0",
    "normal_y": "normal.1",
    "normal_z": "normal.2",
    "a_mm": "intercepts_mm.a",
    "b_mm": "intercepts_mm.b",
    "c_mm": "intercepts_mm.c",
}
"""Where a record holds them, if not under their own name."""

_INTERVALS = {"68 %": ("low68", "high68"), "95 %": ("low95", "high95")}


def quantities(data: Mapping[str, Any], at: str, *, caption: str = CAPTIONS["quantities"]) -> Table:
    """Return the quantities of a pose with their standard deviations and intervals.

    Parameters
    ----------
    data : mapping
        The file's plain values.
    at : str
        Key of the record, or of what has its keys, in it.
    caption : str
    """
    posterior = value_at(data, f"{at}.posterior") is not None
    rows = [_quantity(data, at, name, posterior=posterior) for name in _NAMES]
    shown = [row for row in rows if row[1] is not DASH or (len(row) > _WITHOUT_POSTERIOR and row[5] is not DASH)]
    cone = _cone(data, at, posterior=posterior)
    columns = ("", "value", "sigma", "spot", "calibration")
    if posterior:
        columns = (*columns, "median", *(f"{share} interval" for share in _INTERVALS))
    return Table("Quantities", columns, (*shown, *cone), caption, key="quantities")


_WITHOUT_POSTERIOR = 5


def _quantity(data: Mapping[str, Any], at: str, name: str, *, posterior: bool) -> tuple[Cell, ...]:
    shares = f"{at}.first_order.{name}"
    inside = f"{at}.posterior.{name}"
    interval = value_at(data, inside) if posterior else None
    sigma = value_at(data, f"{shares}.sigma")
    width = sigma if interval is None else _half_width(interval)
    row = [Cell(_NAMES[name]), cell(data, f"{at}.{_PLACES.get(name, name)}", decimals(sigma or width))]
    row += _sigmas(data, shares)
    if not posterior:
        return tuple(row)
    if interval is None:
        undefined = Cell("undefined") if row[1] is not DASH or name == "beta_deg" else DASH
        return (*row, undefined, DASH, DASH)
    places = decimals(width)
    row.append(cell(data, f"{inside}.median", places))
    row += [pair(data, f"{inside}.{low}", f"{inside}.{high}", places) for low, high in _INTERVALS.values()]
    return tuple(row)


def _sigmas(data: Mapping[str, Any], shares: str) -> list[Cell]:
    """Return sigma, spot and calibration, each to two digits of its own."""
    keys = [f"{shares}.{part}" for part in ("sigma", "spot", "calibration")]
    return [cell(data, key, decimals(value_at(data, key))) for key in keys]


def _half_width(interval: Mapping[str, float]) -> float:
    """Half the 68 % interval; of a direction also across 180 deg, where its low end is the larger number."""
    width = interval["high68"] - interval["low68"]
    return (width if width >= 0 else width + 360) / 2


def _cone(data: Mapping[str, Any], at: str, *, posterior: bool) -> list[tuple[Cell, ...]]:
    """Return the row of the normal's uncertainty as a whole: RMS angle, and the cones of the posterior."""
    shares = f"{at}.first_order.normal_deg"
    if value_at(data, f"{shares}.sigma") is None:
        return []
    row = [Cell("angle of the normal about its mean (deg): RMS, cones"), DASH, *_sigmas(data, shares)]
    if posterior:
        keys = [f"{at}.posterior.normal_deg.{part}" for part in ("radius68", "radius95")]
        row += [DASH, *(cell(data, key, decimals(value_at(data, key))) for key in keys)]
    return [tuple(row)]


def split(data: Mapping[str, Any], at: str, parameters: str) -> Table:
    """Return what of a posterior's width is the spot's and what the calibration's; `at` is the key of the split."""
    rows = []
    for name, label in (*((name, _NAMES[name]) for name in ("z_L_mm", "p", "q")), ("normal_deg", "normal (deg), RMS")):
        share = 100 * value_at(data, f"{at}.{name}.calibration_share")
        keys = [f"{at}.{name}.{part}" for part in ("spot", "calibration")]
        parts = [cell(data, key, decimals(value_at(data, key))) for key in keys]
        rows.append((Cell(label), *parts, Cell(f"{share:.0f} %")))
    caption = (
        f"Standard deviations of the posterior in two parts, whose squares add up. The rig's {parameters} were drawn "
        "together with the plane. Good: the spot's part is the larger one; else a better calibration pays, not light."
    )
    columns = ("", "spot", "calibration", "calibration's share of the variance")
    return Table("Spot or calibration?", columns, tuple(rows), caption, key="split")


def mount(data: Mapping[str, Any], at: str) -> Table:
    """Return a plane in the frame of the rig's mount; `at` is the key of that."""
    vectors = (("normal", "normal (x, y, z)", 6), ("point_mm", "point (x, y, z), mm", 4))
    rows = [(Cell(label), _all(data, f"{at}.{name}", places)) for name, label, places in vectors]
    rows.append((Cell("distance from the origin along the normal, mm"), cell(data, f"{at}.d_mm", _PLAIN_DECIMALS)))
    return Table(f"In the frame {value_at(data, at)['frame']}", ("", ""), tuple(rows), key="mount")


def _all(data: Mapping[str, Any], key: str, places: int) -> Cell:
    values = value_at(data, key)
    return Cell(", ".join(fixed(value, places) for value in values), " ".join(f"{key}.{i}" for i in range(len(values))))


def evidence(data: Mapping[str, Any], at: str) -> Table:
    """Return what tests a pose, in numbers."""
    rows = []
    for label, value, dof, p in (
        ("the rig: any plane against the ellipse", "chi2", "dof", "p_value"),
        ("the points against the plane's ellipse", "chi2_points", "dof_points", None),
    ):
        cells = [cell(data, f"{at}.{value}", 2), cell(data, f"{at}.{dof}", 0)]
        rows.append((Cell(label), *cells, DASH if p is None else chance(data, f"{at}.{p}")))
    return Table("Does it fit?", ("", "chi-squared", "degrees of freedom", "p"), tuple(rows), key="tests")


_PARTS = {
    "pooled": "all images together",
    "shift": "the same change of the beam in all",
    "trend": "a change that grows along the images",
    "rest": "what no such change explains",
}


def drift_tests(data: Mapping[str, Any], at: str) -> Table:
    """Return the tests of a rig with many images; `at` is the key of their list."""
    rows = []
    for i, test in enumerate(value_at(data, at)):
        numbers = [cell(data, f"{at}.{i}.{name}", places) for name, places in (("chi2", 2), ("dof", 0))]
        rows.append((Cell(_PARTS[test["part"]]), *numbers, chance(data, f"{at}.{i}.p_value")))
    caption = (
        "The first line is the sum of the others, the rig's covariance being common to the images. Good: no p below a "
        "few hundredths; the rig is called degraded below 0.00025."
    )
    return Table("Tests of the rig", ("", "chi-squared", "degrees of freedom", "p"), tuple(rows), caption, key="drift")


def changes(data: Mapping[str, Any], at: str, title: str) -> Table:
    """Return changes of the beam; `at` is the key of their list."""
    rows = []
    for i, change in enumerate(value_at(data, at)):
        unit = "" if change["unit"] == "1" else f" ({change['unit']})"
        places = decimals(change["sigma"])
        numbers = [cell(data, f"{at}.{i}.{name}", places) for name in ("value", "sigma")]
        rows.append((Cell(f"{change['name']}{unit}"), *numbers))
    caption = "Good: each within two of its sigmas of zero."
    return Table(title, ("", "change", "sigma"), tuple(rows), caption, key=at.rsplit(".", 1)[-1])


def slopes(data: Mapping[str, Any], at: str) -> Table:
    """Return how quantities change along a sequence; `at` is the key of the sequence."""
    per = value_at(data, f"{at}.unit")
    rows = []
    for i, trend in enumerate(value_at(data, f"{at}.trends")):
        key = f"{at}.trends.{i}"
        unit = f"per {per}" if trend["unit"] == "1" else f"{trend['unit']} per {per}"
        slope = cell(data, f"{key}.slope", decimals(trend["slope_sigma"]))
        sigmas = [
            cell(data, f"{key}.{name}", decimals(trend[name])) for name in ("slope_sigma", "slope_sigma_calibration")
        ]
        meaning = Cell("changes" if trend["changes"] else "does not change beyond its scatter")
        p = chance(data, f"{key}.p_value")
        rows.append((Cell(f"{trend['name']} ({unit})"), slope, *sigmas, p, meaning))
    columns = ("", "slope", "sigma", "calibration's sigma", "p", "")
    caption = (
        "A straight line through each quantity. Good, if nothing was to change: no slope is called a change. The "
        "calibration's error is the same in all images and scales their differences; it is no part of p."
    )
    return Table("Along the sequence", columns, tuple(rows), caption, last_in_words=True, key="slopes")


def comparison(data: Mapping[str, Any], at: str) -> Table | None:
    """Return all formulations side by side; None where nothing was compared."""
    rows = value_at(data, f"{at}.comparison")
    if not rows:
        return None
    sigma = value_at(data, f"{at}.first_order.z_L_mm.sigma")
    made = [_answer(data, f"{at}.comparison.{i}", row, sigma) for i, row in enumerate(rows)]
    columns = (
        "formulation",
        "outcome",
        "z_L (mm)",
        "alpha (deg)",
        "beta (deg)",
        "R (mm)",
        "chi-squared",
        "evaluations",
    )
    return Table("Formulations side by side", columns, tuple(made), CAPTIONS["comparison"], words=2, key="comparison")


_ROOTS = {"other": ", second plane", "elsewhere": ", neither plane"}


def _answer(data: Mapping[str, Any], key: str, row: Mapping[str, Any], sigma: float | None) -> tuple[Cell, ...]:
    name = row["formulation"] if row["solver"] == "none" else f"{row['formulation']} + {row['solver']}"
    outcome = Cell(row["outcome"].replace("_", " ") + _ROOTS.get(row["root"], ""), tone=row["status"])
    places = max(_PLAIN_DECIMALS, decimals(sigma) if sigma else 0)
    answers = [cell(data, f"{key}.{name}", places) for name in ("z_L_mm", "alpha_deg", "beta_deg", "R_mm")]
    return (Cell(name), outcome, *answers, cell(data, f"{key}.chi2", 2), cell(data, f"{key}.evaluations", 0))


def overview(data: Mapping[str, Any], anchors: Sequence[str]) -> Table:
    """Return a row for each input."""
    columns = (
        "",
        "input",
        "status",
        "z_L (mm)",
        "alpha (deg)",
        "beta (deg)",
        "normal (deg)",
        "chi-squared",
        "p",
        "flags",
    )
    rows = tuple(_line(data, i, anchor) for i, anchor in enumerate(anchors))
    caption = (
        "Value and standard deviation of first order, spot and calibration together; of the normal the RMS angle. "
        "Good: all ok, chi-squared mostly below 6."
    )
    return Table("Poses", columns, rows, caption, words=3, last_in_words=True, key="overview")


def _line(data: Mapping[str, Any], i: int, anchor: str) -> tuple[Cell, ...]:
    record, at = data["records"][i], f"records.{i}"
    values = [_with_sigma(data, at, name) for name in ("z_L_mm", "alpha_deg", "beta_deg")]
    normal = record["sigma"]["normal_deg"]
    return (
        Cell(str(i + 1)),
        Cell(record["input"], link=anchor),
        Cell(record["status"], tone=record["status"]),
        *values,
        cell(data, f"{at}.sigma.normal_deg", decimals(normal)),
        cell(data, f"{at}.chi2", 2),
        chance(data, f"{at}.p_value"),
        Cell(", ".join(flag.replace("_", " ") for flag in record["flags"]) or "-"),
    )


def _with_sigma(data: Mapping[str, Any], at: str, name: str) -> Cell:
    value, sigma = value_at(data, f"{at}.{name}"), value_at(data, f"{at}.sigma.{name}")
    if value is None:
        return DASH
    if sigma is None:
        return Cell(number(value, None), f"{at}.{name}")
    return Cell(f"{number(value, sigma)} ± {number(sigma, sigma)}", f"{at}.{name} {at}.sigma.{name}")
