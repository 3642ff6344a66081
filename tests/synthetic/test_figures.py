"""Figures, heaps, vessels and reliefs: closed surfaces, drawn anew by number, seen and rendered as other meshes are."""

from __future__ import annotations

import pytest
import torch
import trimesh

from torch_orennayar import Ingredients, OrenNayar, SyntheticCaptures, collate_captures
from torch_orennayar.synthetic.draw import Draw
from torch_orennayar.synthetic.figures import draw_figure


@pytest.mark.parametrize("seed", range(12))
def test_surfaces_are_closed_and_face_outward(seed: int) -> None:
    vertices, faces = draw_figure(Draw(seed))
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy())
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert all(torch.equal(*parts) for parts in zip((vertices, faces), draw_figure(Draw(seed)), strict=True))


def test_captures_of_figures_render_again_and_differ() -> None:
    captures = SyntheticCaptures(
        "images", mix=Ingredients.plain(rough=1.0), meshes="figures", lights=(2, 2), size=(48, 48), length=4
    )
    batch = collate_captures(list(captures))
    maps = [batch[name] for name in ("normal", "true_lights", "view", "albedo", "roughness")]
    rendered = batch["brightness"] * batch["exposure"] * OrenNayar("vcavity")(*maps)
    assert (rendered - batch["images"]).abs().max() < 1e-5
    assert batch["mask"].flatten(1).sum(1).min() > 100
    shapes = {tuple(mask.flatten().tolist()) for mask in batch["mask"]}
    assert len(shapes) == 4
