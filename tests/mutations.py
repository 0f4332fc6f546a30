"""Damaged copies of image files, for tests only: bit flips, cuts, edited heads, parts in another order."""

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_HEAD = 8
_IHDR = slice(16, 29)


def whole_files(image: NDArray[np.uint8]) -> dict[str, bytes]:
    """Return an image in 8 bits as PNG and TIFF files of several kinds."""
    deep = image.astype(np.uint16) * 257
    kinds = {
        "8 bit.png": (image, []),
        "16 bit.png": (deep, []),
        "colour.png": (np.dstack([image] * 3), []),
        "plain.tiff": (image, [cv2.IMWRITE_TIFF_COMPRESSION, 1]),
        "strips.tiff": (image, [cv2.IMWRITE_TIFF_COMPRESSION, 1, cv2.IMWRITE_TIFF_ROWSPERSTRIP, 16]),
        "lzw.tiff": (image, [cv2.IMWRITE_TIFF_COMPRESSION, 5]),
        "deflate.tiff": (image, [cv2.IMWRITE_TIFF_COMPRESSION, 8]),
        "16 bit.tiff": (deep, [cv2.IMWRITE_TIFF_COMPRESSION, 1]),
        "float.tiff": ((image / 255).astype(np.float32), [cv2.IMWRITE_TIFF_COMPRESSION, 1]),
    }
    files = {}
    for name, (pixels, parameters) in kinds.items():
        ok, data = cv2.imencode(f".{name.rsplit('.')[1]}", pixels, parameters)
        assert ok, name
        files[name] = data.tobytes()
    return files


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the file with one kind of damage, drawn at random."""
    kinds = [_flipped, _flipped_at_an_end, _cut, _overwritten, _swapped, _repeated]
    kinds += [_png_head, _png_parts, _png_rows] if data[1:4] == b"PNG" else [_tiff_entry, _tiff_entry]
    return kinds[rng.integers(len(kinds))](data, rng)


def _flipped(data: bytes, rng: np.random.Generator, low: int = 0, high: int | None = None) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(low, len(data) if high is None else high, rng.integers(1, 5)):
        changed[place] ^= 1 << rng.integers(8)
    return bytes(changed)


def _flipped_at_an_end(data: bytes, rng: np.random.Generator) -> bytes:
    """Heads and directories are at either end of a file."""
    return _flipped(data, rng, 0, 300) if rng.integers(2) else _flipped(data, rng, len(data) - 300)


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(1, len(data))]


def _overwritten(data: bytes, rng: np.random.Generator) -> bytes:
    begin, length = int(rng.integers(len(data))), int(rng.integers(1, 2000))
    piece = bytes([rng.integers(256)]) * length if rng.integers(2) else rng.bytes(length)
    return data[:begin] + piece[: len(data) - begin] + data[begin + length :]


def _swapped(data: bytes, rng: np.random.Generator) -> bytes:
    one, two, three, four = np.sort(rng.integers(0, len(data), 4))
    return data[:one] + data[three:four] + data[two:three] + data[one:two] + data[four:]


def _repeated(data: bytes, rng: np.random.Generator) -> bytes:
    """Insert a piece of the file once more: all that follows is displaced."""
    begin, length = rng.integers(len(data)), rng.integers(1, 200)
    return data[:begin] + data[begin : begin + length] + data[begin:]


def _png_head(data: bytes, rng: np.random.Generator) -> bytes:
    """Change width, height, depth, colour type or interlacing, with the checksum put right."""
    head = bytearray(data[_IHDR])
    place = int(rng.integers(13))
    head[place] = (head[place] ^ (1 << rng.integers(8))) if rng.integers(2) else int(rng.integers(17))
    checksum = struct.pack(">I", zlib.crc32(b"IHDR" + head))
    return data[: _IHDR.start] + bytes(head) + checksum + data[_IHDR.stop + 4 :]


def _png_parts(data: bytes, rng: np.random.Generator) -> bytes:
    """Put two parts in each other's place; the pixels are four of them."""
    pixels = b"".join(content for name, content in _parts(data) if name == b"IDAT")
    quarter = -(-len(pixels) // 4)
    others = [part for part in _parts(data) if part[0] != b"IDAT"]
    split = [(b"IDAT", pixels[i : i + quarter]) for i in range(0, len(pixels), quarter)]
    parts = [*others[:-1], *split, others[-1]]
    one, two = rng.integers(len(parts), size=2)
    parts[one], parts[two] = parts[two], parts[one]
    return _joined(parts)


def _png_rows(data: bytes, rng: np.random.Generator) -> bytes:
    """Change bytes under the compression: no checksum shows it."""
    rows = bytearray(zlib.decompress(b"".join(content for name, content in _parts(data) if name == b"IDAT")))
    stride = len(rows) // struct.unpack_from(">I", data, _IHDR.start + 4)[0]
    for _ in range(rng.integers(1, 6)):
        # The first byte of a row says how it is to be undone; five ways there are.
        row = int(rng.integers(len(rows) // stride))
        rows[row * stride] = int(rng.integers(5))
        rows[row * stride + int(rng.integers(1, stride))] ^= 1 << int(rng.integers(8))
    others = [part for part in _parts(data) if part[0] != b"IDAT"]
    return _joined([*others[:-1], (b"IDAT", zlib.compress(bytes(rows))), others[-1]])


def _parts(data: bytes) -> list[tuple[bytes, bytes]]:
    """Return names and contents of a PNG's parts."""
    parts, place = [], PNG_HEAD
    while place < len(data):
        length = struct.unpack_from(">I", data, place)[0]
        parts.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    return parts


def _joined(parts: list[tuple[bytes, bytes]]) -> bytes:
    """Return a PNG of parts, each with its checksum."""
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in parts
    )


def _tiff_entry(data: bytes, rng: np.random.Generator) -> bytes:
    """Change the value, the count, the type or the tag of an entry of the directory."""
    start = struct.unpack_from("<I", data, 4)[0]
    entry = start + 2 + 12 * int(rng.integers(struct.unpack_from("<H", data, start)[0]))
    place, size = ((8, 4), (8, 4), (4, 4), (2, 2), (0, 2))[rng.integers(5)]
    value = int.from_bytes(data[entry + place : entry + place + size], "little")
    changes = (value ^ (1 << int(rng.integers(8 * size))), value + 1, value - 1, 2 * value, value // 2, 0)
    new = changes[rng.integers(len(changes))] % 256**size
    return data[: entry + place] + new.to_bytes(size, "little") + data[entry + place + size :]
