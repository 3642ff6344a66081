"""Synthetic captures on disk, for training that is repeated: tar files in the layout of WebDataset.

WebDataset's format was chosen because it is plain tar: anything can read it, also where its library is missing, and it
needs nothing to be written. A sample is one ``.npz`` of float32 and bool arrays, compressed, as most pixels outside the
object are 0.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from ..core.checks import check_count
from ..core.errors import FileError, RangeError
from ..core.files import atomic_path, read_json
from ..core.progress import track
from ..synthetic.captures import SyntheticCaptures
from ..synthetic.images import SyntheticImages
from ..synthetic.scenes import Meshes

LISTED = "captures.json"
"""Name of the file that says what a folder of shards is made of."""
LEVEL = 1
"""Of zlib's compression: a quarter of the size; 6 saves 4 % more and takes twice as long."""


def write_shards(
    captures: SyntheticCaptures[SyntheticImages],
    folder: str | os.PathLike[str],
    count: int,
    *,
    per_shard: int = 1000,
    workers: int = 0,
) -> list[Path]:
    """Write the first ``count`` captures as shards ``captures-000000.tar`` and so on; what is there already is kept.

    The files are the same to the byte for any number of workers. An interrupted run goes on with the shard that it was
    writing.

    Args:
        captures: of kind ``"images"``.
        folder: made if need be; with shards of other captures in it nothing is written.
        count: number of captures; the last shard may hold more, where it was written whole before.
        per_shard: number of captures of a shard.
        workers: processes that make captures; 0 for this one.

    Returns:
        The shards, for example for ``webdataset.WebDataset(list(map(str, shards))).map(decode_shard)``.

    Raises:
        RangeError: captures of pixels, or numbers below 1.
        FileError: the folder holds shards of other captures, or cannot be written.

    Example:
        >>> import tempfile, torch_orennayar as ton
        >>> captures = ton.SyntheticCaptures("images", size=(16, 16), lights=(2, 2))
        >>> shards = ton.write_shards(captures, tempfile.mkdtemp(), 4, per_shard=2)
        >>> [shard.name for shard in shards]
        ['captures-000000.tar', 'captures-000001.tar']
    """
    if captures.kind != "images":
        raise RangeError("captures", expected="kind 'images'", got=captures.kind, mend="pixels are as fast to make")
    check_count("count", count)
    check_count("per_shard", per_shard)
    if captures.length is not None and count > captures.length:
        raise RangeError("count", expected=f"at most {captures.length}", got=str(count), mend="make captures longer")
    place = Path(folder)
    _claim(place, captures, per_shard)
    writer = _ShardWriter(captures, place, count, per_shard)
    missing = [number for number in range(len(writer)) if not writer.path(number).exists()]
    loader = DataLoader(writer, batch_size=None, sampler=missing, num_workers=workers)
    for _ in track(loader, "shards", len(missing)):
        pass
    for number in range(len(writer)):  # a last shard that was shorter is part of a whole one now
        for other in place.glob(f"captures-{number:06d}-*.tar"):
            if other != writer.path(number):
                other.unlink()
    return [writer.path(number) for number in range(len(writer))]


def decode_shard(record: Mapping[str, Any]) -> SyntheticImages:
    """A sample from a record of WebDataset, as `SyntheticCaptures` makes it.

    Args:
        record: with the bytes of the sample as ``npz``.

    Raises:
        FileError: a record of another kind.

    Example:
        >>> import tarfile, tempfile, torch_orennayar as ton
        >>> captures = ton.SyntheticCaptures("images", size=(16, 16), lights=(2, 2))
        >>> shard = ton.write_shards(captures, tempfile.mkdtemp(), 1)[0]
        >>> with tarfile.open(shard) as tar:
        ...     record = {"npz": tar.extractfile(tar.next()).read()}
        >>> bool((ton.decode_shard(record)["images"] == captures.sample(0)["images"]).all())
        True
    """
    if not isinstance(record.get("npz"), bytes):
        raise FileError(
            "record", expected="the bytes of a sample as 'npz'", got=", ".join(record), mend="leave .decode() out"
        )
    try:
        with np.load(io.BytesIO(record["npz"])) as arrays:
            return cast("SyntheticImages", {name: torch.from_numpy(arrays[name]) for name in arrays.files})
    except (ValueError, EOFError, OSError, AttributeError, zipfile.BadZipFile) as error:
        raise FileError("record", expected="a whole .npz", got=str(error)[:80], mend="write the shard again") from error


class _ShardWriter(Dataset[str]):
    """Shards by number; asking for one writes it."""

    def __init__(self, captures: SyntheticCaptures[SyntheticImages], place: Path, count: int, per_shard: int) -> None:
        self.captures, self.place, self.count, self.per_shard = captures, place, count, per_shard

    def __len__(self) -> int:
        return -(-self.count // self.per_shard)

    def path(self, number: int) -> Path:
        """A short last shard has its length in its name, so that a larger count makes it anew; a whole one stays."""
        length = min(self.per_shard, self.count - number * self.per_shard)
        whole = self.place / f"captures-{number:06d}.tar"
        return whole if length == self.per_shard or whole.exists() else whole.with_stem(f"{whole.stem}-{length}")

    def __getitem__(self, number: int) -> str:
        first = number * self.per_shard
        with atomic_path(self.path(number)) as temporary, tarfile.open(temporary, "w") as tar:
            for index in range(first, min(first + self.per_shard, self.count)):
                sample = cast("Mapping[str, Tensor]", self.captures.sample(self.captures.start + index))
                content = _pack(sample)
                entry = tarfile.TarInfo(f"{index:08d}.npz")  # its time is 0
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))
        return str(self.path(number))


def _pack(sample: Mapping[str, Tensor]) -> bytes:
    """A sample as an ``.npz`` without the time of its making."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as file:
        for name, value in sample.items():
            array = io.BytesIO()
            np.save(array, value.cpu().numpy())
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), array.getvalue(), zipfile.ZIP_DEFLATED, LEVEL)
    return packed.getvalue()


def _claim(place: Path, captures: SyntheticCaptures[SyntheticImages], per_shard: int) -> None:
    """Write down what the folder's shards are made of, or check that they are made of the same.

    Raises:
        FileError: they are not.
    """
    made = {
        "seed": captures.seed, "start": captures.start, "size": list(captures.size), "lights": list(captures.lights),
        "mix": asdict(captures.mix), "per_shard": per_shard, "meshes": _digest(captures.meshes),
    }  # fmt: skip
    made = json.loads(json.dumps(made))
    listed = place / LISTED
    if listed.is_file():
        there = read_json(listed)
        if there != made:
            differing = ", ".join(sorted(key for key in made.keys() | there.keys() if made.get(key) != there.get(key)))
            raise FileError(
                str(listed), expected="shards of these captures", got=f"others: {differing}", mend="use another folder"
            )
        return
    with atomic_path(listed) as temporary:
        temporary.write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8")


def _digest(meshes: Meshes) -> str | None:
    """A number that tells given meshes from others."""
    if meshes is None or isinstance(meshes, str):
        return meshes
    digest = hashlib.blake2b(digest_size=16)
    for part in (part for mesh in meshes for part in mesh):
        digest.update(f"{tuple(part.shape)} {part.dtype}".encode() + part.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
