"""Synthetic captures: what is switched off is not there, what is left is the truth, and indices decide everything."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path
from typing import Any, cast

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.multiprocessing.spawn import spawn
from torch.utils.data import DataLoader

import torch_orennayar as ton
from torch_orennayar import Ingredients, RangeError, SyntheticCaptures, SyntheticImages, SyntheticPixels
from torch_orennayar.synthetic.materials import transmitted

PLAIN = Ingredients(
    rough=0, glazed=0, retro=0, falloff=0, glossy=0, metal=0, sheen=0, shadows=0, bounce=False, ambient=0,
    light_error=0, intensity_error=0, noise=(0, 0), clipped=0, outliers=0, bits=(24, 24),
)  # fmt: skip


def tensors(sample: SyntheticPixels | SyntheticImages) -> Mapping[str, Tensor]:
    """For tests that go over all tensors of a sample."""
    return cast("Mapping[str, Tensor]", sample)


def lambert(sample: SyntheticPixels) -> Tensor:
    return (sample["lights"] * sample["normal"][:, None]).sum(2).clamp_min(0)


def scaled(values: Tensor) -> Tensor:
    return values / values.amax(1, keepdim=True).clamp_min(1e-9)


def test_nothing_but_lambert_is_left_of_plain_pixels() -> None:
    sample = SyntheticCaptures(mix=PLAIN).sample(3)
    assert torch.allclose(scaled(sample["observed"]), scaled(lambert(sample)), atol=2e-4)


def test_rough_pixels_are_those_of_the_model() -> None:
    """The same draw with roughness allowed: between Lambert and the roughest, and other than Lambert."""
    sample = SyntheticCaptures(mix=replace(PLAIN, rough=1.0)).sample(3)
    difference = (scaled(sample["observed"]) - scaled(lambert(sample))).abs()
    assert 0.02 < difference.mean() < 0.3


@pytest.mark.parametrize("index", [1.0, 1.3, 1.5, 2.4])
def test_what_an_interface_lets_through(index: float) -> None:
    """Fresnel's equations in angles."""
    outside = torch.linspace(0.01, 1.57, 200, dtype=torch.float64)
    within = (outside.sin() / index).asin()
    back = ((outside - within).sin() / (outside + within).sin()) ** 2
    back = back + ((outside - within).tan() / (outside + within).tan()) ** 2
    assert torch.allclose(transmitted(outside.cos(), index), 1 - back / 2, atol=1e-10)
    facing = transmitted(torch.tensor(1.0, dtype=torch.float64), index)
    assert abs(facing - (1 - ((index - 1) / (index + 1)) ** 2)) < 1e-12


@pytest.mark.parametrize(
    ("ingredient", "value"),
    [("glossy", 1.0), ("sheen", 1.0), ("shadows", 3), ("ambient", 0.2), ("light_error", 0.05), ("retro", 1.0),
     ("intensity_error", 0.1), ("noise", (0.05, 0.0)), ("noise", (0.0, 0.05)), ("clipped", 1.0), ("outliers", 1.0),
     ("bits", (3.0, 3.0)), ("falloff", 1.0), ("glazed", 1.0)],
)  # fmt: skip
def test_every_switch_changes_what_is_seen(ingredient: str, value: object) -> None:
    mix = replace(PLAIN, rough=1.0, easy=0.0)
    before = SyntheticCaptures(mix=mix).sample(5)
    after = SyntheticCaptures(mix=replace(mix, **{ingredient: value})).sample(5)  # type: ignore[arg-type]
    assert torch.equal(before["normal"], after["normal"])
    changed = "lights" if ingredient == "light_error" else "observed"
    assert not torch.equal(tensors(before)[changed], tensors(after)[changed])


def test_easy_pixels_have_no_walls_and_no_bad_photographs() -> None:
    mix = replace(PLAIN, shadows=3, bounce=True, outliers=1.0, sheen=1.0, easy=1.0)
    sample = SyntheticCaptures(mix=mix).sample(1)
    assert torch.allclose(scaled(sample["observed"]), scaled(lambert(sample)), atol=2e-4)


