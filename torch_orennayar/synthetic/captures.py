"""Synthetic captures with the truth, as many as a training loop wants: pixels alone, or rendered pictures."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, IterableDataset, get_worker_info

from ..core.errors import RangeError
from ..core.progress import track
from ..geometry.camera import Camera
from ..render.normal_map import render_normals
from ..render.radiosity import SeenSurface, light_between
from ..render.shadow import cast_shadows
from .pixels import (
    Draw,
    Ingredients,
    Materials,
    draw_lights,
    draw_material,
    draw_normals,
    sense,
    shade_pixels,
    stand_walls,
    tell_lights,
)
from .scenes import SCENE_LIGHTS, Mesh, Scene, draw_mesh, draw_scene

IN_SCENES = 0.8
"""Share of samples of pixels that stand in scenes, where there are any."""


class SyntheticCaptures(IterableDataset[dict[str, Tensor]]):
    """Endless captures for training, each made from its index alone: the same with any number of workers and ranks.

    ``"pixels"``: ``observed`` (P, K), grey, ``lights`` (P, K, 3), ``normal`` (P, 3); every pixel has a material,
    shadows and lights of its own. ``"images"``: ``images`` (K, 3, H, W), ``lights`` (K, 3), ``mask`` (1, H, W) bool,
    ``normal`` (3, H, W), ``albedo`` (3, H, W), ``roughness`` (1, H, W) radians: one mesh, seen by a random camera, in
    one textured material, with cast shadows. Light is linear, directions are in the camera frame.

    Workers of a `DataLoader` and ranks of a process group share the indices among themselves.

    Args:
        kind: ``"pixels"`` or ``"images"``.
        seed: of everything.
        start: index of the first capture.
        length: number of captures, over all ranks; default endless.
        mix: what captures are made of; `Ingredients`.
        lights: fewest and most lights; in scenes 48 at most.
        observations: P times K of ``"pixels"``, about.
        scenes: four in five samples of ``"pixels"`` stand in one of so many rendered scenes, whose parts shade and
            light each other, the fifth between made-up walls. A scene takes about half a second when it is first needed
            and .6 MB to be kept, in every worker and rank; `render_scenes` makes them all before workers start.
        size: (H, W) of ``"images"``.
        meshes: (vertices, faces) of ``"images"`` and scenes; default: bumpy balls, rings and heaps of balls.
        device: where captures are made.
        rank: of this process; default: of the process group, or 0.
        world: number of processes; the same.

    Raises:
        RangeError: an unknown kind, fewer than 3 lights, or more than 48 in scenes, fewer than 0 scenes or scenes of
            ``"images"``, a rank that is not below ``world``, or meshes that show nothing.

    Example:
        >>> import torch_orennayar as ton
        >>> sample = next(iter(ton.SyntheticCaptures("pixels", seed=1)))
        >>> sample["observed"].shape == sample["lights"].shape[:2]
        True
    """

    def __init__(
        self,
        kind: str = "pixels",
        *,
        seed: int = 0,
        start: int = 0,
        length: int | None = None,
        mix: Ingredients | None = None,
        lights: tuple[int, int] = (12, 100),
        observations: int = 12_288,
        scenes: int = 0,
        size: tuple[int, int] = (64, 64),
        meshes: Sequence[Mesh] | None = None,
        device: torch.device | str = "cpu",
        rank: int | None = None,
        world: int | None = None,
    ) -> None:
        if kind not in ("pixels", "images"):
            raise RangeError("kind", expected="'pixels' or 'images'", got=repr(kind), mend="choose one")
        if not 3 <= lights[0] <= lights[1]:
            raise RangeError("lights", expected="fewest and most, 3 or more", got=str(lights), mend="put them in order")
        if scenes and lights[0] > SCENE_LIGHTS:
            most = f"at most {SCENE_LIGHTS} at least, in scenes"
            raise RangeError("lights", expected=most, got=str(lights), mend="ask for fewer, or for no scenes")
        if scenes < 0 or (scenes and kind != "pixels"):
            raise RangeError("scenes", expected="0 or more, of pixels", got=f"{scenes} of {kind}", mend="0 for none")
        self.kind, self.seed, self.start, self.length = kind, seed, start, length
        self.mix, self.lights, self.observations, self.size = mix or Ingredients(), lights, observations, size
        self.meshes, self.device = meshes, torch.device(device)
        self.scenes, self._rendered = scenes, dict[int, Scene]()
        self.rank = rank if rank is not None else torch.distributed.get_rank() if _grouped() else 0
        self.world = world if world is not None else torch.distributed.get_world_size() if _grouped() else 1
        if not 0 <= self.rank < self.world:
            raise RangeError("rank", expected=f"0 to {self.world - 1}", got=str(self.rank), mend="count from 0")

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        worker = get_worker_info()
        first, step = self.rank, self.world
        if worker is not None:
            first, step = first + worker.id * self.world, step * worker.num_workers
        index = first
        while self.length is None or index < self.length:
            yield self.sample(self.start + index)
            index += step

    @torch.no_grad()
    def sample(self, index: int) -> dict[str, Tensor]:
        """Capture number ``index``."""
        draw = self._draw(self.kind, index)
        count = self._count(draw)
        return self._pixels(draw, count) if self.kind == "pixels" else self._images(draw, count)

    def render_scenes(self, workers: int = 0) -> None:
        """Render all scenes now; workers of a `DataLoader` then share them.

        Ranks of a process group share the work if all of them call this.

        Args:
            workers: processes that render; 0 for this one. On another device than the processor only 0 works.
        """
        grouped = _grouped() and torch.distributed.get_world_size() == self.world
        numbers = list(range(self.rank, self.scenes, self.world) if grouped else range(self.scenes))
        scenes = DataLoader(_Scenes(self), batch_size=None, sampler=numbers, num_workers=workers)
        made = {
            number: Scene(*(part.clone() for part in scene))  # what a worker sends holds a file open
            for number, scene in zip(track(numbers, "scenes"), scenes, strict=True)
        }
        of_ranks: list[dict[int, Scene]] = [made]
        if grouped:
            of_ranks = [{} for _ in range(self.world)]
            torch.distributed.all_gather_object(of_ranks, made)
        for scenes_of_one in of_ranks:
            self._rendered |= scenes_of_one

    def _draw(self, what: str, index: int) -> Draw:
        digest = hashlib.blake2b(f"{what} {self.seed} {index}".encode(), digest_size=8).digest()
        return Draw(int.from_bytes(digest, "big") >> 1, self.device)

    def _count(self, draw: Draw) -> int:
        """Lights: half the time any number, few as likely as many, otherwise many."""
        fewest, most = self.lights
        low = fewest if draw.uniform(1).item() < 0.5 else max(fewest, int(0.6 * most))
        return min(most, int(draw.logarithmic(1, low=low, high=most + 1).item()))

    def _pixels(self, draw: Draw, count: int) -> dict[str, Tensor]:
        mix = self.mix
        in_scene = self.scenes and draw.uniform(1).item() < IN_SCENES
        count = min(count, SCENE_LIGHTS) if in_scene else count
        pixels = max(1, self.observations // count)
        if in_scene:
            lights, normal, reached, sent = self._in_scene(draw, pixels, count)
            easy = draw.happens(mix.easy, pixels, 1)
        else:
            lights, normal = draw_lights(draw, pixels, count), draw_normals(draw, pixels)
            easy = draw.happens(mix.easy, pixels, 1)
            reached, sent = stand_walls(draw, normal, lights, mix, easy)
        observed = sense(draw, shade_pixels(draw, lights, normal, reached, sent, mix, easy), mix, easy)
        return {"observed": observed, "lights": tell_lights(draw, lights, mix), "normal": normal}

    def _in_scene(self, draw: Draw, pixels: int, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Pixels of a scene under some of its lights (P, K, 3), normals, what reaches them and what is sent, (P, K)."""
        number = min(int(draw.uniform(1).item() * self.scenes), self.scenes - 1)
        if number not in self._rendered:
            self._rendered[number] = self._scene(number)
        scene = self._rendered[number]
        some = torch.randperm(len(scene.lights), generator=draw.generator, device=draw.device)[:count]
        which = torch.randint(len(scene.normal), (pixels,), generator=draw.generator, device=draw.device)
        reached, sent = (part[which][:, some] for part in (scene.reached, scene.sent))
        reached = reached if self.mix.shadows else torch.ones_like(reached)
        return scene.lights[some].expand(pixels, -1, -1), scene.normal[which], reached, sent * self.mix.bounce

    @torch.no_grad()
    def _scene(self, number: int) -> Scene:
        return draw_scene(self._draw("scene", number), min(self.lights[1], SCENE_LIGHTS), self.meshes)

    def _images(self, draw: Draw, count: int) -> dict[str, Tensor]:
        mix = self.mix
        vertices, faces = draw_mesh(draw, self.meshes)
        camera = _camera(draw)
        seen = render_normals(vertices, faces, camera, self.size)
        mask, normal = seen.mask[0], seen.normal[0]
        inside = mask[0]
        lights = draw_lights(draw, 1, count)[0]
        # One material; what is white in truth is the texture, the material's albedo only weighs matt against gloss.
        material = draw_material(draw, 1, mix)
        texture = _texture(draw, self.size)
        paint = texture[:, inside].T
        surface = SeenSurface.of(seen)
        shown, light = _shade(surface, lights, material)
        if mix.shadows:
            reached = cast_shadows(vertices, faces, seen, lights, resolution=4 * max(self.size))[:, 0, inside].T
            shown, light = shown * reached, light * reached
        colours = paint[:, :, None] * shown[:, None]  # (P, 3, K)
        if mix.bounce:
            sent = paint[:, :, None] * light_between(surface, paint * material.matt, light, draw.generator)
            colours = colours + material.albedo * material.matt * sent
        level = colours.mean().clamp_min(1e-6)
        colours = colours + draw.uniform(1, high=mix.ambient) * level
        noisy = _sense_picture(draw, colours, mix)
        images = torch.zeros(count, 3, *self.size, device=self.device)
        images[:, :, inside] = noisy.permute(2, 1, 0)
        return {
            "images": images,
            "lights": tell_lights(draw, lights[None], mix)[0],
            "mask": mask,
            "normal": normal,
            "albedo": texture * mask,
            "roughness": material.roughness.reshape(1, 1, 1) * mask,
        }


