"""What an image file says of itself before its pixels are decoded: whether it is whole, and how its values are coded.

A decoder forgives much: it fills the rest of a damaged image with something, or takes the rows of a TIFF from wherever
the file points. For a picture that is kind; for a measurement it may give a spot in a wrong place.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from planeopt.errors import InputError
from planeopt.spot.tiff import Directory, read_directory

MAX_PIXELS = 2**28
"""Of an image, 268 megapixels: a few bytes can claim more than any memory holds."""

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_ENCODED = (b"sRGB", b"iCCP", b"cICP")
_PNG_LINEAR = 100_000  # the chunk gAMA holds the exponent of the encoding times this
_JPEG, _JPEG_PIXELS, _JPEG_END = b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"
_TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@dataclass(frozen=True, slots=True)
class Coding:
    """How the values of an image file are to be taken.

    Parameters
    ----------
    encoded : bool
        The file says, or its format means, that the values are coded for display: not proportional to light.
    data : bytes
        The file, changed where a decoder would turn the image or multiply it by its alpha.
    """

    encoded: bool
    data: bytes


def coding_of(data: bytes) -> Coding:
    """Look at the head of an image file, and at its checksums and offsets where it has such.

    Parameters
    ----------
    data : bytes
        The whole file. Of a format that is not known here nothing is refused.

    Raises
    ------
    InputError
        If the file is damaged, or claims to hold more than `MAX_PIXELS` pixels.
    """
    if data.startswith(_PNG):
        return Coding(_png_is_encoded(data), data)
    if data.startswith(_TIFFS):
        directory = read_directory(data)
        _check_size(*directory.size)
        directory.check_strips(len(data))
        return Coding(_tiff_is_encoded(directory), directory.as_stored(data))
    if data.startswith(_JPEG):
        # Its pixels begin after one mark and must end with another; within them neither can occur.
        if data.rfind(_JPEG_END) < data.rfind(_JPEG_PIXELS):
            raise InputError("the image is damaged: it breaks off before its end")
        return Coding(True, data)
    webp = data.startswith(b"RIFF") and data[8:12] == b"WEBP"
    return Coding(webp or data.startswith(b"GIF8"), data)


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise InputError(f"the image claims {width} x {height} px, more than the {MAX_PIXELS:,} that can be measured")


def _tiff_is_encoded(directory: Directory) -> bool:
    return directory.has_profile or directory.is_jpeg


def _png_is_encoded(data: bytes) -> bool:
    encoded, last = False, b""
    for name, content, checksum in _png_chunks(data):
        # A part whose name begins with a capital is critical: without it there is no image.
        if name[:1].isupper() and zlib.crc32(content, zlib.crc32(name)) != checksum:
            raise InputError(f"the image is damaged: the checksum of its part {name.decode('latin-1')!r} is wrong")
        if name == b"IHDR" and len(content) >= 8:
            _check_size(*struct.unpack_from(">2I", content))
        encoded |= name in _PNG_ENCODED
        encoded |= name == b"gAMA" and len(content) == 4 and struct.unpack(">I", content)[0] != _PNG_LINEAR
        last = name
        if name == b"IEND":
            break
    if last != b"IEND":
        raise InputError("the image is damaged: it breaks off before its end")
    return encoded


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, memoryview, int]]:
    """Yield name, content and stored checksum of each whole part."""
    view, place = memoryview(data), len(_PNG)
    while place + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, place)
        end = place + 8 + length
        if end + 4 > len(data):
            return
        yield name, view[place + 8 : end], struct.unpack_from(">I", data, end)[0]
        place = end + 4
