"""Augmented captures still follow from what comes with them."""

from __future__ import annotations

import functools
import math

import kornia
import kornia.augmentation as K
import pytest
import torch
from torch import Tensor

from torch_orennayar import (
    AugmentCaptures,
    Ingredients,
    OrenNayar,
    RandomRelight,
    RangeError,
    ShapeError,
    SyntheticBatch,
    SyntheticCaptures,
    collate_captures,
)


@functools.cache
def batch() -> SyntheticBatch:
    """Six samples, with everything but noise, clipping and errors of calibration; half of them in perspective."""
    mix = Ingredients(noise=(0, 0), bits=(0, 0), clipped=0, light_error=0, intensity_error=0)
    captures = SyntheticCaptures("images", mix=mix, lights=(3, 5), size=(40, 48), length=6, seed=4)
    return collate_captures(list(captures))


def rendered(of: SyntheticBatch) -> Tensor:
    """The pictures from the truth, (B, K, 3, H, W)."""
    shaded: Tensor = OrenNayar("vcavity")(of["normal"], of["true_lights"], of["view"], of["albedo"], of["roughness"])
    direct = of["exposure"] * of["reached"] * shaded
    return (direct + of["between"] + of["remainder"]).clamp(0, 1) * of["mask"][:, None]


def test_the_batch_itself_follows_from_its_truth() -> None:
    assert torch.allclose(batch()["images"], rendered(batch()), atol=2e-5)


@pytest.mark.parametrize(
    "augmentations",
    [
        (K.RandomHorizontalFlip(p=1.0),),
        (K.RandomVerticalFlip(p=0.5),),
        (K.RandomHorizontalFlip(p=0.5), K.RandomVerticalFlip(p=0.5), K.RandomCrop((31, 27))),
    ],
    ids=["mirrored", "some", "several"],
)
def test_what_moves_whole_pixels_is_exact(augmentations: tuple[K.GeometricAugmentationBase2D, ...]) -> None:
    torch.manual_seed(3)
    moved = AugmentCaptures(*augmentations)(batch())
    assert torch.allclose(moved["images"] * moved["mask"][:, None], rendered(moved), atol=3e-5)
    assert not torch.equal(moved["normal"], batch()["normal"])
    assert moved["mask"].dtype == torch.bool
    assert torch.equal(moved["counts"], batch()["counts"])


def test_a_mirrored_ball_is_a_ball() -> None:
    """x of normals and lights changes its sign, columns run backward."""
    moved = AugmentCaptures(K.RandomHorizontalFlip(p=1.0))(batch())
    mirror = torch.tensor([-1.0, 1, 1])
    assert torch.allclose(moved["normal"].flip(3), batch()["normal"] * mirror[:, None, None], atol=1e-6)
    assert torch.allclose(moved["lights"], batch()["lights"] * mirror, atol=1e-6)
    assert torch.equal(moved["depth"].flip(3), batch()["depth"])


def test_a_quarter_turn() -> None:
    square = {name: batch()[name][..., :40, :40] for name in ("normal", "mask", "images")}
    square |= {"lights": batch()["lights"]}
    moved = AugmentCaptures(K.RandomRotation90((1, 1), p=1.0))(square)
    by_hand = square["normal"].rot90(1, (2, 3))
    inside = moved["mask"] & square["mask"].rot90(1, (2, 3))
    x, y, z = by_hand.unbind(1)
    assert inside.sum() > 1000
    assert torch.allclose(moved["normal"], torch.stack((-y, x, z), 1) * moved["mask"], atol=1e-3)
    x, y, z = square["lights"].unbind(2)
    assert torch.allclose(moved["lights"], torch.stack((-y, x, z), 2), atol=1e-5)


@pytest.mark.parametrize(
    "augmentation",
    [K.RandomRotation(40.0, p=1.0), K.RandomAffine(30.0, scale=(0.7, 1.4), translate=(0.1, 0.1), p=1.0),
     K.RandomResizedCrop((36, 36), scale=(0.5, 0.8), ratio=(1.0, 1.0))],
    ids=["turned", "affine", "scaled"],
)  # fmt: skip
def test_resampled_captures_render_again_nearly(augmentation: K.GeometricAugmentationBase2D) -> None:
    """Between pixels normals and pictures are blended: the middle of the differences is small."""
    torch.manual_seed(1)
    moved = AugmentCaptures(augmentation)(batch())
    inside = moved["mask"][:, None].expand_as(moved["images"])
    difference = (moved["images"] - rendered(moved))[inside].abs()
    assert inside.sum() > 10_000
    assert difference.median() < 0.01
    assert difference.quantile(0.9) < 0.06
    length = moved["normal"].norm(dim=1, keepdim=True)
    assert torch.allclose(length, moved["mask"].float(), atol=1e-4)
    assert torch.allclose(moved["view"].norm(dim=1), torch.ones_like(length[:, 0]), atol=1e-4)


OLD_KORNIA = pytest.mark.skipif(
    kornia.__version__.startswith("0.8."), reason="kornia 0.8 stretches such a crop, by unequal factors: it is refused"
)


@pytest.mark.parametrize(
    "padding",
    [K.PadTo((60, 64), pad_value=1), K.PadTo((60, 64), pad_mode="reflect"),
     pytest.param(K.RandomCrop((60, 64), padding=12, padding_mode="reflect", p=1.0), marks=OLD_KORNIA),
     K.RandomCrop((60, 64), pad_if_needed=True, fill=1, p=1.0),
     K.RandomAffine(0.0, translate=(0.4, 0.4), padding_mode="reflection", p=1.0),
     K.RandomAffine(0.0, translate=(0.4, 0.4), padding_mode="border", p=1.0)],
    ids=["filled", "mirrored", "cropped, mirrored", "cropped, filled", "moved, mirrored", "moved, repeated"],
)  # fmt: skip
def test_padding_is_no_part_of_the_object(padding: K.GeometricAugmentationBase2D) -> None:
    torch.manual_seed(2)
    moved = AugmentCaptures(padding)({**batch(), "mask": torch.ones_like(batch()["mask"])})
    assert 0 < moved["mask"].sum() <= batch()["mask"].numel()
    assert (moved["normal"] * ~moved["mask"] == 0).all()
    assert (moved["images"] * ~moved["mask"][:, None] == 0).all()


