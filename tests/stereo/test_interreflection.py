"""Light between the parts of a surface: the renders know what each part sends, the solver does not."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import rendered_captures
from torch_orennayar import Finding, angular_error, photometric_stereo
from torch_orennayar.stereo import interreflection, solver
from torch_orennayar.stereo.interreflected_light import InterreflectedLight
from torch_orennayar.stereo.interreflection import choose_interreflected_light, find_interreflected_light
from torch_orennayar.stereo.material import Material

LIGHTS = F.normalize(torch.tensor([[0.2, 0.0, 1], [-0.2, 0.1, 1], [0.0, 0.3, 1], [0.0, -0.2, 1]]), dim=1)


def groove(length: int, width: int) -> Tensor:
    """Photographs (K, 1, length, 2 width) of two walls at right angles, white, nothing but the lights."""
    normal = torch.zeros(3, length, 2 * width)
    normal[0, :, :width], normal[0, :, width:] = math.sqrt(0.5), -math.sqrt(0.5)
    normal[2] = math.sqrt(0.5)
    return torch.einsum("kc,chw->khw", LIGHTS, normal)[:, None]


@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.8])
@pytest.mark.slow
def test_hollows_determine_the_albedo_and_then_their_shape(
    meshes: dict[str, tuple[Tensor, Tensor]], albedo: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exposure is unknown, so that albedo shows in nothing but the light between the balls."""
    scene = rendered_captures.hollow_capture(meshes["balls"], albedo, size=96)
    interreflected, finding = choose_interreflected_light(scene.images, scene.lights, scene.mask[0], Material(), 0)
    assert interreflected is not None
    assert abs(interreflected.strength - albedo) <= 0.2
    assert finding.code == "interreflection-removed"
    assert finding.value == interreflected.strength
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    assert finding in found.report
    kept = Finding("not looked for", "interreflection-kept")
    monkeypatch.setattr(solver, "choose_interreflected_light", lambda *given, **options: (None, kept))
    without = photometric_stereo(scene.images, scene.lights, scene.mask)
    errors = [angular_error(f.normal, scene.normal, scene.mask).summary()["mean"] for f in (found, without)]
    assert errors[0] < 0.9 * errors[1]


@pytest.mark.slow
def test_a_body_without_hollows_is_left_alone(meshes: dict[str, tuple[Tensor, Tensor]]) -> None:
    scene = rendered_captures.hollow_capture(meshes["bumps"], 0.8, size=96)
    interreflected, finding = choose_interreflected_light(scene.images, scene.lights, scene.mask[0], Material(), 0)
    assert interreflected is None
    assert finding.code == "interreflection-kept"
    assert "hardly" in finding


@pytest.mark.slow
def test_shadows_without_bounces_are_not_taken_for_some(meshes: dict[str, tuple[Tensor, Tensor]]) -> None:
    """As dark a surface as there is: hollows that send nothing."""
    scene = rendered_captures.hollow_capture(meshes["balls"], 1e-3, size=96)
    interreflected, finding = choose_interreflected_light(scene.images, scene.lights, scene.mask[0], Material(), 0)
    assert interreflected is None
    assert finding.code == "interreflection-kept"
    assert "no better" in finding


