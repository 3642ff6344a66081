"""Shape from shading, judged on surfaces with exact normals whose pictures the theory makes, not the model fitted."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import height_fields
from tests.support.height_fields import Field, light_at, photograph
from torch_orennayar import (
    MODELS,
    BatchReconstruction,
    Camera,
    CaptureError,
    OrenNayar,
    RangeError,
    Reconstruction,
    ShapeError,
    angular_error,
    depth_to_normals,
    point_light,
    shape_from_shading,
    silhouette_normals,
)

SIZE = 160
LIGHT = light_at(30)


def codes(found: Reconstruction) -> set[str]:
    return {finding.code for finding in found.report}


def errors(found: Reconstruction, field: Field) -> dict[str, float]:
    return angular_error(found.normal, field.normal.float(), field.mask).summary()


@pytest.fixture(scope="module")
def bumpy() -> Field:
    return height_fields.make("bumpy ellipsoid", SIZE)


@pytest.mark.slow
def test_pictures_are_the_theorys(bumpy: Field) -> None:
    """The table that makes them against the quadrature itself."""
    image = photograph(bumpy, LIGHT, math.radians(40), noise=0)
    place = (bumpy.mask[0] & (image[0] > 0.02)).nonzero()[::97]
    normal = bumpy.normal[:, place[:, 0], place[:, 1]].float()
    ci = LIGHT @ normal
    args = (ci, normal[2], torch.full_like(ci, LIGHT[2].item()), torch.full_like(ci, 0.8), torch.full_like(ci, 0.6981))
    wanted = MODELS["theory"].function(*args) * ci
    assert (image[0, place[:, 0], place[:, 1]] - wanted).abs().max() < 0.004


@pytest.mark.parametrize("degrees", [30, 45])
@pytest.mark.slow
def test_rough_surfaces_need_a_rough_model(bumpy: Field, degrees: int) -> None:
    """The bars: median 2 degrees, mean 4, a third of what Lambert gives; the classic form is worse than Lambert.

    The others are asked for what they read in the picture alone: left to themselves they notice that they do not
    understand it, and fall back on the silhouette.
    """
    sigma = math.radians(degrees)
    image = photograph(bumpy, LIGHT, sigma)
    found = errors(shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=sigma), bumpy)
    lambert, classic = (
        errors(
            shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=sigma, model=model, silhouette=0), bumpy
        )
        for model in ("lambert", "qualitative")
    )
    assert found["median"] <= 2.0
    assert found["mean"] <= 4.0
    assert found["median"] <= lambert["median"] / 3
    assert classic["median"] > lambert["median"]


@pytest.mark.slow
def test_the_simplest_sufficient_model_is_taken(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, 0.0)[:, ::4, ::4]
    mask = bumpy.mask[:, ::4, ::4]
    for roughness, model in ((0.0, "lambert"), (0.5, "vcavity"), (None, "vcavity")):
        found = shape_from_shading(image, LIGHT, mask, albedo=0.8, roughness=roughness)
        assert found.model == model
        assert found.report[0].code == "model-chosen"
        assert f"{model} errs by" in found.report[0]
    maps = torch.full_like(image, 0.8), torch.zeros_like(image)
    assert shape_from_shading(image, LIGHT, mask, albedo=maps[0], roughness=maps[1]).model == "lambert"


@pytest.mark.slow
def test_smooth_surfaces_are_no_worse_than_by_lambert(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, 0.0)
    found = errors(shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.0), bumpy)
    lambert = errors(shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, model="lambert"), bumpy)
    assert found["median"] <= lambert["median"] * 1.02
    assert found["median"] <= 2.0


@pytest.mark.slow
def test_depth_belongs_to_the_normals(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, 0.5)
    found = shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5)
    assert found.depth is not None
    inner = -F.max_pool2d(-bumpy.mask.float(), 9, 1, 4) > 0
    again = depth_to_normals(found.depth, mask=bumpy.mask)
    assert angular_error(again, found.normal, inner).summary()["median"] < 1.5
    difference = (found.depth - bumpy.height)[inner]
    assert (difference - difference.mean()).abs().mean() < 0.03 * SIZE


@pytest.mark.slow
def test_result_is_the_same_again_and_in_a_batch(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, 0.5)
    alone = shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5)
    both = shape_from_shading(
        torch.stack((image, image)), LIGHT.expand(2, 3), bumpy.mask.expand(2, 1, -1, -1), albedo=0.8, roughness=0.5
    )
    assert isinstance(both, BatchReconstruction)
    assert both.model == (alone.model, alone.model)
    assert [(f.code, f.value) for f in both.report] == [(f.code, f.value) for f in alone.report] * 2
    assert both.report[-1] == f"capture 1: {alone.report[-1]}"
    assert both.depth is not None
    assert alone.depth is not None
    for index in range(2):
        assert torch.equal(both.normal[index], alone.normal)
        assert torch.equal(both.depth[index], alone.depth)


@pytest.mark.slow
def test_more_pictures_tell_more(bumpy: Field) -> None:
    """One, two and three lights about the view; one picture as the first of several is one picture."""
    lights = torch.stack([light_at(30, azimuth) for azimuth in (40, 160, 280)])
    images = torch.stack([photograph(bumpy, light, 0.5, seed=k) for k, light in enumerate(lights)])[..., ::2, ::2]
    half = Field("half", bumpy.height[:, ::2, ::2], bumpy.normal[:, ::2, ::2], bumpy.mask[:, ::2, ::2], True)
    found = []
    for count in (1, 2, 3):
        few = images[None, :count], lights[None, :count], half.mask[None]
        several = shape_from_shading(*few, albedo=0.8, roughness=0.5)
        found.append(errors(replace(several, normal=several.normal[0]), half)["mean"])
        assert several.residual.shape == (1, *half.mask.shape)
    assert found[1] < 0.7 * found[0]
    assert found[2] < found[1]
    alone = shape_from_shading(images[0], lights[0], half.mask, albedo=0.8, roughness=0.5)
    first = shape_from_shading(images[None, :1], lights[None, :1], half.mask[None], albedo=0.8, roughness=0.5)
    assert torch.equal(first.normal[0], alone.normal)
    assert torch.equal(first.confidence[0], alone.confidence)


@pytest.mark.slow
def test_frontal_light_is_reported(bumpy: Field) -> None:
    frontal = torch.tensor((0.0, 0.0, 1.0))
    image = photograph(bumpy, frontal, 0.5)
    with pytest.warns(UserWarning, match="dents and bumps look alike"):
        found = shape_from_shading(image, frontal, bumpy.mask, albedo=0.8, roughness=0.5)
    assert "light-near-view" in codes(found)
    assert errors(found, bumpy)["median"] < 10  # the silhouette determines which way it bulges


def test_a_twin_that_explains_the_picture_as_well_is_reported() -> None:
    found = shape_from_shading(torch.full((1, 1, 7), 0.4), LIGHT)
    assert "inside-out" in codes(found)


def test_the_inflated_silhouette_of_an_ellipse_is_half_an_ellipsoid() -> None:
    row, column = torch.meshgrid(torch.arange(80), torch.arange(100), indexing="ij")
    x, y = (column - 49.5) / 40, (39.5 - row) / 30
    mask = (x * x + y * y < 1)[None]
    z = (1 - x * x - y * y).clamp_min(0.0).sqrt()
    third = math.sqrt(2 / (1 / 40**2 + 1 / 30**2))  # -4 is the Laplacian of the squared height
    truth = F.normalize(torch.stack((x / 40, y / 30, z / third)), dim=0)
    found = silhouette_normals(mask)
    inner = -F.max_pool2d(-mask.float(), 9, 1, 4) > 0
    assert not found[:, ~mask[0]].any()
    assert angular_error(found, truth, inner).summary()["mean"] < 1
    with pytest.raises(ShapeError, match="bool"):
        silhouette_normals(mask.float())


@pytest.mark.slow
def test_without_contour(bumpy: Field) -> None:
    """A part of a surface: reported, near the truth, nearer with a few known heights."""
    sheet = height_fields.make("wavy sheet", SIZE)
    image = photograph(sheet, LIGHT, 0.5)
    found = shape_from_shading(image, LIGHT, sheet.mask, albedo=0.8, roughness=0.5, contour=False)
    assert "no-contour" in codes(found)
    known = torch.full_like(image, torch.nan)
    known[:, 8::28, 8::28] = sheet.height[:, 8::28, 8::28].float()
    given = shape_from_shading(image, LIGHT, sheet.mask, albedo=0.8, roughness=0.5, contour=False, known=known)
    assert given.depth is not None
    assert errors(given, sheet)["mean"] <= errors(found, sheet)["mean"] + 0.1
    assert (given.depth - sheet.height).abs().mean() < 0.5  # pixels; known heights set the level


@pytest.mark.slow
def test_start_from_a_depth(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, 0.5)
    start = bumpy.height.float() * 0.8
    found = shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5, depth=start)
    assert errors(found, bumpy)["median"] < 2.5


@pytest.mark.slow
def test_albedo_and_roughness_are_estimated_and_reported(bumpy: Field) -> None:
    image = photograph(bumpy, LIGHT, math.radians(30))
    found = shape_from_shading(image, LIGHT, bumpy.mask, albedo=None, roughness=None)
    values = {finding.code: finding.value for finding in found.report}
    assert values["albedo-estimated"] == found.albedo.max().item()
    assert values["roughness-estimated"] == pytest.approx(math.degrees(found.roughness.max().item()))
    assert "albedo-and-roughness-estimated" in values
    assert math.isinf(found.roughness_error)
    assert abs(found.albedo.max().item() - 0.8) < 0.15
    assert errors(found, bumpy)["median"] < 8


@pytest.mark.slow
def test_shadow_is_counted_and_bridged(bumpy: Field) -> None:
    """A cast shadow over a third of the object, which no reflectance explains."""
    image = photograph(bumpy, LIGHT, 0.5)
    image[:, :, SIZE // 2 : SIZE // 2 + 12] = 0
    found = shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5)
    assert "shadow-pixels" in codes(found)
    assert found.normal.isfinite().all()
    away = bumpy.mask.clone()
    away[:, :, SIZE // 2 - 6 : SIZE // 2 + 18] = False
    assert angular_error(found.normal, bumpy.normal.float(), away).summary()["median"] < 6
    shadow = bumpy.mask & ~away
    assert found.confidence[shadow].mean() < found.confidence[away].mean()


@pytest.mark.slow
def test_albedo_map(bumpy: Field) -> None:
    """Half of the object is darker: with the map as good as without, with one number it is read as slope."""
    albedo = torch.full_like(bumpy.mask.float(), 0.8)
    albedo[:, :, : SIZE // 2] = 0.4
    image = OrenNayar("vcavity")(bumpy.normal[None].float(), LIGHT[None], albedo=albedo[None], roughness=0.5)[0]
    given = shape_from_shading(image, LIGHT, bumpy.mask, albedo=albedo, roughness=0.5)
    without = shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5)
    assert errors(given, bumpy)["median"] < 3
    assert errors(given, bumpy)["median"] < 0.4 * errors(without, bumpy)["median"]


@pytest.mark.slow
def test_ambient_light(bumpy: Field) -> None:
    """A tenth of the light from all around: given or estimated it does little harm, ignored it is read as shape."""
    image = photograph(bumpy, LIGHT, 0.5) + 0.8 * 0.1 * bumpy.mask
    given, found, ignored = (
        shape_from_shading(image, LIGHT, bumpy.mask, albedo=0.8, roughness=0.5, ambient=ambient, silhouette=0)
        for ambient in (0.1, None, 0.0)
    )
    assert errors(given, bumpy)["median"] < 2.2
    assert errors(found, bumpy)["median"] < 0.6 * errors(ignored, bumpy)["median"]
    assert "ambient-estimated" in codes(found)
    assert found.ambient is not None
    assert abs(found.ambient[bumpy.mask] - 0.1).max() < 0.03
    again = found.shade(LIGHT[None])[0] + found.albedo * found.ambient
    assert ((again - image).abs() - found.residual)[bumpy.mask].abs().max() < 1e-5


@pytest.mark.slow
def test_ambient_map(bumpy: Field) -> None:
    """More on one side: a map, also in a batch, and whatever is outside the mask."""
    ambient = torch.linspace(0, 0.2, SIZE).expand(1, SIZE, SIZE)
    image = photograph(bumpy, LIGHT, 0.5) + 0.8 * ambient
    ambient = torch.where(bumpy.mask, ambient, torch.nan)
    batch = (t[None] for t in (image, LIGHT, bumpy.mask))
    found = shape_from_shading(*batch, albedo=0.8, roughness=0.5, ambient=ambient[None])
    assert found.ambient is not None
    assert torch.equal(found.ambient[0], ambient.nan_to_num(0))
    assert errors(replace(found, normal=found.normal[0]), bumpy)["median"] < 2.2


def ball(camera: Camera) -> tuple[Field, Tensor]:
    """A unit ball 4 away, and its depth."""
    ray = camera.rays((SIZE, SIZE))[0].double()
    a, b = ray.square().sum(0), -4 * ray[2]
    root = b * b - a * 15
    mask = root > 0
    depth = torch.where(mask, (b - root.clamp_min(0).sqrt()) / a, 0)
    normal = torch.where(mask, ray * depth + torch.tensor([0.0, 0.0, 4.0]).double().reshape(3, 1, 1), 0)
    return Field("ball", depth[None], F.normalize(normal, dim=0), mask[None], True), depth[None]


@pytest.mark.slow
def test_perspective_and_a_near_light() -> None:
    camera = Camera.perspective(math.radians(32))
    field, depth = ball(camera)
    points = camera.points(depth[None]).float()
    position = torch.tensor((1.5, 1.0, -1.0)).reshape(1, 3, 1, 1)
    light, irradiance = point_light(points, position, 9.0)
    view = camera.view_directions((SIZE, SIZE))
    image = OrenNayar("vcavity")(field.normal[None].float(), light, view, albedo=0.8, roughness=0.5)[0]
    assert irradiance.shape == (1, 1, SIZE, SIZE)  # divided out by the user
    found = shape_from_shading(image, light[0], field.mask, albedo=0.8, roughness=0.5, camera=camera)
    assert errors(found, field)["median"] < 2.5
    assert found.depth is not None
    ratio = (found.depth / depth)[field.mask]
    assert (ratio / ratio.mean() - 1).abs().mean() < 0.02


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (3, 4)])
@pytest.mark.slow
def test_tiny_images(size: tuple[int, int]) -> None:
    found = shape_from_shading(torch.full((1, *size), 0.4), LIGHT)
    assert found.normal.shape == (3, *size)
    assert found.depth is not None
    assert found.depth.isfinite().all()
    assert found.normal.isfinite().all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"image": torch.rand(4, 4)}, ShapeError, "image"),
        ({"light": torch.rand(2)}, ShapeError, "light"),
        ({"light": torch.tensor((0.0, 0.0, 3.0))}, RangeError, "unit"),
        ({"light": torch.tensor((0.0, 0.6, -0.8))}, RangeError, "swap_opencv_frame"),
        ({"image": torch.full((1, 4, 4), torch.nan)}, RangeError, "image"),
        ({"image": torch.zeros(1, 4, 4)}, CaptureError, "exposure"),
        ({"image": torch.rand(1, 2, 1, 4, 4) + 0.1}, ShapeError, "batch"),
        ({"image": torch.rand(1, 2, 1, 4, 4) + 0.1, "light": LIGHT[None, None]}, ShapeError, r"light.*\(2, 3\)"),
        ({"mask": torch.zeros(1, 4, 4, dtype=torch.bool)}, CaptureError, "mask"),
        ({"mask": torch.ones(1, 4, 4)}, ShapeError, "mask"),
        ({"roughness": 30.0}, RangeError, "roughness"),
        ({"ambient": -0.1}, RangeError, "ambient"),
        ({"ambient": 10}, RangeError, "tenth"),
        ({"image": torch.full((1, 4, 4), 0.4), "ambient": 0.5}, RangeError, "ambient"),
        ({"ambient": torch.rand(4, 4)}, ShapeError, "ambient"),
        ({"albedo": torch.rand(2, 4, 4)}, ShapeError, "albedo"),
        ({"depth": torch.full((1, 4, 4), torch.nan)}, RangeError, "depth"),
        ({"prior": "learnt"}, RangeError, "silhouette"),
    ],
)
def test_bad_input(change: dict[str, object], error: type[Exception], words: str) -> None:
    good: dict[str, object] = {"image": torch.rand(1, 4, 4) + 0.1, "light": LIGHT}
    with pytest.raises(error, match=words):
        shape_from_shading(**{**good, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize("degrees", [0, 30])
@pytest.mark.parametrize(("name", "start"), [("sphere cap", "outline-trusted"), ("bumpy ellipsoid", "network-start")])
@pytest.mark.slow
def test_the_outline_is_taken_where_it_explains_the_picture(name: str, start: str, degrees: float) -> None:
    """A ball is what its outline says; a surface with bumps is not."""
    field, light, sigma = height_fields.make(name, 96), light_at(30), math.radians(degrees)
    image = photograph(field, light, sigma, albedo=0.8)
    found = shape_from_shading(image, light, field.mask, albedo=None, roughness=sigma)
    assert start in codes(found)
    if name == "sphere cap":
        assert angular_error(found.normal, field.normal.float(), field.mask).summary()["median"] < 1


@pytest.mark.slow
def test_a_picture_that_is_not_understood_falls_back_on_the_silhouette() -> None:
    """Paint in patches, which the model takes for slopes: the ball stays a ball."""
    field, light = height_fields.make("sphere cap", 96), light_at(30)
    image = photograph(field, light, 0.0, albedo=0.8)
    row, column = torch.meshgrid(torch.arange(96), torch.arange(96), indexing="ij")
    painted = image * (1 - 0.6 * ((row // 12 + column // 12) % 2))
    found = shape_from_shading(painted, light, field.mask, albedo=None, roughness=0.0)
    assert "outline-trusted" in codes(found)
    assert "network-start" not in codes(
        shape_from_shading(image, light, field.mask, albedo=0.8, roughness=0.0, prior="silhouette")
    )
    assert angular_error(found.normal, field.normal.float(), field.mask).summary()["mean"] < 8


class TestWindow:
    """Only the part of a picture that the mask reaches is solved."""

    def ball(self, size: int = 64) -> tuple[Tensor, Tensor]:
        field = height_fields.make("sphere cap", size)
        return photograph(field, LIGHT, 0.5), field.mask

    @pytest.mark.slow
    def test_where_it_lies_and_how_much_is_about_it_do_not_matter(self) -> None:
        image, mask = self.ball()
        found = []
        for left, right, top, bottom in ((64, 64, 64, 64), (70, 101, 93, 65)):
            around = (left, right, top, bottom)
            wide, inside = F.pad(image, around, value=math.nan), F.pad(mask, around)
            whole = shape_from_shading(wide, LIGHT, inside, albedo=0.8, roughness=0.5)
            assert whole.normal.shape == (3, *inside.shape[1:])
            assert not whole.normal[:, ~inside[0]].any()
            found.append(whole.normal[:, top : top + 64, left : left + 64])
        assert torch.equal(*found)
        tight = shape_from_shading(image, LIGHT, mask, albedo=0.8, roughness=0.5).normal
        assert angular_error(found[0], tight, mask).summary()["mean"] < 0.5

    @pytest.mark.slow
    def test_maps_and_depths_are_cropped_with_the_picture(self) -> None:
        """In perspective, off the middle, every input a map that is NaN outside the mask."""
        image, mask = self.ball()
        around = (70, 20, 10, 40)
        inside = F.pad(mask, around)
        camera = Camera.perspective(math.radians(40), eye=(0.0, 0.0, 3.0))
        nowhere = torch.full((1, *inside.shape[1:]), math.nan)
        maps = {
            name: torch.where(inside, value, nowhere)
            for name, value in {
                "light": LIGHT.reshape(3, 1, 1),
                "albedo": torch.tensor(0.8),
                "roughness": torch.tensor(0.5),
                "ambient": torch.tensor(0.0),
            }.items()
        }
        image = F.pad(image, around)
        solve = partial(shape_from_shading, image, mask=inside, camera=camera, silhouette=0.0)  # by the picture alone
        given = solve(LIGHT, albedo=0.8, roughness=0.5)
        light, albedo, roughness, ambient = maps.values()
        mapped = solve(light, albedo=albedo, roughness=roughness, ambient=ambient)
        assert mapped.depth is not None
        assert angular_error(mapped.normal, given.normal, inside).summary()["mean"] < 0.2
        place = tuple(inside[0].nonzero()[400])
        known = nowhere.clone()
        known[0, place[0], place[1]] = 2.5
        start = torch.where(inside, mapped.depth * 2.5 / mapped.depth[0, place[0], place[1]], nowhere)
        again = solve(LIGHT, albedo=0.8, roughness=0.5, depth=start, known=known)
        assert again.depth is not None
        assert again.depth[0, place[0], place[1]].item() == pytest.approx(2.5, rel=0.01)
        assert angular_error(again.normal, given.normal, inside).summary()["mean"] < 1

    @pytest.mark.parametrize(("rows", "columns"), [(1, 1), (60, 1), (3, 90)])
    @pytest.mark.slow
    def test_small_and_thin_masks(self, rows: int, columns: int) -> None:
        inside = torch.zeros(1, 100, 120, dtype=torch.bool)
        inside[:, 20 : 20 + rows, 10 : 10 + columns] = True
        found = shape_from_shading(0.5 * inside.double(), LIGHT.double(), inside, albedo=0.8)
        assert found.normal.dtype == torch.float64
        assert torch.allclose(found.normal[:, inside[0]].norm(dim=0), torch.ones(1, dtype=torch.float64))
        assert not found.normal[:, ~inside[0]].any()

    @pytest.mark.slow
    def test_a_frontal_near_light_is_judged_inside_the_mask(self) -> None:
        image, mask = self.ball()
        light = torch.where(mask, torch.tensor([0.0, 0.0, 1.0]).reshape(3, 1, 1), math.nan)
        with pytest.warns(UserWarning, match="within 10 degrees"):
            shape_from_shading(image, light, mask, albedo=0.8, roughness=0.5)


@pytest.mark.parametrize("name", ["sphere cap", "bumpy ellipsoid"])
@pytest.mark.slow
def test_a_light_that_nobody_knows_is_found(name: str) -> None:
    """About as far off as is said; then the normals are off by little more than the light."""
    field, light = height_fields.make(name, 96), light_at(35, azimuth=200.0)
    image = photograph(field, light, math.radians(20), albedo=0.8)
    with pytest.warns(UserWarning, match="no light was given"):
        found = shape_from_shading(image, None, field.mask, albedo=None, roughness=math.radians(20))
    assert found.lights is not None
    off = math.degrees(math.acos(float(found.lights[0] @ light)))
    (said,) = (note.value for note in found.report if note.code == "light-found")
    assert said is not None
    assert off < 2 * said < 40
    assert angular_error(found.normal, field.normal.float(), field.mask).summary()["median"] < off + 6


def test_a_light_cannot_be_found_without_an_outline_or_for_several_pictures() -> None:
    one, two = torch.rand(1, 8, 8) + 0.1, torch.rand(1, 2, 1, 8, 8) + 0.1
    for image, contour in ((one, False), (one, True), (two, True)):  # without a mask there is no outline either
        with pytest.raises(RangeError, match="outline is seen"):
            shape_from_shading(image, None, contour=contour)


@pytest.mark.slow
def test_a_light_that_the_picture_does_not_determine_is_refused() -> None:
    """Noise has no light, and a few pixels do not show one."""
    field = height_fields.make("bumpy ellipsoid", 64)
    noise = torch.rand(1, 64, 64, generator=torch.Generator().manual_seed(0)) * field.mask
    few = torch.zeros_like(field.mask)
    few[:, 20:26, 20:26] = True
    for mask in (field.mask, few):
        with pytest.raises(CaptureError, match="determines its light"):
            shape_from_shading(noise, None, mask, albedo=None)
    with pytest.raises(RangeError, match="finite"):
        shape_from_shading(noise / 0, None, field.mask, albedo=None)
