"""Damage that files suffer, reproducible from a number."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 10**9)
"""Sizes and counts at the limits of their types."""
WORDS = (
    b"0", b"-1", b"nan", b"inf", b"1e999", b"-0", b"1,5", b"999999999999999999999", b"1/2/3", b"-1//-1", b"#", b"\"",
    b"\0", b"\xff\xfe", b"\xe9", b"\n", b"\r", b"\\\n", b"..", b"../../etc/passwd", b"C:\\x", b"{}", b"[[[[", b"null",
    b"", b" ", b";", b"\t",
)  # fmt: skip
"""What stands in text files of people and programs."""


def mutate(seed: int, corpus: Sequence[bytes]) -> bytes:
    """One of the files with one to four injuries; the same seed gives the same file."""
    draw = random.Random(seed)
    data = bytearray(draw.choice(corpus))
    for _ in range(draw.choice((1, 1, 2, 4))):
        data = bytearray(draw.choice(_INJURIES)(draw, bytes(data), corpus))
    return bytes(data)


def _flip(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Some bits."""
    changed = bytearray(data)
    for _bit in range(draw.choice((1, 2, 8)) if data else 0):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def _overwrite(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """A number of one to eight bytes at a place, often near the beginning, where headers are."""
    width = draw.choice((1, 2, 4, 8))
    place = draw.randrange(max(min(len(data), draw.choice((64, 512, 10**9))), 1))
    number = draw.choice(NUMBERS) & ((1 << 8 * width) - 1)
    return data[:place] + number.to_bytes(width, draw.choice(("little", "big"))) + data[place + width :]


def _cut(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """The end, or a part."""
    start = draw.randrange(len(data) + 1)
    return data[:start] + (data[start + draw.randrange(64) :] if draw.random() < 0.5 else b"")


def _repeat(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """A part, somewhere else or in place."""
    start, place = draw.randrange(len(data) + 1), draw.randrange(len(data) + 1)
    part = data[start : start + draw.choice((1, 4, 64, 1024))] * draw.choice((1, 1, 16))
    return data[:place] + part + data[place:]


def _word(draw: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Another word of a text."""
    words = list(re.finditer(rb"[^\s]+", data[:20_000]))
    if not words:
        return draw.choice(WORDS)
    chosen = draw.choice(words)
    return data[: chosen.start()] + draw.choice(WORDS) + data[chosen.end() :]


def _splice(draw: random.Random, data: bytes, corpus: Sequence[bytes]) -> bytes:
    """The beginning of one file and the end of another."""
    other = draw.choice(corpus)
    return data[: draw.randrange(len(data) + 1)] + other[draw.randrange(len(other) + 1) :]


_INJURIES: tuple[Callable[[random.Random, bytes, Sequence[bytes]], bytes], ...] = (
    _flip, _overwrite, _overwrite, _cut, _repeat, _word, _splice,
)  # fmt: skip
