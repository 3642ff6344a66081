"""NumPy arrays where tensors belong: refused with what makes tensors of them, wherever they are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import torch_orennayar as ton

images: Any = np.full((8, 3, 9, 9), 0.5, np.float32)
lights: Any = np.tile(np.array([0, 0, 1], np.float32), (8, 1))
normal: Any = np.zeros((3, 9, 9), np.float32) + np.array([0, 0, 1], np.float32)[:, None, None]
mask: Any = np.ones((1, 9, 9), bool)
vertices: Any = np.eye(3, dtype=np.float32)
faces: Any = np.array([[0, 1, 2]])
camera, light = ton.Camera.orthographic(), torch.tensor([0.0, 0.0, 1.0])

CALLS: dict[str, Callable[[], Any]] = {
    "photometric_stereo": lambda: ton.photometric_stereo(images, lights),
    "its lights": lambda: ton.photometric_stereo(torch.as_tensor(images), lights),
    "its mask": lambda: ton.photometric_stereo(torch.as_tensor(images), torch.as_tensor(lights), mask),
    "near_light_stereo": lambda: ton.near_light_stereo(images, lights),
    "find_light_positions": lambda: ton.find_light_positions(images, lights),
    "find_lights": lambda: ton.find_lights(images, mask),
    "make_tokens": lambda: ton.make_tokens(images[:, 0, 0], lights),
    "shape_from_shading": lambda: ton.shape_from_shading(images[0], light),
    "its light": lambda: ton.shape_from_shading(torch.as_tensor(images[0]), lights[0]),
    "silhouette_normals": lambda: ton.silhouette_normals(mask),
    "integrate_normals": lambda: ton.integrate_normals(normal),
    "depth_to_normals": lambda: ton.depth_to_normals(normal[2:]),
    "angular_error": lambda: ton.angular_error(normal, normal),
    "its foreground": lambda: ton.angular_error(torch.as_tensor(normal), torch.as_tensor(normal), mask),
    "encode_normals": lambda: ton.encode_normals(normal),
    "decode_normals": lambda: ton.decode_normals(normal),
    "linear_to_srgb": lambda: ton.linear_to_srgb(images),
    "srgb_to_linear": lambda: ton.srgb_to_linear(images),
    "swap_opencv_frame": lambda: ton.swap_opencv_frame(normal, dim=0),
    "point_light": lambda: ton.point_light(normal, lights[0], 1.0, dim=0),
    "render_normals": lambda: ton.render_normals(vertices, faces, camera, (9, 9)),
    "its faces": lambda: ton.render_normals(torch.as_tensor(vertices), faces, camera, (9, 9)),
    "vertex_normals": lambda: ton.vertex_normals(vertices, faces),
    "normalise_mesh": lambda: ton.normalise_mesh(vertices),
    "save_mesh": lambda: ton.save_mesh("never.ply", vertices, faces),
    "RandomRelight": lambda: ton.RandomRelight()({"normal": normal}),
    "OrenNayar": lambda: ton.OrenNayar()(normal, lights[0]),
}


@pytest.mark.parametrize("name", CALLS)
def test_arrays_are_refused(name: str) -> None:
    with pytest.raises(ton.ShapeError, match=r"torch\.as_tensor"):
        CALLS[name]()
