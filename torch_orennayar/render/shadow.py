"""Cast shadows of a mesh under distant lights, by shadow maps."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.checks import check_floating, check_unit
from ..core.defaults import independent_of_defaults
from ..core.errors import ShapeError
from ..core.progress import track
from ..geometry.camera import Camera
from ..geometry.mesh import check_mesh
from .normal_map import NormalMap, check_size
from .raster import Projected, nearest_depths

TEXELS = 1 << 21
"""Texels of the shadow maps that are drawn together, about; set by hand, for 16 MB of depths."""


@torch.no_grad()
@independent_of_defaults
def cast_shadows(vertices: Tensor, faces: Tensor, seen: NormalMap, lights: Tensor, *, resolution: int = 1024) -> Tensor:
    """The share of each light that reaches each pixel past other parts of the mesh.

    A depth map is rendered from every light; a point is in shadow where that map is clearly nearer to the light. The
    edges of shadows are one texel of the map wide. Surfaces that face away from a light are not treated as shadow,
    since shading already makes them dark. Not differentiable.

    Args:
        vertices: (V, 3), world frame.
        faces: (F, 3) int64.
        seen: a single view of that mesh by `render_normals`.
        lights: (K, 3) unit directions to distant lights, camera frame.
        resolution: height and width of the shadow maps in pixels.

    Returns:
        (K, 1, H, W) in [0, 1]: 1 for lit, 0 for in shadow; 1 outside the mask.

    Raises:
        ShapeError: more than one view, or shapes other than these.
        RangeError: lights that are not unit vectors.

    Source:
        Williams 1978 (shadow maps); Reeves, Salesin & Cook 1987 (averaging the comparisons).

    Example:
        >>> import torch, torch_orennayar as ton
        >>> floor = torch.tensor([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
        >>> lid = floor * 0.2 + torch.tensor([0.0, 0.0, 1.0])
        >>> faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
        >>> mesh, both = torch.cat((floor, lid)), torch.cat((faces, faces + 4))
        >>> seen = ton.render_normals(mesh, both, ton.Camera.orthographic(eye=(0.0, 0.0, 3.0)), (32, 32))
        >>> reached = ton.cast_shadows(mesh, both, seen, torch.tensor([[0.6, 0.0, 0.8]]))
        >>> reached[0, 0, 16, 4].item(), reached[0, 0, 16, 28].item()  # the lid's shadow falls to the left
        (0.0, 1.0)
    """
    check_floating(vertices=vertices, lights=lights)
    check_mesh(vertices, faces)
    check_size((resolution, resolution))
    if len(seen.normal) != 1 or vertices.ndim != 2:
        raise ShapeError("seen", expected="one view", got=f"{len(seen.normal)} views", mend="take one at a time")
    if lights.ndim != 2 or lights.shape[-1] != 3:
        raise ShapeError("lights", expected="(K, 3)", got=str(tuple(lights.shape)), mend="one row per light")
    check_unit("lights", lights, 1, gaps=False)
    mask = seen.mask[0, 0]
    reached = torch.ones(len(lights), 1, *mask.shape, dtype=seen.normal.dtype, device=mask.device)
    if not len(lights) or not bool(mask.any()):
        return reached
    body = seen.camera.to_camera_frame(vertices)[0].double()
    points = seen.camera.points(torch.where(seen.mask, seen.depth, 0.0))[0][:, mask].T.to(body)
    normal = seen.normal[0][:, mask].T.to(body)
    together = max(1, TEXELS // resolution**2)
    groups = track(lights.to(body).split(together), "shadows")
    shares = [_reached(body, faces, points, normal, some, resolution) for some in groups]
    reached[:, 0, mask] = torch.cat(shares).to(reached)
    return reached


def _reached(body: Tensor, faces: Tensor, points: Tensor, normal: Tensor, lights: Tensor, resolution: int) -> Tensor:
    """The share of K lights that reaches P points, (K, P) in [0, 1].

    Args:
        body: (V, 3) vertices in the camera frame, float64.
        faces: (F, 3).
        points: (P, 3) in the camera frame.
        normal: (P, 3), unit.
        lights: (K, 3) unit directions.
        resolution: height and width of the shadow maps.
    """
    size = (resolution, resolution)
    low, high = body.amin(0), body.amax(0)
    middle, radius = (low + high) / 2, float((high - low).norm()) / 2 * 1.01 + 1e-12
    sideways = lights[:, 1:2].abs() >= 0.9
    up = torch.cat((sideways, ~sideways, torch.zeros_like(sideways)), 1).to(body)
    camera = Camera.orthographic(radius, eye=middle + 2 * radius * lights, target=middle, up=up)
    corners = camera.to_camera_frame(body)
    x, y, w = camera.to_image(corners, size).unbind(2)
    depth = nearest_depths(Projected(x, y, w, -corners[:, :, 2]), faces, size)
    there = camera.to_camera_frame(points)
    # A texel stores one depth, although a slope is deeper elsewhere in it: the margin is one texel plus 1.5 times the
    # slope (set by hand), which is clamped where the surface is nearly parallel to the light.
    facing = lights @ normal.T
    cosine = facing.clamp(0.05, 1)
    slack = 2 * radius / resolution * (1 + 1.5 * (1 - cosine * cosine).sqrt() / cosine)
    nearer = -there[:, :, 2] - slack
    place = camera.to_image(there, size)[:, :, :2] - 0.5
    base = place.floor()
    share = place - base
    lit = torch.zeros_like(nearer)
    for x_step in (0, 1):
        for y_step in (0, 1):
            column, row = (base + base.new_tensor((x_step, y_step))).long().clamp(0, resolution - 1).unbind(2)
            open_sky = (depth.gather(1, row * resolution + column) > nearer).to(lit)
            weight = share if x_step else 1 - share, share if y_step else 1 - share
            lit += open_sky * weight[0][:, :, 0] * weight[1][:, :, 1]
    return torch.where(facing > 0, lit, 1.0)
