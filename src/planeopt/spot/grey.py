"""Any image array to linear grey with a known full scale."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planeopt.errors import InputError

_CHANNELS = {"blue": 0, "green": 1, "red": 2}
# ITU-R BT.601, the weights of OpenCV and of most cameras' own grey conversion; order blue, green, red.
_LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)
# Cameras with 10, 12 or 14 bits store them unshifted in 16.
_SHORT_SCALES = tuple(2**bits - 1 for bits in (10, 12, 14, 16))


@dataclass(frozen=True, eq=False)
class Grey:
    """An image in linear light.

    Parameters
    ----------
    values : (H, W) float32
        0 is black, 1 is full scale (of a float image: its largest value, or 1 if that is less).
    clipped : (H, W) bool, or None
        Pixels at full scale; ``None`` for float images, whose full scale is not known.
    """

    values: NDArray[np.float32]
    clipped: NDArray[np.bool_] | None


def to_grey(image: ArrayLike, channel: str = "gray", gamma: float = 1.0) -> Grey:
    """Turn an image into linear grey.

    Parameters
    ----------
    image : (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) ndarray
        Unsigned integers, or finite floats; colour in the order blue, green, red (, alpha, which is ignored).
    channel : {"gray", "red", "green", "blue"}
        What to take from a colour image.
    gamma : float
        Stored values are linear light to the power ``1/gamma``; 1 is a linear camera.

    Raises
    ------
    InputError
        If the array is not an image.
    """
    try:
        image = np.asarray(image)
    except ValueError as error:
        raise InputError(f"image: not an array of pixels ({error})") from None
    if channel not in ("gray", *_CHANNELS):
        raise InputError(f'spot: channel must be "gray", "red", "green" or "blue", not {channel!r}')
    if not (np.isfinite(gamma) and gamma > 0):
        raise InputError(f"spot: gamma must be positive, not {gamma!r}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)) or image.size == 0:
        raise InputError(f"image: shape {image.shape} is not that of a grey (H, W) or colour (H, W, 3 or 4) image")
    if image.ndim == 3:
        image = image[:, :, :3]
    scale = _full_scale(image)
    values = image.astype(np.float32) / np.float32(scale)
    clipped = image >= scale if image.dtype.kind == "u" else None
    if values.ndim == 3:
        # One clipped channel is enough to bend the sum; a channel that is not used does not matter.
        if channel == "gray":
            values = _linear(values, gamma) @ _LUMA
            return Grey(values, None if clipped is None else np.asarray(clipped.any(axis=2)))
        index = _CHANNELS[channel]
        values = np.ascontiguousarray(values[:, :, index])
        clipped = None if clipped is None else clipped[:, :, index]
    return Grey(_linear(values, gamma), clipped)


def _linear(values: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    return values if gamma == 1.0 else np.maximum(values, 0) ** np.float32(gamma)


def _full_scale(image: NDArray[Any]) -> float:
    if image.dtype.kind == "u":
        top = np.iinfo(image.dtype).max
        largest = int(image.max())
        # Only an image that reaches a short scale exactly is taken to end there: clipping shows as equal values.
        return float(largest) if top == 65535 and largest in _SHORT_SCALES else float(top)
    if image.dtype.kind == "f":
        if not np.all(np.isfinite(image)):
            raise InputError("image: contains NaN or infinity")
        return max(1.0, float(image.max()))
    raise InputError(f"image: pixels must be unsigned integers or floats, not {image.dtype}")
