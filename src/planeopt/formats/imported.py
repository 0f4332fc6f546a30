"""A camera that came from elsewhere."""

from collections.abc import Iterable
from dataclasses import dataclass

from planeopt.errors import InputError
from planeopt.rig import Camera


@dataclass(frozen=True)
class Imported:
    """A camera read from another program's file.

    Parameters
    ----------
    camera : Camera
    notes : tuple of str
        What was assumed or left out, a sentence each.
    """

    camera: Camera
    notes: tuple[str, ...] = ()

    @classmethod
    def checked(
        cls,
        source: str,
        image_size: tuple[int, int],
        pinhole: tuple[float, float, float, float],
        distortion: tuple[float, float, float, float, float],
        pixel_pitch_mm: float | None,
        notes: Iterable[str],
    ) -> "Imported":
        """Return the camera, with a note if its principal point shows it to be another image's.

        Raises
        ------
        InputError
            If a value is impossible; begins with the source.
        """
        try:
            camera = Camera(image_size, *pinhole, distortion, pixel_pitch_mm)
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
        found = list(notes)
        (width, height), cx, cy = camera.image_size, camera.cx, camera.cy
        if not (0 <= cx < width and 0 <= cy < height):
            found.append(
                f"the principal point ({cx:.6g}, {cy:.6g}) px lies off the image of {width} x {height} px: "
                "was the camera calibrated at another resolution?"
            )
        return cls(camera, tuple(found))
