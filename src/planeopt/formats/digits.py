"""Numbers as text that every reader takes for the same number."""

from collections.abc import Iterable


def as_text(value: float) -> str:
    """Return the fewest digits, 17 at most, that read back as the same number, with a decimal point.

    Readers of YAML 1.1 (PyYAML, and with it ROS's parameter server and kalibr) take `1e-05` for a text: their numbers
    need the point, and a sign in the exponent.
    """
    digits = repr(float(value))
    mantissa, e, exponent = digits.partition("e")
    return digits if "." in mantissa else f"{mantissa}.0{e}{exponent}"


def listed(values: Iterable[float]) -> str:
    """Return numbers as a list on one line, with commas."""
    return "[" + ", ".join(map(as_text, values)) + "]"


def comment(sentences: Iterable[str]) -> list[str]:
    """Return sentences as lines of a comment, which YAML and Python mark alike."""
    return [f"# {sentence}" for sentence in sentences]
