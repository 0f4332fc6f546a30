"""The rig that a command measures with."""

from pathlib import Path
from typing import TYPE_CHECKING

from planeopt.errors import InputError

if TYPE_CHECKING:
    from planeopt.rig import Rig


def load_measuring_rig(path: Path) -> "Rig":
    """Read a rig file and see to it that it has a beam.

    Raises
    ------
    InputError
        If the file cannot be used, or describes a camera alone.
    """
    from planeopt.rig import load_rig

    rig = load_rig(path)
    try:
        rig.require_beam()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return rig
