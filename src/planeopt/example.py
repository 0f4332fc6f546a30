"""The bundled example: board views, targets with their truth, and the true rig."""

from importlib import resources
from pathlib import Path

from planeopt.errors import InputError


def example_folder() -> Path:
    """Return the folder of the example: the wheel's copy, or `calibration/example` of a source checkout.

    Raises
    ------
    InputError
        If this installation has neither.
    """
    package = Path(str(resources.files("planeopt")))
    candidates = (package / "example", package.parents[1] / "calibration" / "example")
    found = next((folder for folder in candidates if (folder / "targets").is_dir()), None)
    if found is None:
        raise InputError(f"{candidates[0]}: this installation of planeopt lacks its example data; install it again")
    return found


def example_targets() -> list[Path]:
    """Return the images of the example's targets, in order; each has its truth beside it."""
    return sorted((example_folder() / "targets").glob("*.png"))
