"""What goes wrong with files: functions (bytes, rng) -> bytes, that draw all they need from the generator."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
Mutator = Callable[[bytes, Rng], bytes]

_HUGE = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x40000000, 1 << 40, (1 << 63) - 1, (1 << 64) - 1, 0)
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
_STRANGE_NUMBERS = (
    b"nan", b"NaN", b"inf", b"-Infinity", b"1e999", b"-1", b"0", b"1e308", b"99999999999999999999999", b"1_0",
    b"", b"x", b"0x10", b"1,5", b"--1", b"1e-400", b"\xd9\xa3", b"4294967296", b"null", b"true",
    b'"1"', b"[]",
)  # fmt: skip


def truncated(data: bytes, rng: Rng) -> bytes:
    return data[: _place(data, rng)]


def truncated_near_an_end(data: bytes, rng: Rng) -> bytes:
    cut = int(rng.integers(1, 17))
    return data[:cut] if rng.random() < 0.5 else data[:-cut]


def emptied(data: bytes, rng: Rng) -> bytes:
    return b""


def bits_flipped(data: bytes, rng: Rng) -> bytes:
    content = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if content else 0):
        content[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(content)


def run_overwritten(data: bytes, rng: Rng) -> bytes:
    at, length = _place(data, rng), int(rng.integers(1, 65))
    filling = (b"\0" * length, b"\xff" * length, rng.bytes(length))[int(rng.integers(3))]
    return data[:at] + filling + data[at + length :]


def run_removed(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 257)) :]


def run_repeated(data: bytes, rng: Rng) -> bytes:
    at, length = _place(data, rng), int(rng.integers(1, 257))
    return data[:at] + data[at : at + length] * int(rng.integers(2, 5)) + data[at + length :]


def runs_exchanged(data: bytes, rng: Rng) -> bytes:
    a, b, c = sorted(_place(data, rng) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def magic_changed(data: bytes, rng: Rng) -> bytes:
    magic = (
        b"\x89PNG\r\n\x1a\n",
        b"II*\0",
        b"\x76\x2f\x31\x01",
        b"ply\n",
        b"\x1aE\xdf\xa3",
        b"BM",
        b"\xff\xd8",
        b"\0" * 8,
    )
    chosen = magic[int(rng.integers(len(magic)))]
    return chosen + data[len(chosen) :]


def field_made_huge(data: bytes, rng: Rng) -> bytes:
    """A 2-, 4- or 8-byte integer, mostly in the header, becomes a length that no machine holds."""
    value = _HUGE[int(rng.integers(len(_HUGE)))]
    size = (2, 4, 8)[int(rng.integers(3))]
    order = ("little", "big")[int(rng.integers(2))]
    at = int(rng.integers(0, max(1, min(len(data), 600)))) if rng.random() < 0.8 else _place(data, rng)
    return data[:at] + (value & (1 << 8 * size) - 1).to_bytes(size, order) + data[at + size :]


def png_size_declared(data: bytes, rng: Rng) -> bytes:
    """A PNG whose checksum is right and whose size is not; other files get huge fields."""
    if not data.startswith(b"\x89PNG"):
        return field_made_huge(data, rng)
    sizes = [0, 1, 3, 65535, 100_000, 1 << 20, (1 << 31) - 1, (1 << 32) - 1]
    width, height = (sizes[int(rng.integers(len(sizes)))] for _ in range(2))
    kind = (
        data[24:26]
        if rng.random() < 0.7
        else bytes([int(rng.choice([1, 4, 8, 16, 7])), int(rng.integers(8))])
    )
    head = b"IHDR" + struct.pack(">II", width, height) + kind + data[26:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


def garbage_appended(data: bytes, rng: Rng) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 5000)))


def only_noise(data: bytes, rng: Rng) -> bytes:
    keep = int(rng.integers(0, 13))
    return data[:keep] + rng.bytes(int(rng.integers(1, 3000)))


def number_made_strange(data: bytes, rng: Rng) -> bytes:
    numbers = list(_NUMBER.finditer(data[:20_000]))
    if not numbers:
        return bits_flipped(data, rng)
    chosen = numbers[int(rng.integers(len(numbers)))]
    strange = _STRANGE_NUMBERS[int(rng.integers(len(_STRANGE_NUMBERS)))]
    return data[: chosen.start()] + strange + data[chosen.end() :]


def line_removed(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    del lines[int(rng.integers(len(lines)))]
    return b"\n".join(lines)


def line_repeated(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    at = int(rng.integers(len(lines)))
    return b"\n".join([*lines[: at + 1], *[lines[at]] * int(rng.integers(1, 4)), *lines[at + 1 :]])


def lines_exchanged(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    a, b = (int(rng.integers(len(lines))) for _ in range(2))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def word_exchanged(data: bytes, rng: Rng) -> bytes:
    words = re.split(rb"(\s+)", data[:20_000])
    a, b = (int(rng.integers(len(words))) for _ in range(2))
    words[a] = words[b]
    return b"".join(words) + data[20_000:]


def not_utf8(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + bytes([int(rng.integers(128, 256))]) + data[at:]


def in_utf16(data: bytes, rng: Rng) -> bytes:
    return data.decode("latin-1").encode("utf-16")


def nested_deeply(data: bytes, rng: Rng) -> bytes:
    opening = (b"[", b'{"a":', b"{ JOINT a\n", b"((")[int(rng.integers(4))]
    at = _place(data, rng) if rng.random() < 0.5 else 0
    return data[:at] + opening * int(rng.integers(100, 60_000)) + data[at:]


def line_made_long(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    filling = (b"9", b"a", b" ", b"1 ")[int(rng.integers(4))]
    return data[:at] + filling * int(rng.integers(1000, 300_000)) + data[at:]


BYTE_MUTATORS: tuple[Mutator, ...] = (
    truncated, truncated, truncated_near_an_end, emptied, bits_flipped, bits_flipped, run_overwritten,
    run_removed, run_repeated, runs_exchanged, magic_changed, field_made_huge, field_made_huge,
    png_size_declared, garbage_appended, only_noise,
)  # fmt: skip
TEXT_MUTATORS: tuple[Mutator, ...] = (
    truncated, emptied, bits_flipped, run_removed, run_repeated, number_made_strange, number_made_strange,
    number_made_strange, line_removed, line_removed, line_repeated, lines_exchanged, word_exchanged, not_utf8,
    in_utf16, nested_deeply, line_made_long, only_noise,
)  # fmt: skip


def mutate(data: bytes, rng: Rng) -> tuple[str, bytes]:
    """Return the names of one or two mutations and what they make of a file."""
    is_text = b"\0" not in data[:4000] and data[:4000].isascii()
    names = []
    for _ in range(1 if rng.random() < 0.8 else 2):
        pool = TEXT_MUTATORS if is_text and rng.random() < 0.8 else BYTE_MUTATORS
        mutator = pool[int(rng.integers(len(pool)))]
        names.append(mutator.__name__)
        data = mutator(data, rng)
    return " + ".join(names), data


def _place(data: bytes, rng: Rng) -> int:
    """A position: often in the header, where most fields are."""
    end = max(1, len(data))
    return int(rng.integers(0, min(end, 400))) if rng.random() < 0.4 else int(rng.integers(0, end))