@given(
    seed=st.integers(0, 2**31),
    index=st.integers(0, 2**40),
    most=st.integers(3, 30),
    switches=st.dictionaries(
        st.sampled_from(
            ["rough", "glazed", "retro", "falloff", "glossy", "metal", "sheen", "clipped", "outliers", "easy"]
        ),
        st.sampled_from([0.0, 0.5, 1.0]),
    ),
)
def test_any_mix_gives_sound_samples(seed: int, index: int, most: int, switches: dict[str, float]) -> None:
    captures = SyntheticCaptures(seed=seed, mix=Ingredients(**switches), lights=(3, most), observations=300)  # type: ignore[arg-type]
    sample, again = captures.sample(index), captures.sample(index)
    assert all(torch.equal(value, tensors(again)[name]) for name, value in tensors(sample).items())
    observed, lights, normal = sample["observed"], sample["lights"], sample["normal"]
    assert observed.shape == lights.shape[:2]
    assert 3 <= observed.shape[1] <= most
    assert observed.min() >= 0
    assert observed.max() <= 1
    assert torch.allclose(lights.norm(dim=2), torch.ones_like(observed), atol=1e-5)
    assert torch.allclose(normal.norm(dim=1), torch.ones(len(normal)), atol=1e-5)
    assert (normal[:, 2] > 0).all()


def test_workers_and_ranks_share_the_indices() -> None:
    """Two ranks with two workers each see what one process sees, every capture once."""
    alone = [s["observed"] for s in SyntheticCaptures(seed=4, observations=60, length=9)]
    together: list[Tensor] = []
    for rank in range(2):
        captures = SyntheticCaptures(seed=4, observations=60, length=9, rank=rank, world=2)
        together += [s["observed"] for s in DataLoader(captures, batch_size=None, num_workers=2)]
    assert sorted(float(t.sum()) for t in together) == sorted(float(t.sum()) for t in alone)
    later = next(iter(SyntheticCaptures(seed=4, observations=60, start=5)))
    assert torch.equal(later["observed"], alone[5])


def test_seeds_and_indices_differ() -> None:
    sums = {
        float(SyntheticCaptures(seed=s, observations=60).sample(k)["observed"].sum()) for s in (0, 1) for k in (0, 1)
    }
    assert len(sums) == 4


@pytest.mark.parametrize(
    "options",
    [
        {"kind": "films"},
        {"lights": (2, 9)},
        {"lights": (9, 5)},
        {"scenes": -1},
        {"kind": "images", "scenes": 2},
        {"scenes": 2, "lights": (60, 70)},
        {"rank": 2, "world": 2},
    ],
)
def test_mistakes(options: dict[str, object]) -> None:
    with pytest.raises(ton.RangeError):
        SyntheticCaptures(**options)  # type: ignore[call-overload]


def in_scenes(
    count: int, meshes: list[tuple[Tensor, Tensor]] | None = None, **switches: object
) -> list[SyntheticPixels]:
    """The first samples of a source that stand in a scene: their lights are the same for all pixels."""
    mix = replace(PLAIN, **switches)  # type: ignore[arg-type]
    source = SyntheticCaptures(mix=mix, scenes=1, meshes=meshes, observations=2000, lights=(12, 40))
    samples = (source.sample(k) for k in range(40))
    return list(islice((s for s in samples if bool((s["lights"] == s["lights"][:1]).all())), count))


RIDGE = torch.tensor([[-1.0, -1, 0], [-1, 1, 0], [0, -1, -1], [0, 1, -1], [1, -1, 0], [1, 1, 0]])
"""Two walls at right angles."""
WALLS = torch.tensor([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])