def _grouped() -> bool:
    return torch.distributed.is_available() and torch.distributed.is_initialized()


class _Scenes(Dataset[Scene]):
    """The scenes of captures by number."""

    def __init__(self, captures: SyntheticCaptures) -> None:
        self._captures = captures

    def __getitem__(self, number: int) -> Scene:
        return self._captures._scene(number)


def _shade(surface: SeenSurface, lights: Tensor, material: Materials) -> tuple[Tensor, Tensor]:
    """What P pixels show and what falls on them, (P, K) each, nothing in the way of the lights."""
    ci, co = surface.normal @ lights.T, (surface.normal * surface.view).sum(1, keepdim=True)
    light = ci.clamp_min(0)
    value = material.reflect(ci.clamp_min(1e-3), co.clamp_min(0.05).expand_as(ci), surface.view @ lights.T)
    return value * light * (co > 0), light


def _camera(draw: Draw) -> Camera:
    """Looks at the unit sphere; half of them from so near that it shows."""
    if draw.uniform(1).item() < 0.5:
        return Camera.orthographic(1.0)
    field = math.radians(draw.uniform(1, low=15, high=45).item())
    return Camera.perspective(field, eye=(0.0, 0.0, 1.0 / math.sin(field / 2)))


def _texture(draw: Draw, size: tuple[int, int]) -> Tensor:
    """Colours (3, H, W) that change slowly, or not at all."""
    cells = 1 if draw.uniform(1).item() < 0.4 else int(draw.uniform(1, low=2, high=8).item())
    grid = draw.uniform(1, 3, cells, cells, low=0.2, high=0.95)
    return (
        F.interpolate(grid, size=size, mode="bilinear", align_corners=True)[0]
        if cells > 1
        else grid[0].expand(3, *size)
    )


def _sense_picture(draw: Draw, colours: Tensor, mix: Ingredients) -> Tensor:
    """A camera's view of colours (P, 3, K): lights a little wrong, noise, steps."""
    count = colours.shape[2]
    top = colours.flatten().quantile(0.999) if colours.numel() < 2**23 else colours.amax()
    seen = colours / top.clamp_min(1e-9) * (1 + mix.intensity_error * draw.uniform(1, 1, count, low=-1))
    share, floor = (draw.uniform(1, high=most) for most in mix.noise)
    noise = draw.normal(*colours.shape), draw.normal(*colours.shape)
    seen = seen * (1 + share * noise[0]) + 0.3 * floor * noise[1]
    steps = (2 ** draw.uniform(1, low=mix.bits[0], high=mix.bits[1])).floor()
    return (seen.clamp(0, 1) * steps).round() / steps
