"""Synthetic captures on disk: what WebDataset reads is what was made, and an interrupted run goes on."""

from __future__ import annotations

import gc
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import cast

import pytest
import torch
from torch import Tensor

import torch_orennayar as ton
from tests.support.command_line import Run
from torch_orennayar import FileError, RangeError, SyntheticCaptures, SyntheticImages


def captures(**options: int) -> SyntheticCaptures[SyntheticImages]:
    return SyntheticCaptures("images", lights=(2, 3), size=(16, 20), **options)  # type: ignore[call-overload, no-any-return]


def test_webdataset_reads_what_was_made(tmp_path: Path) -> None:
    import webdataset

    shards = ton.write_shards(captures(seed=2), tmp_path, 5, per_shard=2)
    assert [s.name for s in shards] == ["captures-000000.tar", "captures-000001.tar", "captures-000002-1.tar"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # WebDataset leaves files open
        read = list(webdataset.WebDataset([str(s) for s in shards], shardshuffle=False).map(ton.decode_shard))
        gc.collect()
    assert len(read) == 5
    for index, sample in enumerate(read):
        made = captures(seed=2).sample(index)
        assert sample.keys() - {"__key__"} == made.keys()
        for name, value in made.items():
            assert torch.equal(cast("Tensor", value), sample[name]), name
    assert ton.collate_captures(read)["images"].shape[0] == 5


@pytest.mark.slow
def test_shards_do_not_depend_on_workers(tmp_path: Path) -> None:
    alone = ton.write_shards(captures(), tmp_path / "a", 5, per_shard=2)
    together = ton.write_shards(captures(), tmp_path / "b", 5, per_shard=2, workers=2)
    assert [a.read_bytes() for a in alone] == [b.read_bytes() for b in together]


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = SyntheticCaptures.sample

    def interrupted(self: SyntheticCaptures[SyntheticImages], index: int) -> SyntheticImages:
        if index == 3:
            raise KeyboardInterrupt
        return sample(self, index)

    with monkeypatch.context() as patch:
        patch.setattr(SyntheticCaptures, "sample", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ton.write_shards(captures(), tmp_path, 4, per_shard=2)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["captures-000000.tar", "captures.json"]
    before = (tmp_path / "captures-000000.tar").stat().st_mtime_ns
    shards = ton.write_shards(captures(), tmp_path, 4, per_shard=2)
    assert all(s.is_file() for s in shards)
    assert shards[0].stat().st_mtime_ns == before
    ton.write_shards(captures(), tmp_path, 5, per_shard=2)
    more = ton.write_shards(captures(), tmp_path, 7, per_shard=2)
    assert sorted(tmp_path.glob("*.tar")) == more
    assert len(more) == 4
    fewer = ton.write_shards(captures(), tmp_path, 3, per_shard=2)
    assert fewer == more[:2]
    assert sorted(tmp_path.glob("*.tar")) == more  # the whole shard holds what a short one would


def test_shards_of_other_captures_are_not_mixed(tmp_path: Path) -> None:
    ton.write_shards(captures(), tmp_path, 1)
    with pytest.raises(FileError, match="others: seed"):
        ton.write_shards(captures(seed=1), tmp_path, 2)
    with pytest.raises(RangeError, match="images"):
        ton.write_shards(SyntheticCaptures(), tmp_path, 2)  # type: ignore[arg-type]
    for count in (0, 2.5):
        with pytest.raises(RangeError, match="count"):
            ton.write_shards(captures(), tmp_path, count)  # type: ignore[arg-type]
    with pytest.raises(RangeError, match="at most 3"):
        ton.write_shards(captures(length=3), tmp_path, 5)
    faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    for seed, other in ((0, False), (1, True)):
        mesh = torch.rand(4, 3, generator=torch.Generator().manual_seed(seed)), faces
        source = SyntheticCaptures("images", lights=(2, 3), size=(16, 20), meshes=[mesh])
        with pytest.raises(FileError, match="others: meshes") if other else nullcontext():
            ton.write_shards(source, tmp_path / "meshes", 1)
    with pytest.raises(FileError, match="whole"):
        ton.decode_shard({"npz": b"abc"})
    with pytest.raises(FileError, match="decode"):
        ton.decode_shard({"npz": {"images": 0}})


def test_the_command(orennayar: Run, tmp_path: Path) -> None:
    command = ("synthesize", "-n", 3, "--size", 16, "--lights", 1, "--per-shard", 2, "-o", tmp_path)
    result = orennayar(*command)
    assert result.status == 0, result.err
    assert "3 captures in 2 shards" in result.out
    assert orennayar(*command, "--seed", 5).status == 1