class TestScenes:
    def test_plain_pixels_of_a_scene_are_lamberts(self) -> None:
        for sample in in_scenes(3):
            assert torch.allclose(scaled(sample["observed"]), scaled(lambert(sample)), atol=2e-4)

    def test_other_parts_stand_in_the_way_of_lights(self) -> None:
        """Some observations are dark that are turned to their light, the others stay as they were."""
        (plain,), (shaded,) = in_scenes(1), in_scenes(1, shadows=3)
        assert torch.equal(plain["normal"], shaded["normal"])
        before, after = scaled(lambert(plain)), scaled(shaded["observed"])
        whole = (after - before).abs().amax(1) < 1e-3  # pixels that every light reaches
        assert 0.2 < whole.float().mean() < 1
        assert ((after < 0.01) & (before > 0.2)).any()

    @pytest.mark.slow
    def test_walls_at_right_angles_light_each_other_and_a_flat_one_does_not(self) -> None:
        for faces, gains in ((WALLS, True), (WALLS[:2], False)):
            (plain,), (lit,) = (in_scenes(1, [(RIDGE, faces)], bounce=b) for b in (False, True))
            brighter = lit["observed"].mean(1) / lit["observed"].amax(1) > 1.01 * scaled(plain["observed"]).mean(1)
            assert bool(brighter.any()) == gains

    @pytest.mark.slow
    def test_a_mesh_that_shows_nothing_is_an_error(self) -> None:
        line = torch.tensor([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]], dtype=torch.float64), torch.tensor([[0, 1, 2]])
        source = SyntheticCaptures(scenes=1, meshes=[line])
        with pytest.raises(ton.RangeError, match="meshes"):
            [source.sample(k) for k in range(20)]

    @pytest.mark.slow
    def test_what_was_drawn_before_does_not_matter(self) -> None:
        def source() -> SyntheticCaptures[SyntheticPixels]:
            return SyntheticCaptures(scenes=2, observations=300, lights=(12, 20), seed=2)

        fresh, used = source(), source()
        wanted = [fresh.sample(k)["observed"] for k in range(12)]
        assert len(fresh._rendered) == 2
        for k in reversed(range(12)):
            assert torch.equal(used.sample(k)["observed"], wanted[k])

    @pytest.mark.parametrize("workers", [0, 2])
    @pytest.mark.slow
    def test_scenes_rendered_before_are_those_rendered_when_needed(self, workers: int) -> None:
        before, later = (SyntheticCaptures("pixels", scenes=3, observations=600) for _ in range(2))
        before.render_scenes(workers)
        for index in range(8):
            for name, value in tensors(before.sample(index)).items():
                assert torch.equal(value, tensors(later.sample(index))[name])

    def test_there_are_as_many_lights_as_asked_for(self) -> None:
        source = SyntheticCaptures(scenes=1, lights=(20, 70), observations=700)
        counts = [source.sample(k)["lights"].shape[1] for k in range(12)]
        assert all(20 <= count <= 70 for count in counts)
        assert 48 in counts


