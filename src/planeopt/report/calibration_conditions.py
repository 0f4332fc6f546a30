"""The table of a calibration's conditions: what was found, in which unit, and on which side of a limit good lies."""

from collections.abc import Mapping
from typing import Any

from planeopt.report.calibration_tables import STATES, digits
from planeopt.report.calibration_words import CAPTIONS, UNITS
from planeopt.report.cells import DASH, value_at
from planeopt.report.content import Cell, Table

_AT_LEAST = frozenset(
    {"views", "spots", "coverage", "border", "tilt", "tilt directions", "spot distances", "board distances"}
)
"""Conditions on what must not be too small; with one limit alone, the limits do not say so."""


def conditions(data: Mapping[str, Any]) -> Table:
    """Return the conditions of a good session, each with what it asks for in words that say the direction."""
    rows = []
    for i, gate in enumerate(data["gates"]):
        at = f"gates.{i}"
        state = Cell(gate["state"], tone=STATES[gate["state"]])
        sides = _ok_if(data, at), _refused_if(data, at)
        found = digits(data, f"{at}.value")
        rows.append((Cell(gate["name"]), state, _unit(gate), found, *sides, Cell(gate["sentence"])))
    columns = ("condition", "state", "in", "found", "ok if", "refused if", "")
    return Table("Conditions", columns, tuple(rows), CAPTIONS["gates"], words=3, last_in_words=True, key="gates")


def from_below(gate: Mapping[str, Any]) -> bool:
    """Return whether a condition asks for at least its limits, not for at most."""
    warn, refuse = gate["limits"]
    if warn is None or refuse is None or warn == refuse:
        return gate["name"] in _AT_LEAST
    return refuse < warn


def _ok_if(data: Mapping[str, Any], at: str) -> Cell:
    gate = value_at(data, at)
    # What is refused from a limit on without a warning before it is ok up to there.
    key = f"{at}.limits.{0 if gate['limits'][0] is not None else 1}"
    return _limit(data, key, "at least", "") if from_below(gate) else _limit(data, key, "at most", "none")


def _refused_if(data: Mapping[str, Any], at: str) -> Cell:
    key = f"{at}.limits.1"
    return _limit(data, key, "below", "") if from_below(value_at(data, at)) else _limit(data, key, "above", "any")


def _limit(data: Mapping[str, Any], key: str, side: str, zero: str) -> Cell:
    """Return a limit with its side; `zero` is what to say of a limit of 0, if anything."""
    value = value_at(data, key)
    if value is None:
        return DASH
    return Cell(zero) if zero and not value else Cell(f"{side} {value:.5g}", key)


def _unit(gate: Mapping[str, Any]) -> Cell:
    name: str = gate["name"]
    if name == "tilt" and gate["limits"][1] is not None:
        return Cell("degrees")  # of the largest tilt, where all views are frontal; else views are counted
    return Cell(UNITS.get(name, ""))
