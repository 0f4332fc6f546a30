"""Image files of all kinds: pixels as they are stored, signs of coded values, damage that a decoder would let pass."""

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from planeopt.errors import InputError
from planeopt.spot import read_image
from planeopt.spot.files import load_image
from planeopt.spot.headers import MAX_PIXELS

GREY = np.random.default_rng(3).integers(0, 256, (24, 32), dtype=np.uint8)
COLOUR = np.stack([GREY, GREY[::-1], GREY[:, ::-1]], axis=2)
NO_COMPRESSION = [cv2.IMWRITE_TIFF_COMPRESSION, 1]


def encoded(suffix: str, image: NDArray, parameters: list[int] | None = None) -> bytes:
    ok, data = cv2.imencode(suffix, image, parameters or [])
    assert ok
    return data.tobytes()


def chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def png(header: tuple[int, int, int, int], rows: bytes, *extra: tuple[bytes, bytes]) -> bytes:
    """A PNG of width, height, bit depth and colour type; every row begins with its filter's byte."""
    head = struct.pack(">2I5B", *header, 0, 0, 0)
    parts = [(b"IHDR", head), *extra, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def with_chunk(name: bytes, content: bytes) -> bytes:
    data = encoded(".png", GREY)
    after_header = 8 + 25
    return data[:after_header] + chunk(name, content) + data[after_header:]


def tiff(image: NDArray, *extra: tuple[int, int, int], photometric: int = 1, order: Literal["<", ">"] = "<") -> bytes:
    """An uncompressed TIFF in one strip, after the directory; further entries as tag, type (3 or 4) and value."""
    high, wide = image.shape[:2]
    depth, samples = image.dtype.itemsize * 8, 1 if image.ndim == 2 else image.shape[2]
    kind = {"u": 1, "i": 2, "f": 3}[image.dtype.kind]
    entries = [(256, 4, wide), (257, 4, high), (259, 3, 1), (262, 3, photometric), (277, 3, samples), (278, 4, high)]
    entries += [(279, 4, image.nbytes), (339, 3, kind), *extra]
    depths_at = 8 + 2 + 12 * (len(entries) + 2) + 4
    pixels_at = depths_at + 2 * samples
    entries += [(273, 4, pixels_at)]
    records = [
        (tag, struct.pack(f"{order}2HI4s", tag, kind, 1, number(value, kind, order))) for tag, kind, value in entries
    ]
    where = number(depth, 3, order) if samples == 1 else number(depths_at, 4, order)
    records.append((258, struct.pack(f"{order}2HI4s", 258, 3, samples, where)))
    head = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HI", 42, 8)
    directory = struct.pack(f"{order}H", len(records)) + b"".join(record for _, record in sorted(records)) + b"\0" * 4
    pixels = image.astype(image.dtype.newbyteorder(order)).tobytes()
    return head + directory + struct.pack(f"{order}{samples}H", *[depth] * samples) + pixels


def number(value: int, kind: int, order: str) -> bytes:
    return struct.pack(f"{order}HH", value, 0) if kind == 3 else struct.pack(f"{order}I", value)


def read(folder: Path, data: bytes) -> NDArray:
    (folder / "image").write_bytes(data)
    return read_image(folder / "image")


def changed(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]


def value_of(data: bytes, tag: int) -> int:
    """Where the value of an entry of a little-endian TIFF's directory lies."""
    return data.index(struct.pack("<H", tag), struct.unpack_from("<I", data, 4)[0]) + 8


def two_pages() -> bytes:
    """A TIFF whose first directory leads to a second one, of the image upside down, at the end of the file."""
    data = tiff(GREY)
    entries = struct.unpack_from("<H", data, 8)[0]
    end = 8 + 2 + 12 * entries
    second = changed(data[8 : end + 4], value_of(data, 273) - 8, struct.pack("<I", len(data)))
    return changed(data, end, struct.pack("<I", len(data) + GREY.nbytes)) + GREY[::-1].tobytes() + second


BITS = np.unpackbits(GREY[:, :4], axis=1)
STORED: dict[str, tuple[bytes, NDArray]] = {
    "png 1 bit": (png((32, 24, 1, 0), b"".join(b"\0" + row.tobytes() for row in GREY[:, :4])), 255 * BITS),
    "png grey and alpha": (
        png((32, 24, 8, 4), b"".join(b"\0" + np.stack([row, row // 2], 1).tobytes() for row in GREY)),
        np.stack([GREY, GREY, GREY, GREY // 2], axis=2),
    ),
    "png palette": (
        png((32, 24, 8, 3), b"".join(b"\0" + row.tobytes() for row in GREY), (b"PLTE", bytes(range(256)) * 3)),
        np.stack([np.frombuffer(bytes(range(256)) * 3, np.uint8).reshape(256, 3)[GREY][..., i] for i in (2, 1, 0)], 2),
    ),
    "png 16 bit RGBA": (
        encoded(".png", np.dstack([COLOUR, GREY]).astype(np.uint16) * 257),
        np.dstack([COLOUR, GREY]).astype(np.uint16) * 257,
    ),
    "tiff 8 bit": (tiff(GREY), GREY),
    "tiff big-endian 16 bit": (tiff(GREY.astype(np.uint16) * 257, order=">"), GREY.astype(np.uint16) * 257),
    "tiff float": (tiff((GREY / 255).astype(np.float32)), (GREY / 255).astype(np.float32)),
    "tiff colour": (tiff(COLOUR, photometric=2), COLOUR[..., ::-1]),
    "tiff alpha not multiplied": (
        tiff(np.dstack([COLOUR, GREY]), (338, 3, 2), photometric=2),
        np.dstack([COLOUR[..., ::-1], GREY]),
    ),
    "tiff turned": (tiff(GREY, (274, 3, 6)), GREY),
    "tiff mirrored, 16 bit": (tiff(GREY.astype(np.uint16) * 257, (274, 3, 2)), GREY.astype(np.uint16) * 257),
    "tiff turned colour, big-endian": (tiff(COLOUR, (274, 3, 8), photometric=2, order=">"), COLOUR[..., ::-1]),
    "tiff of two pages": (two_pages(), GREY),
    "pgm 12 bit": (
        b"P5\n2 2\n4095\n" + struct.pack(">4H", 0, 1000, 4095, 7),
        np.array([[0, 1000], [4095, 7]], np.uint16),
    ),
    "pgm in words": (b"P2\n2 2\n255\n1 2 3 4\n", np.array([[1, 2], [3, 4]], np.uint8)),
    "pbm": (b"P4\n32 24\n" + GREY[:, :4].tobytes(), 255 * (1 - BITS)),
    "bmp": (encoded(".bmp", COLOUR), COLOUR),
}


@pytest.mark.parametrize("case", STORED)
def test_pixels_are_those_of_the_file(case: str, tmp_path: Path):
    data, expected = STORED[case]
    image = read(tmp_path, data)
    assert image.dtype == expected.dtype
    np.testing.assert_array_equal(image, expected)


def exif(orientation: int) -> bytes:
    return b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 274, 3, 1, orientation, 0, 0)


def turned_jpeg() -> bytes:
    content = b"Exif\0\0" + exif(6)
    return b"\xff\xd8\xff\xe1" + struct.pack(">H", len(content) + 2) + content + encoded(".jpg", GREY)[2:]


def test_no_orientation_turns_the_pixels(tmp_path: Path):
    np.testing.assert_array_equal(read(tmp_path, turned_jpeg()), read(tmp_path, encoded(".jpg", GREY)))
    np.testing.assert_array_equal(read(tmp_path, with_chunk(b"eXIf", exif(6))), GREY)
    # That OpenCV would turn this one, were it asked to, shows that the orientation is there to be found.
    flags = cv2.IMREAD_GRAYSCALE
    turned = cv2.imdecode(np.frombuffer(turned_jpeg(), np.uint8), flags)
    assert turned is not None
    assert turned.shape == GREY.T.shape


CODED: dict[str, tuple[bytes, bool]] = {
    "png": (encoded(".png", GREY), False),
    "png of linear gamma": (with_chunk(b"gAMA", struct.pack(">I", 100_000)), False),
    "png with gamma": (with_chunk(b"gAMA", struct.pack(">I", 45_455)), True),
    "png sRGB": (with_chunk(b"sRGB", b"\0"), True),
    "png with resolution": (with_chunk(b"pHYs", struct.pack(">2IB", 1000, 1000, 1)), False),
    "jpeg": (encoded(".jpg", GREY), True),
    "webp": (encoded(".webp", COLOUR), True),
    "bmp": (encoded(".bmp", GREY), False),
    "tiff": (tiff(GREY), False),
    "tiff with a profile": (tiff(GREY, (34675, 4, 0)), True),
    "pgm": (encoded(".pgm", GREY), False),
}


@pytest.mark.parametrize("case", CODED)
def test_signs_of_coded_values(case: str, tmp_path: Path):
    data, expected = CODED[case]
    (tmp_path / "image").write_bytes(data)
    assert load_image(tmp_path / "image").encoded is expected


def entry(tag: int, value: int) -> Callable[[], bytes]:
    def make() -> bytes:
        data = tiff(GREY)
        return changed(data, value_of(data, tag), struct.pack("<I", value))

    return make


HEAD = struct.pack(">2I5B", MAX_PIXELS, 2, 8, 0, 0, 0, 0)
DAMAGED: dict[str, tuple[Callable[[], bytes], str]] = {
    "png: a bit of the pixels": (
        lambda: changed(encoded(".png", GREY), 80, b"\x55\xaa"),
        "checksum of its part 'IDAT'",
    ),
    "png: a bit of the head": (lambda: changed(encoded(".png", GREY), 20, b"\xff"), "checksum of its part 'IHDR'"),
    "png: no end": (lambda: encoded(".png", GREY)[:-12], "breaks off"),
    "png: too few rows": (lambda: png((32, 24, 8, 0), b"\0" * 33 * 20), "damaged"),
    "png: too many rows": (lambda: png((32, 24, 8, 0), b"\0" * 33 * 40), "damaged"),
    "png: huge": (lambda: png((40_000, 40_000, 8, 0), b"\0"), "claims 40000 x 40000 px"),
    "png: two pixels high": (lambda: png((MAX_PIXELS, 2, 8, 0), b"\0"), "claims"),
    "tiff: shifted strip": (entry(273, 8), "overlap"),
    "tiff: strip beyond the end": (entry(273, 200), "outside"),
    "tiff: higher": (entry(257, 25), "do not make up|not as long"),
    "tiff: wider": (entry(256, 33), "not as long"),
    "tiff: narrower by two": (entry(256, 29), "not as long"),
    "tiff: no rows": (entry(278, 0), "do not make up"),
    "tiff: fewer rows a strip": (entry(278, 5), "do not make up"),
    "tiff: deeper": (entry(258, 16), "not as long"),
    "tiff: huge": (entry(256, 2**31), "claims"),
    "tiff: directory beyond the end": (lambda: changed(tiff(GREY), 4, b"\xff\xff"), "leads out"),
    "tiff: no directory": (lambda: b"II*\0\x08\0\0\0", "leads out"),
    "tiff: cut": (lambda: tiff(GREY)[:-40], "outside"),
    "jpeg: cut": (lambda: encoded(".jpg", GREY)[:-90], "damaged"),
    "pgm: huge": (lambda: b"P5\n100000 100000\n255\n", "claims more pixels"),
    "pgm: negative": (lambda: b"P5\n-5 5\n255\n", "cannot|can be read|not a readable"),
    "bmp: huge": (
        lambda: changed(encoded(".bmp", GREY), 18, struct.pack("<2I", 2**30, 2**30)),
        "can be read|damaged|claims",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damage_is_one_clear_line(case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    make, words = DAMAGED[case]
    (tmp_path / "image").write_bytes(make())
    with pytest.raises(InputError, match=words) as caught:
        read_image(tmp_path / "image")
    assert re.fullmatch(rf"{re.escape(str(tmp_path / 'image'))}: \w[^\n]*", str(caught.value))
    assert capfd.readouterr().err == ""
    # OpenCV's complaints begin with the time since its start: a record must not depend on that.
    assert "ERROR:" not in str(caught.value)
