"""The compiled model against the tensors' in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar.core.optional import available
from torch_orennayar.reflectance import gradients

pytestmark = pytest.mark.skipif(not available("numba"), reason="numba is not installed")


@given(
    ci=st.floats(2.0**-13, 1, width=32),
    co=st.floats(2.0**-6, 1, width=32),
    lv=st.floats(-1, 1, width=32),
    rho=st.floats(0, 2, width=32),
    sigma=st.floats(0, 1.25, width=32),
)
def test_value_and_derivatives(ci: float, co: float, lv: float, rho: float, sigma: float) -> None:
    from torch_orennayar.reflectance.compiled_vcavity import vcavity

    found = vcavity(*(np.float32(v) for v in (ci, co, lv, rho, sigma)))
    arguments = torch.tensor((ci, co, lv, rho, sigma, 1), dtype=torch.float64)
    value, (by_ci, by_co, _, by_rho, _) = gradients.vcavity(*arguments)
    for got, wanted in zip(found, (value, by_ci, by_co, by_rho), strict=True):
        assert wanted is not None
        # At grazing angles the form's roots amplify the rounding of their arguments.
        assert float(got) == pytest.approx(wanted.item(), rel=2e-4, abs=2e-4)