class TestImages:
    @pytest.mark.parametrize("index", range(6))
    def test_plain_pictures_are_albedo_times_cosine(self, index: int) -> None:
        sample = SyntheticCaptures("images", mix=PLAIN, lights=(4, 9), size=(40, 48)).sample(index)
        count = len(sample["lights"])
        assert sample["images"].shape == (count, 3, 40, 48)
        inside = sample["mask"][0]
        assert 100 < int(inside.sum()) < 40 * 48
        normal = sample["normal"][:, inside]
        assert torch.allclose(normal.norm(dim=0), torch.ones(normal.shape[1]), atol=1e-5)
        expected = sample["albedo"][:, inside] * (sample["lights"] @ normal).clamp_min(0)[:, None]  # (K, 3, P)
        seen = sample["images"][:, :, inside]
        kept = (seen > 0) & (
            seen < 1
        )  # the brightest thousandth saturates; pixels turned away from the camera are dark
        ratio = seen[kept] / expected[kept]
        assert torch.allclose(ratio, ratio.median().expand_as(ratio), rtol=1e-2)
        assert (sample["images"][:, :, ~inside] == 0).all()

    @pytest.mark.slow
    def test_photometric_stereo_finds_the_truth(self) -> None:
        """With roughness, texture and noise, without shadows and highlights."""
        mix = replace(PLAIN, rough=1.0, noise=(0.005, 0.0))
        sample = SyntheticCaptures("images", mix=mix, lights=(30, 30), size=(64, 64)).sample(2)
        found = ton.photometric_stereo(sample["images"], sample["lights"], sample["mask"], model="vcavity")
        error = ton.angular_error(found.normal, sample["normal"], sample["mask"]).summary()
        assert error["median"] < 2.5
        assert math.degrees(float((found.roughness - sample["roughness"]).abs().max())) < 8

    def test_cast_shadows_only_take_light_away(self) -> None:
        captures = [SyntheticCaptures("images", mix=replace(PLAIN, shadows=n), lights=(12, 12)) for n in (0, 1)]
        lit, shaded = (torch.stack([c.sample(k)["images"].flatten() for k in (2, 5, 8)]) for c in captures)
        dark = shaded < 0.5 * lit
        assert dark.float().mean() > 0.002
        assert (shaded <= lit * 1.05 + 1e-3)[~dark].all()

    def test_hollows_light_themselves_and_flat_parts_do_not(self) -> None:
        """Two walls at right angles: each sends light to the other, most near the edge; a single wall gets none."""
        for triangles, gains in ((WALLS, True), (WALLS[:2], False)):
            plain, lit = (
                SyntheticCaptures(
                    "images", mix=replace(PLAIN, bounce=b), lights=(4, 4), meshes=[(RIDGE, triangles)], seed=3
                )
                for b in (False, True)
            )
            changed = 0
            for index in range(8):
                before, after = plain.sample(index), lit.sample(index)
                assert torch.equal(before["normal"], after["normal"])
                if torch.allclose(before["images"], after["images"], atol=1e-4):
                    continue
                changed += 1
                means = [float((s["images"] / s["images"].amax()).mean()) for s in (before, after)]
                assert means[1] > means[0]
            assert (changed > 4) if gains else changed == 0

    def test_given_meshes_are_used_and_turned(self) -> None:
        corners = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
        faces = torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
        captures = SyntheticCaptures("images", mix=PLAIN, lights=(3, 3), meshes=[(corners, faces)])
        masks = [captures.sample(k)["mask"] for k in range(3)]
        assert all(100 < int(m.sum()) < 3000 for m in masks)
        assert not torch.equal(masks[0], masks[1])

    @given(index=st.integers(0, 2**31))
    @pytest.mark.slow
    def test_any_picture_is_sound(self, index: int) -> None:
        sample = SyntheticCaptures("images", lights=(3, 8), size=(24, 32)).sample(index)
        assert all(bool(value.isfinite().all()) for value in tensors(sample).values())
        assert sample["images"].min() >= 0
        assert sample["images"].max() <= 1
        assert bool(sample["mask"].any())
        assert F.normalize(sample["lights"], dim=1).allclose(sample["lights"], atol=1e-5)


def test_every_ingredient_is_documented() -> None:
    for field in fields(Ingredients):
        assert f"    {field.name}: " in (Ingredients.__doc__ or "")


