"""`SyntheticCaptures`: an endless dataset of captures with the truth, of single pixels or of rendered images."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from numbers import Integral
from typing import Literal, TypeVar, cast, overload

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, IterableDataset, get_worker_info

from ..core.defaults import independent_of_defaults
from ..core.errors import RangeError, ShapeError
from ..core.progress import track
from ..core.threads import small_operations
from ..geometry.mesh import check_mesh
from ..geometry.mesh_files import Mesh
from .draw import Draw
from .images import SyntheticImages, draw_images
from .ingredients import Ingredients
from .pixels import (
    Surroundings,
    SyntheticPixels,
    draw_lights,
    draw_normals,
    draw_walls,
    perturb_lights,
    record_pixels,
    shade_pixels,
)
from .scenes import SCENE_LIGHTS, Meshes, RenderedScene, draw_scene

SCENE_SHARE = 0.8
"""Share of the samples of ``"pixels"`` that are taken from rendered scenes where there are any. Set by the error of
networks in training on held-out renders: 4.84 degrees, against 5.03 with a share of 0.5."""
MANY_LIGHTS = 0.6
"""Share of the largest number of lights above which half of the captures lie. Set by hand."""

Sample = TypeVar("Sample", bound=SyntheticPixels | SyntheticImages)


class SyntheticCaptures(IterableDataset[Sample]):
    """Endless captures for training; each depends on its index alone, whatever the number of workers and ranks.

    Samples of kind ``"pixels"`` are `SyntheticPixels`: single pixels, each with a material, shadows and lights of its
    own. Those of kind ``"images"`` are `SyntheticImages`: one mesh in one textured material with cast shadows, seen by
    a random camera, with everything that the pictures follow from. Light is linear; directions are unit vectors in the
    camera frame.

    Cast shadows and light between parts take more time than all the rest of a picture; what each ingredient costs is
    measured in scripts/benchmarks/README.md.

    Workers of a ``DataLoader`` and ranks of a process group share the indices among themselves; the group is asked when
    iteration begins, so that captures may be made before it. Where a trainer shards iterable datasets itself, as
    Hugging Face's accelerate does, pass ``rank=0, world=1``. Batches of ``"images"`` whose number of lights varies need
    ``collate_fn=collate_captures``; a sample of ``"pixels"`` is a batch: use ``batch_size=None``.

    Args:
        kind: ``"pixels"`` or ``"images"``.
        seed: of everything.
        start: index of the first capture.
        length: number of captures, over all ranks; default endless.
        mix: what captures contain; `Ingredients`.
        lights: fewest and most lights, of ``"pixels"`` 3 at least; in scenes 48 at most.
        observations: of ``"pixels"``: P times K, about.
        scenes: of ``"pixels"``: number of rendered scenes, whose parts shadow each other and reflect light onto each
            other, that four in five samples are taken from; the others have random walls beside each pixel. A scene
            takes about half a second when it is first used and .6 MB of memory in every worker and rank;
            `render_scenes` renders all before workers start.
        size: (H, W) of ``"images"``.
        meshes: (vertices, faces) of ``"images"`` and scenes, or ``"figures"``: figures with limbs, heaps of parts,
            vessels and reliefs, modelled anew for every capture, a tenth of a second each; default: bumpy balls, rings
            and heaps of balls.
        device: where captures are made.
        rank: of this process; default: of the process group when iteration begins, or 0.
        world: number of processes; default: of the process group when iteration begins, or 1.

    Raises:
        RangeError: an unknown kind, too few lights, or more than 48 in scenes, fewer than 0 scenes or scenes of
            ``"images"``, a rank that is not below ``world``, meshes that show nothing, or numbers of another type.
        ShapeError: meshes that are not pairs of tensors.

    Example:
        >>> import torch_orennayar as ton
        >>> sample = next(iter(ton.SyntheticCaptures("pixels", seed=1)))
        >>> sample["observed"].shape == sample["lights"].shape[:2]
        True
    """

    @overload
    def __init__(
        self: SyntheticCaptures[SyntheticPixels],
        kind: Literal["pixels"] = "pixels",
        *,
        seed: int = 0,
        start: int = 0,
        length: int | None = None,
        mix: Ingredients | None = None,
        lights: tuple[int, int] = (12, 100),
        observations: int = 12_288,
        scenes: int = 0,
        meshes: Meshes = None,
        device: torch.device | str = "cpu",
        rank: int | None = None,
        world: int | None = None,
    ) -> None: ...

    @overload
    def __init__(
        self: SyntheticCaptures[SyntheticImages],
        kind: Literal["images"],
        *,
        seed: int = 0,
        start: int = 0,
        length: int | None = None,
        mix: Ingredients | None = None,
        lights: tuple[int, int] = (12, 100),
        size: tuple[int, int] = (64, 64),
        meshes: Meshes = None,
        device: torch.device | str = "cpu",
        rank: int | None = None,
        world: int | None = None,
    ) -> None: ...

    def __init__(
        self,
        kind: Literal["pixels", "images"] = "pixels",
        *,
        seed: int = 0,
        start: int = 0,
        length: int | None = None,
        mix: Ingredients | None = None,
        lights: tuple[int, int] = (12, 100),
        observations: int = 12_288,
        scenes: int = 0,
        size: tuple[int, int] = (64, 64),
        meshes: Meshes = None,
        device: torch.device | str = "cpu",
        rank: int | None = None,
        world: int | None = None,
    ) -> None:
        if kind not in ("pixels", "images"):
            raise RangeError("kind", expected="'pixels' or 'images'", got=repr(kind), mend="choose one")
        fewest = 3 if kind == "pixels" else 1
        if not _is_pair(lights) or not fewest <= lights[0] <= lights[1]:
            wanted = f"fewest and most, {fewest} or more"
            raise RangeError("lights", expected=wanted, got=str(lights), mend="put them in order")
        if scenes and lights[0] > SCENE_LIGHTS:
            most = f"fewest lights of at most {SCENE_LIGHTS} in scenes"
            raise RangeError("lights", expected=most, got=str(lights), mend="ask for fewer, or for no scenes")
        if scenes < 0 or (scenes and kind != "pixels"):
            raise RangeError("scenes", expected="0 or more, of pixels", got=f"{scenes} of {kind}", mend="0 for none")
        self.kind, self.seed, self.start, self.length = kind, seed, start, length
        self.mix, self.lights, self.observations, self.size = mix or Ingredients(), lights, observations, size
        self.meshes, self.device = meshes, torch.device(device)
        self.scenes, self._rendered = scenes, dict[int, RenderedScene]()
        self._rank, self._world = rank, world
        self._check_numbers()
        if meshes is not None and meshes != "figures":
            _check_meshes(meshes)

    @property
    def rank(self) -> int:
        """Of this process."""
        return self._rank if self._rank is not None else torch.distributed.get_rank() if _grouped() else 0

    @property
    def world(self) -> int:
        """Number of processes."""
        return self._world if self._world is not None else torch.distributed.get_world_size() if _grouped() else 1

    def __getstate__(self) -> dict[str, object]:
        """What a worker process gets: it does not belong to the process group."""
        return self.__dict__ | {"_rank": self.rank, "_world": self.world}

    def _check_numbers(self) -> None:
        whole: dict[str, object] = {"seed": self.seed, "start": self.start, "observations": self.observations}
        whole |= {} if self.length is None else {"length": self.length}
        for name, value in whole.items():
            if not isinstance(value, int) or (value < 0 and name != "seed"):
                raise RangeError(name, expected="a whole number, 0 or more", got=repr(value), mend="correct it")
        if not _is_pair(self.size) or min(self.size) < 1:
            raise RangeError("size", expected="(H, W) in pixels", got=repr(self.size), mend="give two whole numbers")
        if not isinstance(self.mix, Ingredients):
            raise RangeError("mix", expected="Ingredients", got=repr(self.mix), mend="give Ingredients(...)")
        if not 0 <= self.rank < self.world:
            raise RangeError("rank", expected=f"0 to {self.world - 1}", got=str(self.rank), mend="count from 0")

    def __iter__(self) -> Iterator[Sample]:
        worker = get_worker_info()
        first, step = self.rank, self.world
        if worker is not None:
            first, step = first + worker.id * self.world, step * worker.num_workers
        index = first
        while self.length is None or index < self.length:
            yield self.sample(self.start + index)
            index += step

    @torch.no_grad()
    @independent_of_defaults
    @small_operations()
    def sample(self, index: int) -> Sample:
        """Capture number ``index``, which counts from 0.

        Raises:
            RangeError: no integer, or below 0.
        """
        if not isinstance(index, Integral) or index < 0:
            raise RangeError("index", expected="an integer from 0 on", got=repr(index), mend="count from 0")
        draw = self._draw(self.kind, index)
        count = self._draw_light_count(draw)
        made: SyntheticPixels | SyntheticImages
        if self.kind == "pixels":
            made = self._draw_pixels(draw, count)
        else:
            made = draw_images(draw, count, self.mix, self.size, self.meshes)
        return cast("Sample", made)  # the overloads of __init__ tie the type of samples to the kind

    @independent_of_defaults
    def render_scenes(self, workers: int = 0) -> None:
        """Render all scenes now; workers of a ``DataLoader`` then share them.

        Ranks of a process group share the work if all of them call this.

        Args:
            workers: processes that render; 0 for this one. On devices other than the CPU only 0 works.
        """
        grouped = _grouped() and torch.distributed.get_world_size() == self.world
        numbers = list(range(self.rank, self.scenes, self.world) if grouped else range(self.scenes))
        scenes = DataLoader(_SceneRenderer(self), batch_size=None, sampler=numbers, num_workers=workers)
        rendered = {
            number: RenderedScene(*(part.clone() for part in scene))  # a tensor from a worker keeps a file open
            for number, scene in zip(track(numbers, "scenes"), scenes, strict=True)
        }
        of_ranks: list[dict[int, RenderedScene]] = [rendered]
        if grouped:
            of_ranks = [{} for _ in range(self.world)]
            torch.distributed.all_gather_object(of_ranks, rendered)
        for scenes_of_rank in of_ranks:
            self._rendered |= scenes_of_rank

    @torch.no_grad()
    @independent_of_defaults
    @small_operations()
    def render_scene(self, number: int) -> RenderedScene:
        """Scene ``number``, rendered anew."""
        return draw_scene(self._draw("scene", number), min(self.lights[1], SCENE_LIGHTS), self.meshes)

    def _draw(self, what: str, index: int) -> Draw:
        digest = hashlib.blake2b(f"{what} {self.seed} {index}".encode(), digest_size=8).digest()
        return Draw(int.from_bytes(digest, "big") >> 1, self.device)

    def _draw_light_count(self, draw: Draw) -> int:
        """Number of lights, log-uniform: half the time over the whole range, otherwise over its upper part."""
        fewest, most = self.lights
        low = fewest if draw.uniform(1).item() < 0.5 else max(fewest, int(MANY_LIGHTS * most))
        return min(most, int(draw.log_uniform(1, low=low, high=most + 1).item()))

    def _draw_pixels(self, draw: Draw, count: int) -> SyntheticPixels:
        mix = self.mix
        in_scene = self.scenes and draw.uniform(1).item() < SCENE_SHARE
        count = min(count, SCENE_LIGHTS) if in_scene else count
        pixels = max(1, self.observations // count)
        if in_scene:
            lights, normal, around = self._draw_scene_pixels(draw, pixels, count)
            easy = draw.bernoulli(mix.easy, pixels, 1)
        else:
            lights, normal = draw_lights(draw, pixels, count), draw_normals(draw, pixels)
            easy = draw.bernoulli(mix.easy, pixels, 1)
            around = draw_walls(draw, normal, lights, mix, easy)
        observed = record_pixels(draw, shade_pixels(draw, lights, normal, around, mix, easy), mix, easy)
        return {"observed": observed, "lights": perturb_lights(draw, lights, mix), "normal": normal}

    def _draw_scene_pixels(self, draw: Draw, pixels: int, count: int) -> tuple[Tensor, Tensor, Surroundings]:
        """Lights (P, K, 3), normals (P, 3) and surroundings of pixels of a scene under some of its lights."""
        number = min(int(draw.uniform(1).item() * self.scenes), self.scenes - 1)
        if number not in self._rendered:
            self._rendered[number] = self.render_scene(number)
        scene = self._rendered[number]
        some = torch.randperm(len(scene.lights), generator=draw.generator, device=draw.device)[:count]
        which = torch.randint(len(scene.normal), (pixels,), generator=draw.generator, device=draw.device)
        reached, reflected = (part[which][:, some] for part in (scene.reached, scene.reflected))
        reached = reached if self.mix.shadows else torch.ones_like(reached)
        around = Surroundings(reached, reflected * self.mix.bounce)
        return scene.lights[some].expand(pixels, -1, -1), scene.normal[which], around


def _is_pair(value: object) -> bool:
    return isinstance(value, (tuple, list)) and len(value) == 2 and all(isinstance(n, int) for n in value)


def _check_meshes(meshes: object) -> None:
    """Check for a sequence of (vertices, faces)."""
    if not isinstance(meshes, Sequence) or isinstance(meshes, (str, Mesh)) or not meshes:
        got = type(meshes).__name__
        raise ShapeError(
            "meshes", expected="a list of (vertices, faces), or 'figures'", got=got, mend="put meshes into a list"
        )
    for mesh in meshes:
        if not isinstance(mesh, tuple) or len(mesh) != 2:
            mend = "use load_mesh" if isinstance(mesh, (str, os.PathLike)) else "give (vertices, faces)"
            raise ShapeError("meshes", expected="pairs (vertices, faces)", got=repr(mesh)[:60], mend=mend)
        check_mesh(*mesh)
        if not bool(mesh[0].isfinite().all()):
            raise RangeError("meshes", expected="finite vertices", got="NaN or infinity", mend="clean the mesh")


def _grouped() -> bool:
    return torch.distributed.is_available() and torch.distributed.is_initialized()


class _SceneRenderer(Dataset[RenderedScene]):
    """The scenes of captures by number, for the workers of a ``DataLoader``."""

    def __init__(self, captures: SyntheticCaptures[Sample]) -> None:
        self._render = captures.render_scene

    def __getitem__(self, number: int) -> RenderedScene:
        return self._render(number)
