from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import ShapeError, angular_error


@given(st.floats(0, 180))
def test_known_angles(degrees: float) -> None:
    a = torch.tensor([0.0, 0.0, 2.0]).double()
    r = math.radians(degrees)
    b = torch.tensor([math.sin(r), 0.0, math.cos(r)], dtype=torch.float64)
    assert angular_error(a, b, dim=-1).item() == pytest.approx(degrees, abs=1e-9)


def test_map_is_nan_outside_the_foreground_and_sums_up_inside() -> None:
    a = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1).repeat(1, 1, 2, 4)
    b = a.clone()
    b[0, :, 0, 0] = torch.tensor([1.0, 0, 0])
    b[0, :, 1, :] = 0
    error = angular_error(a, b)
    assert error.shape == (1, 1, 2, 4)
    assert error[0, 0, 1].isnan().all()
    summary = error.summary()
    assert summary["mean"] == pytest.approx(22.5)
    assert summary["median"] == 0
    assert summary["within_5"] == 0.75


def test_a_pixel_of_the_mask_where_nothing_was_found_counts_as_180() -> None:
    a = torch.tensor([0.0, 0, 1]).reshape(3, 1, 1).repeat(1, 1, 2)
    b = a.clone()
    b[:, 0, 0] = 0
    error = angular_error(b, a, torch.tensor([[[True, True]]]))
    assert error.flatten().tolist() == [180.0, 0.0]
    assert angular_error(b, a, torch.tensor([[[False, True]]])).summary()["mean"] == 0


@pytest.mark.parametrize("unknown", [0.0, math.nan])
def test_pixels_without_truth_are_left_out(unknown: float) -> None:
    estimate = torch.tensor([0.0, 0, 1]).reshape(3, 1, 1).repeat(1, 1, 2)
    truth = estimate.double()
    truth[:, 0, 0] = unknown
    error = angular_error(estimate, truth, torch.ones(1, 1, 2, dtype=torch.bool))
    assert error.isnan().flatten().tolist() == [True, False]
    assert error.summary()["pixels"] == 1
    assert error.summary()["mean"] == 0


def test_half_precision() -> None:
    n = torch.tensor([0.0, 0, 1]).half()
    assert angular_error(n, n, dim=-1).item() == 0


def test_it_is_a_tensor() -> None:
    n = torch.randn(3, 4, 5)
    error = angular_error(n, n)
    assert isinstance(error, torch.Tensor)
    assert error[error < 10].numel() == 20
    assert math.isnan(angular_error(n * 0, n).summary()["mean"])


def test_bad_shapes() -> None:
    with pytest.raises(ShapeError, match="dim"):
        angular_error(torch.zeros(4, 3), torch.zeros(4, 3))
    with pytest.raises(ShapeError, match="mask"):
        angular_error(torch.zeros(3, 4, 4), torch.zeros(3, 4, 4), torch.ones(1, 5, 5, dtype=torch.bool))


def test_a_mask_without_an_axis_for_the_vectors_does_not_spread_over_the_batch() -> None:
    normal = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1).repeat(2, 1, 8, 8)
    mask = torch.ones(2, 8, 8, dtype=torch.bool)
    with pytest.raises(ShapeError, match="unsqueeze"):
        angular_error(normal, normal, mask)
    assert angular_error(normal, normal, mask.unsqueeze(-3)).summary()["pixels"] == 128
    assert angular_error(normal, normal, mask[0]).summary()["pixels"] == 128
