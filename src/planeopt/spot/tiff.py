"""The first directory of a TIFF file: what has to be known of it beside the pixels (TIFF 6.0, 1992; BigTIFF)."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from planeopt.errors import InputError

_BIG = 43
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}

_WIDTH, _HEIGHT, _BITS, _COMPRESSION = 256, 257, 258, 259
_OFFSETS, _ORIENTATION, _SAMPLES, _ROWS, _COUNTS, _PLANES = 273, 274, 277, 278, 279, 284
_TRANSFER, _EXTRA, _SUBSAMPLING, _PROFILE = 301, 338, 530, 34675
_UNCOMPRESSED, _SEPARATE_PLANES = 1, 2
_JPEG = (6, 7)
_AS_STORED = 1  # of an orientation: first row on top; of an extra sample: an alpha by which nothing is to be multiplied

Piece = tuple[int, int]
"""Of a file: its first byte, and the one after its last."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Values of an entry, and where and how the first of them is stored; no values where they are not integers."""

    values: tuple[int, ...]
    place: int
    form: str


@dataclass(frozen=True, slots=True)
class Directory:
    """The entries by tag, and the pieces of the file that head and directory take."""

    entries: Mapping[int, Entry]
    pieces: tuple[Piece, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self._first(_WIDTH, 0), self._first(_HEIGHT, 0)

    @property
    def has_profile(self) -> bool:
        """Whether there is a colour profile or a transfer function."""
        return _PROFILE in self.entries or _TRANSFER in self.entries

    @property
    def is_jpeg(self) -> bool:
        """Whether the pixels are compressed as JPEG."""
        return self._first(_COMPRESSION, _UNCOMPRESSED) in _JPEG

    def as_stored(self, data: bytes) -> bytes:
        """Return the file without what makes a decoder turn the image or multiply it by its alpha."""
        patched = bytearray(data)
        for tag in (_ORIENTATION, _EXTRA):
            if self._first(tag, _AS_STORED) != _AS_STORED:
                struct.pack_into(self.entries[tag].form, patched, self.entries[tag].place, _AS_STORED)
        return bytes(patched)

    def check_strips(self, length: int) -> None:
        """See to it that the strips of rows make up the image, each in a place of its own.

        Nothing is said of tiles, nor of what a compressed strip holds.

        Parameters
        ----------
        length : int
            Of the file, bytes.

        Raises
        ------
        InputError
            If they do not.
        """
        if _OFFSETS not in self.entries or _COUNTS not in self.entries:
            return
        offsets, counts = self.entries[_OFFSETS].values, self.entries[_COUNTS].values
        width, height = self.size
        rows = min(self._first(_ROWS, height), height)
        separate = self._first(_PLANES, 1) == _SEPARATE_PLANES
        samples = self._first(_SAMPLES, 1)
        strips = -(-height // rows) if rows else 0
        if not strips or not len(offsets) == len(counts) == strips * (samples if separate else 1):
            raise InputError("the image is damaged: its strips of rows (TIFF) do not make up its height")
        if self._first(_COMPRESSION, _UNCOMPRESSED) == _UNCOMPRESSED and _SUBSAMPLING not in self.entries:
            row = -(-width * self._first(_BITS, 1) * (1 if separate else samples) // 8)
            needed = [row * min(rows, height - i % strips * rows) for i in range(len(counts))]
            # Some programs fill up a strip: a row too much is let pass.
            if any(not need <= count <= need + row for need, count in zip(needed, counts, strict=True)):
                raise InputError("the image is damaged: its strips of rows (TIFF) are not as long as its size asks for")
        places = sorted((at, at + count) for at, count in zip(offsets, counts, strict=True))
        # Pieces of the directory may be one: writers do that with equal values.
        own = any(end > start for (_, end), (start, _) in pairwise(places))
        others = any(start < end and begin < stop for start, stop in places for begin, end in self.pieces)
        if own or others or places[-1][1] > length:
            raise InputError("the image is damaged: its strips of rows (TIFF) overlap or lie outside the file")

    def _first(self, tag: int, default: int) -> int:
        entry = self.entries.get(tag)
        return entry.values[0] if entry is not None and entry.values else default


def read_directory(data: bytes) -> Directory:
    """Read the first directory of a TIFF file.

    Raises
    ------
    InputError
        If it leads out of the file.
    """
    try:
        return _directory(data)
    except struct.error:
        raise InputError("the image is damaged: its directory (TIFF) leads out of the file") from None


def _directory(data: bytes) -> Directory:
    order = "<" if data.startswith(b"II") else ">"
    big = struct.unpack_from(f"{order}H", data, 2)[0] == _BIG
    word, inline, counter, head = ("Q", 8, "Q", 16) if big else ("I", 4, "H", 8)
    start = struct.unpack_from(f"{order}{word}", data, head - inline)[0]
    number = struct.unpack_from(f"{order}{counter}", data, start)[0]
    begin, step = start + struct.calcsize(f"{order}{counter}"), 4 + 2 * inline
    end = begin + number * step
    if end > len(data):
        raise struct.error
    entries: dict[int, Entry] = {}
    pieces = [(0, head), (start, end)]
    for entry in range(begin, end, step):
        tag, kind, count = struct.unpack_from(f"{order}2H{word}", data, entry)
        place, size = entry + 4 + inline, _SIZES.get(kind, 1) * count
        if size > inline:
            place = struct.unpack_from(f"{order}{word}", data, place)[0]
            if place + size > len(data):
                raise struct.error
            pieces.append((place, place + size))
        form = _INTEGERS.get(kind)
        values = () if form is None else struct.unpack_from(f"{order}{count}{form}", data, place)
        entries[tag] = Entry(values, place, f"{order}{form}")
    return Directory(entries, tuple(pieces))
