"""Any image array to linear grey with a known full scale."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError

_CHANNELS = {"blue": 0, "green": 1, "red": 2}
# ITU-R BT.601, the weights of OpenCV and of most cameras' own grey conversion; order blue, green, red.
_LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)
# Cameras with 10, 12 or 14 bits store them unshifted in 16.
_SHORT_SCALES = tuple(2**bits - 1 for bits in (10, 12, 14, 16))

Box = tuple[int, int, int, int]
"""``x0, y0, x1, y1`` of a part of an image, px, upper ends excluded."""


@dataclass(frozen=True, eq=False)
class Grey:
    """An image in linear light, made linear where it is looked at.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array
        As the camera gave it; the channel that is used, or blue, green and red.
    scale : float
        The stored value of full scale.
    gamma : float
        Stored values are linear light to the power ``1/gamma``.
    dark : array, optional
        Taken with the laser off, of the same shape and type: subtracted in linear light.
    """

    image: NDArray[Any]
    scale: float
    gamma: float = 1.0
    dark: NDArray[Any] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.image.shape[0], self.image.shape[1]

    def crop(self, box: Box) -> NDArray[np.float32]:
        """Return a part in linear light: 0 is black, 1 is full scale.

        Full scale of a float image is its largest value, or 1 if that is less. Negative where the laser-off image is
        the brighter one.
        """
        x0, y0, x1, y1 = box
        light = self._linear(self.image[y0:y1, x0:x1])
        return light if self.dark is None else light - self._linear(self.dark[y0:y1, x0:x1])

    def rows(self, count: int) -> NDArray[np.float32]:
        """Return about so many rows in linear light, evenly spaced."""
        every = max(1, self.shape[0] // max(count, 1))
        light = self._linear(self.image[::every])
        return light if self.dark is None else light - self._linear(self.dark[::every])

    def crop_clipped(self, box: Box) -> NDArray[np.bool_] | None:
        """Return which pixels of a part are at full scale, the laser on.

        ``None`` for float images, whose full scale is not known. Of a colour image one clipped channel is enough: it
        bends the sum.
        """
        if self.image.dtype.kind != "u":
            return None
        x0, y0, x1, y1 = box
        clipped = np.asarray(self.image[y0:y1, x0:x1] >= self.scale)
        return np.any(clipped, axis=2) if clipped.ndim == 3 else clipped

    def crop_black(self, box: Box) -> NDArray[np.bool_] | None:
        """Return which pixels of a part are at nought, where noise may end there.

        ``None`` where it does not: in float images, and less the light without the laser.
        """
        if self.image.dtype.kind != "u" or self.dark is not None:
            return None
        x0, y0, x1, y1 = box
        black = self.image[y0:y1, x0:x1] == 0
        return black.any(axis=2) if black.ndim == 3 else black

    @cached_property
    def values(self) -> NDArray[np.float32]:
        """All of the image in linear light, (H, W)."""
        return self.crop(self._everything)

    @cached_property
    def clipped(self) -> NDArray[np.bool_] | None:
        """Which pixels of all of the image are at full scale, (H, W)."""
        return self.crop_clipped(self._everything)

    @cached_property
    def search(self) -> NDArray[Any]:
        """The image (H, W) to look for the spot in: 8 or 16 bits or float32, of one channel, neither linear nor scaled.

        Where something is does not depend on the response of the camera, and a search that sees all of the pixels is
        several times faster on those that are stored.
        """
        image, dark = self.image, self.dark
        if image.dtype not in (np.uint8, np.uint16) or (dark is not None and self.gamma != 1.0):
            return self.values
        if dark is not None:
            # What is darker than without the laser is no spot, so that ending at 0 loses nothing.
            image = np.asarray(cv2.subtract(np.ascontiguousarray(image), np.ascontiguousarray(dark)))
        if image.ndim == 3:
            return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2GRAY))
        return np.ascontiguousarray(image)

    @property
    def search_scale(self) -> float:
        """Full scale of `search`."""
        return 1.0 if self.search.dtype.kind == "f" else self.scale

    @property
    def quantum(self) -> float:
        """The step between two values, 0 where it is not the same everywhere or not known."""
        even = self.image.dtype.kind == "u" and self.image.ndim == 2 and self.gamma == 1.0
        return 1 / self.scale if even else 0.0

    @property
    def _everything(self) -> Box:
        return 0, 0, self.shape[1], self.shape[0]

    def _linear(self, part: NDArray[Any]) -> NDArray[np.float32]:
        if self.gamma != 1.0 and part.dtype.kind == "u" and part.size > np.iinfo(part.dtype).max:
            stored = np.arange(int(np.iinfo(part.dtype).max) + 1, dtype=np.float32) / np.float32(self.scale)
            light = (stored ** np.float32(self.gamma))[part]
        else:
            # Floats may exceed single precision before they are divided, and lie below black by any amount.
            part = part.astype(np.float32) / np.float32(self.scale) if part.dtype.kind == "u" else part / self.scale
            light = np.maximum(part, -1).astype(np.float32)
            if self.gamma != 1.0:
                light = np.maximum(light, 0) ** np.float32(self.gamma)
        return light @ _LUMA if light.ndim == 3 else light


def to_grey(image: ArrayLike, channel: str = "gray", gamma: float = 1.0, dark: ArrayLike | None = None) -> Grey:
    """Turn an image into linear grey.

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) ndarray
        Unsigned integers, or finite floats; colour in the order blue, green, red (, alpha, which is ignored).
    channel : {"gray", "red", "green", "blue"}
        What to take from a colour image.
    gamma : float
        Stored values are linear light to the power ``1/gamma``; 1 is a linear camera.
    dark : array_like, optional
        Taken with the laser off, of the same shape and type; it is subtracted in linear light.

    Raises
    ------
    InputError
        If an array is not an image, or the laser-off image is not like the other.
    """
    if channel not in ("gray", *_CHANNELS):
        raise InputError(f'spot: channel must be "gray", "red", "green" or "blue", not {channel!r}')
    if not (np.isfinite(gamma) and gamma > 0):
        raise InputError(f"spot: gamma must be positive, not {gamma!r}")
    pixels = _pixels(image, "image")
    scale = _full_scale(pixels, "image")
    if dark is None:
        return Grey(_of_channel(pixels, channel), scale, gamma)
    off = _pixels(dark, "laser-off image")
    if off.shape != pixels.shape or off.dtype != pixels.dtype:
        raise InputError(
            f"laser-off image: {off.shape} of {off.dtype}, but the image is {pixels.shape} of {pixels.dtype}; "
            "take both with the same settings"
        )
    # Both on one scale; a 12-bit image may reach its end in only one of the two.
    scale = max(scale, _full_scale(off, "laser-off image")) if pixels.dtype.kind == "f" else scale
    return Grey(_of_channel(pixels, channel), scale, gamma, _of_channel(off, channel))


def _pixels(image: ArrayLike, what: str) -> NDArray[Any]:
    """Return the array (H, W) or (H, W, 3) of an image, or say why it is none."""
    try:
        array = np.asarray(image)
    except ValueError as error:
        raise InputError(f"{what}: not an array of pixels ({error})") from None
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (3, 4)) or array.size == 0:
        raise InputError(f"{what}: shape {array.shape} is not that of a grey (H, W) or colour (H, W, 3 or 4) image")
    return array[:, :, :3] if array.ndim == 3 else array


def _of_channel(image: NDArray[Any], channel: str) -> NDArray[Any]:
    return image if image.ndim == 2 or channel == "gray" else image[:, :, _CHANNELS[channel]]


def _full_scale(image: NDArray[Any], what: str) -> float:
    if image.dtype.kind == "u":
        top = np.iinfo(image.dtype).max
        if top != 65535:
            return float(top)
        largest = int(image.max())
        # Only an image that reaches a short scale exactly is taken to end there: clipping shows as equal values.
        return float(largest) if largest in _SHORT_SCALES else float(top)
    if image.dtype.kind == "f":
        if not np.all(np.isfinite(image)):
            raise InputError(f"{what}: contains NaN or infinity")
        return max(1.0, float(image.max()))
    raise InputError(f"{what}: pixels must be unsigned integers or floats, not {image.dtype}")
