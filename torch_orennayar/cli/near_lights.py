"""Near lights in ``orennayar stereo``: their options, and solving with positions or with directions alone."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import CaptureError, RangeError

if TYPE_CHECKING:
    from ..io.capture import Capture
    from ..reconstruction import Reconstruction
    from .options import StereoModel


def check_near_options(
    positions: Path | None,
    distance: float | None,
    fov: float | None,
    crop: str | None,
    *,
    unit: str | None,
    near: bool | None,
    other: bool,
) -> float | None:
    """The camera's distance in millimetres, if options of near lights come together, without those of distant ones."""
    from ..io.light_positions import MILLIMETRES

    if positions is not None and crop is not None:
        raise RangeError(
            "--crop", expected="whole photographs with --positions", got=crop,
            mend="leave --crop out, since the camera's axis meets the middle; choose a part with --mask",
        )  # fmt: skip
    if positions is None and distance is not None:
        raise RangeError("--positions", expected="a file of positions", got="none", mend="leave --camera-distance out")
    if near is not None and (positions is not None or other):
        raise RangeError(
            "--near" if near else "--distant", expected="neither --positions, --refine-lights nor --least-squares",
            got="one of them", mend="leave it out; positions are of near lights, the others of distant ones",
        )  # fmt: skip
    if positions is not None and (distance is None or fov is None or other):
        raise RangeError(
            "--positions",
            expected="--camera-distance and --fov, and neither --refine-lights nor --least-squares",
            got=_described(distance, fov, other=other),
            mend="measure the distance from the camera to the object in mm, and give the vertical angle of view",
        )
    return distance and distance * MILLIMETRES[unit or ""]


def _described(distance: float | None, fov: float | None, *, other: bool) -> str:
    """What is missing or too much beside ``--positions``."""
    missing = [f"no {name}" for name, value in (("--camera-distance", distance), ("--fov", fov)) if value is None]
    return " and ".join([*missing, *(["--refine-lights or --least-squares"] if other else [])])


def solve_at_positions(loaded: Capture, model: StereoModel, distance: float, fov: float, seed: int) -> Reconstruction:
    """Solve under near lights; the depth becomes a height in pixels, as results are written."""
    from ..geometry.camera import Camera
    from ..stereo.near_light import near_light_stereo

    assert loaded.positions is not None
    found = near_light_stereo(
        loaded.images / loaded.positions.square().sum(1).mean(),  # of irradiance 1 where the object is, in the mean
        loaded.positions - loaded.positions.new_tensor((0.0, 0.0, distance)),
        loaded.mask,
        camera=Camera.perspective(math.radians(fov)),
        distance=distance,
        model=model,
        valid=loaded.valid,
        seed=seed,
    )
    assert found.depth is not None
    return replace(found, depth=(distance - found.depth) / pixel_mm(loaded, distance, fov) * loaded.mask)


def solve_if_near(loaded: Capture, model: StereoModel, seed: int) -> Reconstruction | None:
    """`solve_at_some_distance` where lights of known directions are seen to be near, and how far; else None."""
    from ..stereo.near_evidence import shows_near_lights

    inside = loaded.mask if loaded.valid is None else loaded.mask & loaded.valid.all(0)
    if _were_found(loaded) or not bool(inside.any()):
        return None
    try:
        near = shows_near_lights(loaded.images, loaded.lights, inside, _origin(loaded), seed=seed)
        return solve_at_some_distance(loaded, model, seed) if near else None
    except CaptureError:  # the photographs do not tell after all; what else is wrong shows under distant lights too
        return None


def solve_at_some_distance(loaded: Capture, model: StereoModel, seed: int) -> Reconstruction:
    """Solve under near lights whose directions are known, at the distance that the photographs tell."""
    from ..stereo.light_positions import find_light_positions
    from ..stereo.near_light import near_light_stereo

    near = find_light_positions(loaded.images, loaded.lights, loaded.mask, origin=_origin(loaded), valid=loaded.valid)
    scale = near.intensities * near.positions.square().sum(1).mean()  # of irradiance 1 where the object is, in the mean
    images = loaded.images / scale[:, :, None, None]
    found = near_light_stereo(images, near.positions, loaded.mask, model=model, valid=loaded.valid, seed=seed)
    return replace(found, report=(*near.findings, *found.report))


def _were_found(loaded: Capture) -> bool:
    """Whether the directions are those under which the photographs look as under distant lights."""
    return "lights-found" in {note.code for note in loaded.notes}


def _origin(loaded: Capture) -> tuple[float, float] | None:
    """The pixel, column and row, from which the directions were measured: a ball's centre, or none."""
    return None if loaded.ball is None else (loaded.ball.x, loaded.ball.y)


def pixel_mm(loaded: Capture, distance: float | None, fov: float) -> float:
    """Millimetres of the object that a pixel covers at the distance of the camera."""
    assert distance is not None  # comes with fov, see check_near_options
    return 2 * distance * math.tan(math.radians(fov) / 2) / loaded.mask.shape[1]