@pytest.mark.parametrize("most", [100, 10_000])
def test_two_parts_that_are_not_connected_do_not_light_each_other(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their distance along the view is unknown; also where light is followed on a smaller picture."""
    monkeypatch.setattr(interreflection, "MOST_PIXELS", most)
    tent = torch.zeros(3, 40, 41)
    tent[0, :, :20], tent[0, :, 21:] = 0.6, -0.6  # two walls that face each other, a gap of one column between
    tent[2] = 0.8
    inside = torch.ones(40, 41, dtype=torch.bool)
    inside[:, 20] = False
    lights = F.normalize(torch.tensor([[0.5, 0, 1], [-0.5, 0.1, 1], [0.1, 0.5, 1], [0, -0.5, 1]]), dim=1)
    images = torch.einsum("kc,chw->khw", lights, tent).clamp_min(0)[:, None] * inside
    assert find_interreflected_light(images, lights, inside).share.abs().max() < 1e-6  # a wall and itself, rounded
    joined = torch.ones_like(inside)
    assert find_interreflected_light(torch.where(joined, images + 1e-3, 0), lights, joined).share.max() > 0.05


@pytest.mark.slow
def test_rows_pixels_and_the_whole_agree(
    meshes: dict[str, tuple[Tensor, Tensor]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light is followed at half the size here."""
    monkeypatch.setattr(interreflection, "MOST_PIXELS", 5000)
    scene = rendered_captures.hollow_capture(meshes["balls"], 0.6, size=201, lights=4)
    found = find_interreflected_light(scene.images, scene.lights, scene.mask[0])
    assert found.share.shape == (4, 1, 101, 101)
    interreflected = InterreflectedLight(found.share, found.factor, 0.5)
    whole = interreflected.removed_from(scene.images, 0)
    assert torch.allclose(interreflected.removed_from(scene.images[:, :, 60:90], 60), whole[:, :, 60:90], atol=1e-6)
    picked = scene.mask.flatten().nonzero().flatten()[::37]
    colours = torch.cat((scene.images, scene.images / 2), 1)
    interreflected = InterreflectedLight(found.share.expand(-1, 2, -1, -1), found.factor, 0.5)
    taken = (colours - interreflected.removed_from(colours, 0)).flatten(2)[:, :, picked].permute(2, 1, 0)
    seen = colours.flatten(2)[:, :, picked].permute(2, 1, 0)
    assert torch.allclose(interreflected.at(seen, picked, 201), taken, atol=1e-6)
    assert torch.equal(InterreflectedLight(found.share, found.factor, 0.0).removed_from(scene.images, 0), scene.images)


def test_what_arrives_in_a_groove() -> None:
    """A long right-angled groove, both walls even: the other wall fills a known share of every point's sky.

    A point at distance x along its wall of width w sees the other with the form factor (1 - x / sqrt(x^2 + w^2)) / 2
    of two perpendicular strips of infinite length.
    """
    width, length = 24, 300
    images = groove(length, width)
    share = find_interreflected_light(images, LIGHTS, torch.ones(length, 2 * width, dtype=torch.bool)).share
    strip = (torch.arange(width) + 0.5).flip(0)  # along the slope, in any unit
    factor = (1 - strip / (strip.square() + width**2).sqrt()) / 2
    mean = images[:, 0, 150].mean(0)
    other = images[:, 0, 150, width:].mean(1, keepdim=True)  # what the other wall shows
    wanted = factor * other / mean[:width]
    got = share[:, 0, 120:180, :width].mean(1)
    assert torch.allclose(got[:, :-4], wanted[:, :-4], rtol=0.05)  # the bottom is rounded


def test_black_patches_of_signed_noise_receive_nothing_absurd() -> None:
    """A dark frame taken away leaves means about 0; nothing is taken out of them, or of what is beside them."""
    images = groove(80, 30)
    clean = images.clone()
    images[:, :, 30:40, 10:20] = 1e-3 * torch.randn(4, 1, 10, 10, generator=torch.Generator().manual_seed(0))
    inside = torch.ones(80, 60, dtype=torch.bool)
    for factor, most in ((1, 10_000), (4, 400)):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(interreflection, "MOST_PIXELS", most)
            interreflected = find_interreflected_light(images, LIGHTS, inside)
            usual = clean - find_interreflected_light(clean, LIGHTS, inside).removed_from(clean, 0)
        assert interreflected.factor == factor
        taken = (images - interreflected.removed_from(images, 0)).abs()
        assert taken.max() < 1.1 * usual.max()
        assert taken[:, :, 32:38, 12:18].max() < 0.01


def test_sparse_masks_and_gaps_in_light_maps() -> None:
    images = LIGHTS[:, 2:, None, None].expand(-1, -1, 80, 80).contiguous()
    inside = torch.zeros(80, 80, dtype=torch.bool)
    inside[::4, ::4] = True
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(interreflection, "MOST_PIXELS", 50)
        assert find_interreflected_light(images, LIGHTS, inside).share.max() == 0
        inside[:40] = True
        maps = torch.where(inside, LIGHTS[:, :, None, None], torch.nan)
        assert find_interreflected_light(images, maps, inside).share.isfinite().all()


def test_few_pixels_decide_nothing() -> None:
    inside = torch.zeros(20, 20, dtype=torch.bool)
    inside[5:9, 5:9] = True
    interreflected, finding = choose_interreflected_light(
        torch.ones(8, 1, 20, 20), torch.zeros(8, 3), inside, Material(), 0
    )
    assert interreflected is None
    assert finding.code == "interreflection-kept"
    assert "hardly" in finding