def test_samples_collate_into_batches() -> None:
    captures = SyntheticCaptures("images", lights=(3, 3), size=(16, 20), length=4)
    for batch in DataLoader(captures, batch_size=2):
        assert batch["images"].shape == (2, 3, 3, 16, 20)
        assert batch["mask"].dtype == torch.bool


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lights": 4}, "fewest and most"),
        ({"lights": (4.0, 8.0)}, "fewest and most"),
        ({"seed": "one"}, "whole number"),
        ({"length": -1}, "whole number"),
        ({"kind": "images", "size": 64}, "in pixels"),
        ({"mix": {"rough": 1}}, "Ingredients"),
        ({"kind": "images", "meshes": ["bunny.obj"]}, "load_mesh"),
        ({"kind": "images", "meshes": "bunny.obj"}, "list"),
        ({"kind": "images", "meshes": []}, "list"),
        ({"kind": "images", "meshes": [(torch.eye(3).numpy(), torch.tensor([[0, 1, 2]]).numpy())]}, "tensor"),
        ({"kind": "images", "meshes": [(torch.eye(3), torch.tensor([[0, 1, 3]]))]}, "indices"),
        ({"kind": "images", "meshes": [(torch.eye(3) / 0, torch.tensor([[0, 1, 2]]))]}, "finite"),
    ],
)
def test_arguments_of_other_types(options: dict[str, object], words: str) -> None:
    with pytest.raises((ton.RangeError, ton.ShapeError), match=words):
        SyntheticCaptures(**options)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "options",
    [
        {"rough": 30}, {"rough": math.nan}, {"glossy": -0.1}, {"roughest": 30}, {"shadows": -1}, {"noise": 0.1},
        {"noise": (0.1, math.inf)}, {"bits": (12, 8)}, {"bits": (0, 8)}, {"easy": "no"},
    ],
)  # fmt: skip
def test_ingredients_out_of_range(options: dict[str, object]) -> None:
    with pytest.raises(ton.RangeError, match=next(iter(options))):
        Ingredients(**options)  # type: ignore[arg-type]


def _draw_in_a_group(rank: int, place: str) -> None:
    """One of two processes that make their captures before they join."""
    captures = SyntheticCaptures(seed=4, observations=60, length=6)
    torch.distributed.init_process_group("gloo", init_method=f"file://{place}/group", rank=rank, world_size=2)
    workers = DataLoader(captures, batch_size=None, num_workers=1, multiprocessing_context="spawn")
    sums = [[float(s["observed"].sum()) for s in source] for source in (captures, workers)]
    torch.save(sums, f"{place}/{rank}.pt")
    torch.distributed.destroy_process_group()


@pytest.mark.slow
def test_the_process_group_is_asked_when_iteration_begins(tmp_path: Path) -> None:
    spawn(_draw_in_a_group, (str(tmp_path),), nprocs=2)
    alone = [float(s["observed"].sum()) for s in SyntheticCaptures(seed=4, observations=60, length=6)]
    for rank in range(2):
        assert torch.load(tmp_path / f"{rank}.pt") == [alone[rank::2]] * 2


def test_batches_of_different_numbers_of_lights() -> None:
    captures = SyntheticCaptures("images", lights=(3, 9), size=(12, 10), length=3, seed=2)
    samples = list(captures)
    batch = next(iter(DataLoader(captures, batch_size=3, collate_fn=ton.collate_captures)))
    counts = [len(s["lights"]) for s in samples]
    assert len(set(counts)) > 1
    assert batch["counts"].tolist() == counts
    assert batch["images"].shape == (3, max(counts), 3, 12, 10)
    for b, (sample, count) in enumerate(zip(samples, counts, strict=True)):
        assert torch.equal(batch["images"][b, :count], sample["images"])
        assert torch.equal(batch["lights"][b, :count], sample["lights"])
        assert batch["valid"][b, :count].all()
        assert not batch["valid"][b, count:].any()
        assert torch.equal(batch["normal"][b], sample["normal"])
    assert torch.allclose(batch["lights"].norm(dim=2), torch.ones(()))
    with pytest.raises(ton.ShapeError, match="batch_size=None"):
        ton.collate_captures([SyntheticCaptures(observations=60).sample(0)])  # type: ignore[list-item]
    with pytest.raises(ton.ShapeError, match="one size"):
        ton.collate_captures([samples[0], SyntheticCaptures("images", lights=(3, 3), size=(8, 8)).sample(0)])


@pytest.mark.parametrize("index", [-1, "0", 1.5])
def test_a_number_that_no_capture_has(index: Any) -> None:
    with pytest.raises(RangeError, match="from 0 on"):
        SyntheticCaptures("images", size=(16, 16)).sample(index)