def test_masks_of_any_type_and_maps_of_float64() -> None:
    for mask in (batch()["mask"], 255 * batch()["mask"].byte()):
        torch.manual_seed(0)
        moved = AugmentCaptures(K.RandomRotation(40.0, p=1.0))({"mask": mask})["mask"]
        assert moved.sum() <= batch()["mask"].sum()
    depth = batch()["depth"].double() + 1e-12
    assert torch.equal(AugmentCaptures(K.RandomHorizontalFlip(p=1.0))({"depth": depth})["depth"], depth.flip(3))


def test_maps_of_one_pixel_stay_and_sizes_may_be_rounded() -> None:
    relit = RandomRelight(2)({"normal": batch()["normal"], "albedo": batch()["albedo"]})
    moved = AugmentCaptures(K.RandomHorizontalFlip(p=1.0))(relit)
    assert torch.equal(moved["roughness"], relit["roughness"])
    assert torch.equal(moved["lights"][..., 0], -relit["lights"][..., 0])
    assert AugmentCaptures(K.Resize((20, 24)))(batch())["normal"].shape == (6, 3, 20, 24)


def test_gradients_pass() -> None:
    normal = batch()["normal"].clone().requires_grad_()
    AugmentCaptures(K.RandomRotation(20.0, p=1.0))({"normal": normal})["normal"].square().sum().backward()
    assert normal.grad is not None
    assert normal.grad.isfinite().all()


@pytest.mark.parametrize(
    "augmentation",
    [K.RandomPerspective(p=1.0), K.RandomShear(20.0, p=1.0), K.RandomResizedCrop((20, 40), ratio=(2, 2))],
)
def test_what_distorts_angles_is_refused(augmentation: K.GeometricAugmentationBase2D) -> None:
    with pytest.raises(RangeError, match="keep angles"):
        AugmentCaptures(augmentation)(batch())


def test_mistakes() -> None:
    with pytest.raises(RangeError, match="ColorJitter"):
        AugmentCaptures(K.ColorJitter(0.1))
    with pytest.raises(ShapeError, match="one size"):
        AugmentCaptures(K.RandomHorizontalFlip())({"normal": torch.zeros(1, 3, 4, 4), "mask": torch.ones(1, 1, 5, 5)})
    flip = AugmentCaptures(K.RandomHorizontalFlip(p=1.0))
    single = {"normal": torch.zeros(3, 4, 4)}
    for wrong in (single, {"normal": torch.zeros(2, 3, 4, 4), "lights": torch.zeros(2, 3)}):
        with pytest.raises(ShapeError, match="collate_captures"):
            flip(wrong)
    with pytest.raises(ShapeError, match="add one"):
        flip({"lights": torch.zeros(2, 1, 3)})
    with pytest.raises(ShapeError, match="8-bit"):
        flip({"images": torch.zeros(2, 1, 3, 4, 4, dtype=torch.uint8)})
    for options in ({"lights": 0}, {"lights": 2.5}, {"widest": 60.0}, {"roughness": (1.0, 0.5)}, {"roughness": 0.5}):
        with pytest.raises(RangeError, match=next(iter(options))):
            RandomRelight(**options)
    with pytest.raises(ShapeError, match="normal"):
        RandomRelight()({"albedo": torch.ones(1, 1, 2, 2)})


class TestRandomRelight:
    def test_pictures_are_those_of_the_layer_under_the_new_lights(self) -> None:
        relit = RandomRelight(7, widest=0.8, generator=torch.Generator().manual_seed(0))(batch())
        maps = [relit[name] for name in ("normal", "lights", "view", "albedo", "roughness")]
        assert torch.equal(relit["images"], OrenNayar("vcavity")(*maps))
        assert relit["lights"].shape == (6, 7, 3)
        assert (relit["lights"][..., 2] >= math.cos(0.8) - 1e-6).all()
        assert relit["roughness"] is batch()["roughness"]
        assert not {"reached", "between", "exposure", "counts"} & relit.keys()

    def test_seeded_lights_spread_over_the_cap(self) -> None:
        """Uniform on the sphere's cap: cosines are uniform, directions have no preferred side."""
        normal = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
        lights = [
            RandomRelight(4000, generator=torch.Generator().manual_seed(s))({"normal": normal})["lights"][0]
            for s in (0, 0, 1)
        ]
        assert torch.equal(lights[0], lights[1])
        assert not torch.equal(lights[0], lights[2])
        assert abs(float(lights[0][:, 2].mean()) - 0.75) < 0.01
        assert lights[0][:, :2].mean(0).abs().max() < 0.02

    def test_gradients_reach_normals_and_albedo(self) -> None:
        normal = torch.nn.functional.normalize(torch.rand(2, 3, 4, 4, dtype=torch.float64) + 0.5, dim=1)
        albedo = torch.rand(2, 1, 4, 4, dtype=torch.float64)
        assert torch.autograd.gradcheck(
            lambda n, a: RandomRelight(3, generator=torch.Generator().manual_seed(0))(
                {"normal": torch.nn.functional.normalize(n, dim=1), "albedo": a, "roughness": torch.full_like(a, 0.4)}
            )["images"],
            (normal.requires_grad_(), albedo.requires_grad_()),
        )
