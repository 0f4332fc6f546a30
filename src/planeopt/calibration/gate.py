"""A gate: one condition that a good calibration meets, how far it is met, and what to do where it is not."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

GateState = Literal["ok", "warn", "refuse"]
Verdict = Literal["ok", "degraded", "refused"]


@dataclass(frozen=True)
class Gate:
    """One condition of a good calibration.

    Parameters
    ----------
    name : str
        What is judged, in a word or two.
    state : {"ok", "warn", "refuse"}
    value : float or None
        What was found; None where there is nothing to judge.
    limits : tuple of (float or None)
        Where the warning begins, and where the refusal; None where there is no such limit. A value between the two
        warns, whichever is larger; where the refusal's limit is the smaller one, a value must be at least that.
    sentence : str
        What was found, and where it is not well: why it matters and what to do about it.
    symptom : bool
        Whether something else makes this gate fail as a rule. The verdict names that first.
    """

    name: str
    state: GateState
    value: float | None
    limits: tuple[float | None, float | None]
    sentence: str
    symptom: bool = False


_FITS = ("board shape", "one camera", "square proportion", "single views", "board bow")
_SHOTS = ("views", "tilt", "tilt directions", "coverage", "border", "board distances")
_CAUSES: dict[str, tuple[str, ...]] = {
    "residuals": _FITS,
    "outliers": _FITS,
    "spot residuals": (*_FITS, "one beam"),
    "camera conditioning": _SHOTS,
    "focal length": _SHOTS,
    "beam conditioning": ("spots", "spot distances", "board distances"),
    "adjustment": _SHOTS,
}
"""By a symptom: what may bring it about, were it only warned of."""


def at_least(value: float, warn: float, refuse: float | None) -> GateState:
    """Return the state of a value that must not be too small."""
    if refuse is not None and value < refuse:
        return "refuse"
    return "warn" if value < warn else "ok"


def at_most(value: float, warn: float, refuse: float | None) -> GateState:
    """Return the state of a value that must not be too large."""
    if refuse is not None and not value <= refuse:
        return "refuse"
    return "ok" if value <= warn else "warn"


def verdict(gates: Iterable[Gate]) -> tuple[Verdict, str]:
    """Return the verdict of gates, causes first, and its reason.

    Parameters
    ----------
    gates : iterable of Gate
        In the order in which causes come before what they cause, as `judge` returns them.

    Returns
    -------
    verdict : {"ok", "degraded", "refused"}
    message : str
        Where it is refused, the first gate that says so; if that is a symptom, what was warned of that brings it about
        comes first. Where it is degraded, all warnings.
    """
    judged = tuple(gates)
    closed = [gate for gate in judged if gate.state == "refuse"]
    warned = [gate for gate in judged if gate.state == "warn"]
    if closed:
        first = closed[0]
        causes = [gate for gate in warned if gate.name in _CAUSES.get(first.name, ())][:1]
        return "refused", " ".join(gate.sentence for gate in (*causes, first))
    if warned:
        return "degraded", " ".join(gate.sentence for gate in warned)
    return "ok", "Nothing stands against this calibration: every condition of a good session is met."
