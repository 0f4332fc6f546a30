"""Calibrate a rig: `python calibration/charuco.py SESSION -o DIR`.

The routine behind `planeopt calibrate`, to read and to adapt. SESSION is a folder with `session.toml`, `board.toml` and
images of the board with the laser's spot in its window; calibration/README.md says how to take them. DIR gets the files
of the command: `rig.toml`, `calibration.json` (all observations, everything needed to compute it again) and
`calibration.html` (what speaks for it and against it).
"""

import argparse
import shlex
import sys
from pathlib import Path

from planeopt.calibration import Options, calibrate, detect, load_session
from planeopt.cli.files import output_folder
from planeopt.errors import InputError
from planeopt.executors import processes
from planeopt.report.calibration_files import write_calibration


def main(session: Path, output: Path, jobs: int = 1) -> int:
    """Calibrate a session and write its files; return 0 if all is well, 2 with a reservation or a refusal."""
    if output.exists():
        raise InputError(f"{output}: exists already; name another folder")
    command = shlex.join(["python", "calibration/charuco.py", str(session)])
    # The folder is there when all is done, or not at all.
    with output_folder(output, force=False) as folder:
        # What is there: the board as measured, the images, with laser-off twins if there are any.
        loaded = load_session(session)

        # Corners to some hundredths of a pixel, and the spot in the board's window; each image on its own.
        with processes(jobs) as executor:
            detected = detect(loaded, executor=executor)
        for image in detected.images:
            print(f"{image.name}: {image.status}, {image.n_corners} corners. {image.reason}")  # noqa: T201

        # Camera, poses, the board's bow and the beam in one adjustment; then tests, gates and what to shoot next.
        calibration = calibrate(detected, Options())
        print(f"{calibration.verdict}: {calibration.message}")  # noqa: T201 - a script speaks

        # A rig that is refused is not written.
        write_calibration(calibration, folder, session=str(session), command=command)
    return 0 if calibration.verdict == "ok" else 2


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes to find corners in")
    given = parser.parse_args()
    if given.jobs < 1:
        parser.error(f"--jobs must be at least 1, not {given.jobs}")
    try:
        sys.exit(main(given.session, given.output, given.jobs))
    except InputError as error:
        sys.exit(str(error))
