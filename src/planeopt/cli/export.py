"""`planeopt export`: the rig's camera in another program's format."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from planeopt.cli.files import may_write
from planeopt.cli.messages import remark
from planeopt.errors import InputError

# Readers of each format go by these, or read another format where they see them.
_MISLEADING = (".ini", ".json", ".toml", ".xml")


def export(
    *,
    rig: Path,
    to: Literal["ros", "opencv", "kalibr", "mrcal"],
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    name: str = "camera",
    approximate: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Write the camera of a rig for another program, every digit of it.

    These formats hold a camera alone. What of the rig is left out, its laser beam above all, is said on standard error
    and in the file's comment.

    Parameters
    ----------
    rig
        The rig file (rig.toml).
    to
        ros: camera_info YAML; opencv: FileStorage, YAML 1.0; kalibr: camchain; mrcal: cameramodel.
    output
        The file; standard output if left out.
    name
        The camera's name, for the formats that have one.
    approximate
        For kalibr, which has no k3: fit the other coefficients anew in its place, and say how far that is off.
    force
        Overwrite the output file.
    """
    from planeopt.formats import export_camera
    from planeopt.rig import load_rig
    from planeopt.whole_files import write_text

    loaded = load_rig(rig)
    if output is not None:
        may_write(output, [rig], force=force)
        if output.suffix.lower() in _MISLEADING:
            raise InputError(f"{output}: what is written is not {output.suffix}; name the file .yaml (.cameramodel)")
    try:
        exported = export_camera(loaded, to, name=name, approximate=approximate)
    except InputError as error:
        raise InputError(f"{rig}: {error}") from error
    if output is None:
        sys.stdout.write(exported.text)
    else:
        write_text(output, exported.text)
    for note in exported.notes:
        remark(f"{rig}: {note}")
    return 0
