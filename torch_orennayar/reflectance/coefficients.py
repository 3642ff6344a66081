"""Coefficients of `formulas.vcavity_form`, written by scripts/fit/fit_vcavity.py; do not edit."""

VCAVITY_SHAPE = (
    0.54856,
    0.79828,
    0.0018042,
    1.008,
    2.3882,
    3.5931,
    0.75488,
)
"""c, beta, k0, k1, k2, kappa and turn: found by a simplex search; without unit."""

VCAVITY_LINEAR = (
    1.22359,
    -0.936467,
    -0.650238,
    0.307834,
    0.0542023,
    2.0921,
    -0.668046,
    -0.564391,
    0.577545,
    -0.113197,
    -0.334538,
    -1.53607,
    -0.30275,
    0.28828,
    0.435429,
    -0.428356,
    0.098487,
    4.65182,
    -0.887412,
    0.0328237,
    -0.0864465,
    0.0215626,
    0.221324,
    0.135062,
)
"""a (14 values), g (5) and d (5): found by weighted least squares; without unit."""
