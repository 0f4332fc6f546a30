"""Where a report comes from."""

import hashlib
import importlib.metadata
import os
import platform
from datetime import UTC, datetime
from pathlib import Path

import cv2

from planeopt import __version__
from planeopt.errors import InputError
from planeopt.report.record import Provenance


def versions() -> dict[str, str]:
    """Return the versions of what the numbers depend on."""
    packages = {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "casadi", "emcee", "matplotlib")}
    # OpenCV comes in several packages, of which any will do.
    return {"planeopt": __version__, "python": platform.python_version(), **packages, "opencv": cv2.__version__}


def provenance(rig_file: str | os.PathLike[str], *, command: str, seed: int, when: datetime) -> Provenance:
    """Return where a report comes from.

    Parameters
    ----------
    rig_file : path-like
        Its bytes are hashed.
    command : str
        That makes the report again.
    seed : int
    when : datetime
        Aware of its time zone.

    Raises
    ------
    InputError
        If the rig's file cannot be read.
    """
    try:
        digest = hashlib.sha256(Path(rig_file).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{rig_file}: cannot be read ({error.strerror})") from error
    time = when.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return Provenance(
        versions=versions(), rig_file=str(rig_file), rig_sha256=digest, command=command, seed=seed, time=time
    )
