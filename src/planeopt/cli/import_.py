"""`planeopt import`: a rig file, of the camera alone, from another program's."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from planeopt.cli.files import may_write
from planeopt.cli.messages import remark


def import_(
    file: Path,
    *,
    from_: Annotated[Literal["ros", "opencv"], Parameter(name="--from")],
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    pixel_pitch_mm: float | None = None,
    image_size: Annotated[tuple[int, int] | None, Parameter(negative="")] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Read another program's camera and write it as a rig file, every digit of it.

    Such a rig is a camera alone: it has no beam, which measuring a plane needs, and no covariance. The beam of another
    rig file cannot be put to it: a beam is found together with its rig's camera and is right only beside it. To measure
    planes, calibrate camera and beam together.

    Parameters
    ----------
    file
        The camera's file.
    from_
        ros: camera_info YAML; opencv: FileStorage, YAML, JSON or XML.
    output
        The rig file; standard output if left out.
    pixel_pitch_mm
        Size of a pixel on the sensor, mm, which no such file holds.
    image_size
        Width and height, px, where OpenCV's file does not hold them.
    force
        Overwrite the output file.
    """
    from planeopt.formats import import_camera
    from planeopt.rig import Rig, rig_as_toml
    from planeopt.whole_files import write_text

    if output is not None:
        may_write(output, [file], force=force)
    imported = import_camera(file, from_, pixel_pitch_mm=pixel_pitch_mm, image_size=image_size)
    text = rig_as_toml(Rig(imported.camera))
    if output is None:
        sys.stdout.write(text)
    else:
        write_text(output, text)
    for note in imported.notes:
        remark(f"{file}: {note}")
    remark(f"{file}: a camera alone: no beam, so it measures no plane, and no covariance")
    return 0
