"""What the pages of the models say beside measurements: formulas in the papers' symbols, and slips that circulate."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Notes:
    """What is written by hand about a model.

    Attributes:
        formula: displayed formulas, each in LaTeX with what introduces it.
        use: when to take it, in a sentence or two.
        slips: slips that circulate and are not measured, a sentence each.
        copies: implementations of `scripts.benchmarks.baselines` that are meant to be this model, by name.
        code: names in ``reflectance/formulas.py`` (or ``theory.py``) that make up the model.
    """

    formula: tuple[tuple[str, str], ...]
    use: str
    code: tuple[str, ...]
    slips: tuple[str, ...] = ()
    copies: tuple[str, ...] = ()


_A_AND_B = r"A = 1 - 0.5\,\frac{\sigma^2}{\sigma^2 + %s}, \qquad B = 0.45\,\frac{\sigma^2}{\sigma^2 + 0.09}"
_CLASSIC = (
    r"L_r(\theta_r, \theta_i, \phi_r - \phi_i; \sigma) = \frac{\rho}{\pi} E_0 \cos\,\theta_i "
    r"\left(A + B \max\left[0, \cos(\phi_r - \phi_i)\right] \sin\,\alpha \tan\,\beta\right)"
)
_UNITS = "σ is an angle in radians. Code that takes degrees, or a microfacet α, gives a plausible picture all the same."

NOTES: dict[str, Notes] = {
    "lambert": Notes(
        formula=(("Lambert 1760:", r"L_r = \frac{\rho}{\pi} E_0 \cos\,\theta_i"),),
        use="Most materials: smooth surfaces, and rough ones wherever the table of choices below says so.",
        code=("lambert",),
        slips=(
            "1/π or the cosine counted twice, or never: shading here is π f_r cos θ, so that white is 1.",
            "The cosine not cut off at 0, which lights the far side with negative light.",
        ),
    ),
    "qualitative": Notes(
        formula=(("Oren & Nayar 1994, eq. 30:", _CLASSIC), ("with", _A_AND_B % "0.33")),
        use="To match other renderers and papers that say “Oren-Nayar” without more.",
        code=("qualitative", "_classic", "_a_b"),
        slips=(
            _UNITS,
            "0.57 for 0.33 in A: another variant of the paper (`qualitative-0.57`), not a correction.",
            "Normalised projected vectors are 0/0 where light or view is along the normal, and the derivative of "
            "`acos` is infinite there: gradients of every pixel that faces the camera are not a number. In cosines "
            "nothing is divided but by max(n·l, n·v).",
        ),
        copies=("acos", "HLSL rewrite", "sin sin", "A bracket"),
    ),
    "qualitative-0.57": Notes(
        formula=(("Oren & Nayar 1994, eq. 30, with the constant that the paper suggests for bounces:", _CLASSIC),
                 ("with", _A_AND_B % "0.57")),
        use="To match code that follows Wikipedia; nearer to the theory than 0.33 on bright surfaces alone.",
        code=("qualitative_057", "_classic", "_a_b"),
        slips=("Taken for the constant of eq. 30 itself, which is 0.33.", _UNITS),
    ),
    "fujii": Notes(
        formula=(
            ("Fujii 2012:", r"L_r = \frac{\rho}{\pi} E_0 \cos\,\theta_i \left(A + B\,\frac{s}{t}\right), \qquad "
             r"s = \mathbf{l}\cdot\mathbf{v} - (\mathbf{n}\cdot\mathbf{l})(\mathbf{n}\cdot\mathbf{v})"),
            ("with", r"A = 1 - 0.5\,\frac{\sigma^2}{\sigma^2 + 0.33} + 0.17\,\rho\,\frac{\sigma^2}{\sigma^2 + 0.13}, "
             r"\qquad B = 0.45\,\frac{\sigma^2}{\sigma^2 + 0.09}"),
            ("and", r"t = \begin{cases} 1 & s \le 0 \\ \max(\mathbf{n}\cdot\mathbf{l}, \mathbf{n}\cdot\mathbf{v}) "
             r"& s > 0 \end{cases}"),
        ),
        use="As accurate as the full model at about the cost of the classic one.",
        code=("fujii", "_a_b"),
        slips=("The albedo left out of the term with 0.17, which then brightens dark surfaces.", _UNITS),
        copies=("A plus",),
    ),
    "full": Notes(
        formula=(
            ("Oren & Nayar 1994, direct light, eq. 27:",
             r"L_r^1 = \frac{\rho}{\pi} E_0 \cos\,\theta_i \left[C_1 + \cos(\phi_r - \phi_i)\, C_2 \tan\,\beta + "
             r"\left(1 - \left|\cos(\phi_r - \phi_i)\right|\right) C_3 \tan\,\frac{\alpha + \beta}{2}\right]"),
            ("with", r"C_1 = 1 - 0.5\,\frac{\sigma^2}{\sigma^2 + 0.33}, \qquad C_3 = 0.125\,"
             r"\frac{\sigma^2}{\sigma^2 + 0.09}\left(\frac{4\alpha\beta}{\pi^2}\right)^2"),
            ("and", r"C_2 = 0.45\,\frac{\sigma^2}{\sigma^2 + 0.09} \begin{cases} \sin\,\alpha & "
             r"\cos(\phi_r - \phi_i) \ge 0 \\ "
             r"\sin\,\alpha - \left(\frac{2\beta}{\pi}\right)^3 & \text{otherwise} \end{cases}"),
            ("One bounce, eq. 28; the model is the sum of both, eq. 29:",
             r"L_r^2 = 0.17\,\frac{\rho^2}{\pi} E_0 \cos\,\theta_i\,\frac{\sigma^2}{\sigma^2 + 0.13}"
             r"\left[1 - \cos(\phi_r - \phi_i)\left(\frac{2\beta}{\pi}\right)^2\right]"),
        ),
        use="To reproduce results that used it; else `fujii` is as accurate and cheaper, `vcavity` far more accurate.",
        code=("full", "_a_b"),
        slips=(
            "ρ for ρ² in the bounce, which brightens dark surfaces.",
            "`acos` of a cosine that rounding made larger than 1; at the normal its derivative is infinite anyway.",
        ),
        copies=("textbook",),
    ),
    "vcavity": Notes(
        formula=(
            ("A rational fit in cosines:", r"\pi f_r = \rho \max\left(0,\; Z_0 + u\,(Z_1 + u\,Z_2)\right)"),
            ("Roughness, albedo and its series of bounces:",
             r"y = \frac{\sigma^2}{\sigma^2 + c}, \qquad b = \min(\rho, 1), \qquad l = \frac{y\,b}{1 - \beta b}"),
            ("Directions:", r"q = c_i c_o, \quad p = c_i + c_o, \quad h = 1 + \mathbf{l}\cdot\mathbf{v}, \quad "
             r"s = \mathbf{l}\cdot\mathbf{v} - q, \quad k = k_0 + k_1 y + k_2 y^2"),
            ("Masking and shadowing:",
             r"u = \frac{y}{\sqrt{(k + (1-k) c_i^2)(k + (1-k) c_o^2)}}, \qquad r = \frac{1}{\sqrt{p^2 + "
             r"(\kappa + \tau y)(c_i^2 + c_o^2 - 2 q\,\mathbf{l}\cdot\mathbf{v})}}"),
            ("and", r"Z_0 = 1 + y\left[q r (a_0 h r + a_2) + a_1 p r + a_3 y^2 p + b\,(g_0 + g_1 y^2 + g_2 p) + "
             r"l\,(d_0 + y\,(d_1 q + d_2 h))\right]"),
            ("", r"Z_1 = h r \left(a_4 + y\,(a_5 + a_6 q + a_7 p r)\right) + s\,(a_8 + a_9 s + a_{10} y^2 p) + "
             r"y\left(a_{11} + b r\,(g_3 q r + g_4 h p)\right) + l\,d_3 q"),
            ("", r"Z_2 = a_{12} + a_{13} p + l\,d_4 s^2"),
        ),
        use="The default where roughness matters: the only closed form here that is smooth and that keeps the light of "
        "later bounces.",
        code=("vcavity", "vcavity_form"),
        slips=("None known: the fit is of this package. Its coefficients belong to this form and to no other.",),
    ),
    "eon": Notes(
        formula=(
            ("Portsmouth, Kutz & Hill 2024, one bounce:",
             r"f = \frac{\rho}{\pi} A \left(1 + r\,\frac{s}{t}\right), \qquad "
             r"A = \frac{1}{1 + \left(\frac{1}{2} - \frac{2}{3\pi}\right) r}"),
            ("and all further ones:",
             r"f_{ms} = \frac{\rho_{ms}}{\pi}\,\frac{(1 - E(\theta_o))(1 - E(\theta_i))}{1 - \langle E\rangle}, \qquad "
             r"\rho_{ms} = \frac{\rho^2 \langle E\rangle}{1 - \rho\,(1 - \langle E\rangle)}"),
            ("with", r"E(\theta) = A\left(1 + \frac{r}{\pi} G(\theta)\right), \qquad \langle E\rangle = "
             r"A\left(1 + \left(\frac{2}{3} - \frac{28}{15\pi}\right) r\right)"),
            ("s and t as in `fujii`; G by the paper's polynomial in 1 - cos θ. Its r is mapped from σ by a fit to the "
             "theory (`scripts/fit/fit_eon.py`):", r"r = \frac{\sigma^2}{0.2859 + 1.1110\,\sigma^2}"),
        ),
        use="To match OpenPBR and Blender, and where a white surface must reflect all light.",
        code=("eon", "eon_from_r", "_eon_g"),
        slips=("Its r, from 0 to 1, taken for σ: it is another quantity (the table under *Coming from elsewhere*).",),
    ),
    "theory": Notes(
        formula=(
            ("Symmetric grooves with Lambertian walls; a wall has normal a, the opposite one a'. Direct light:",
             r"R_1 = \int P\,\frac{\langle l,a\rangle_+ \langle v,a\rangle_+}{\langle a,n\rangle\, c_i c_o}\, "
             r"\min\left(1, \frac{2 c_i \langle a,n\rangle}{\langle l,a\rangle}, "
             r"\frac{2 c_o \langle a,n\rangle}{\langle v,a\rangle}\right) d\omega_a"),
            ("First bounce, with the exchange IF of the visible and the lit part of the walls (Hottel's strings):",
             r"R_2 = \int P\,\frac{\langle l,a'\rangle_+ \langle v,a\rangle_+}{\langle a,n\rangle\, c_i c_o}\, IF\, "
             r"d\omega_a"),
            ("The density of slopes, of unit integral over the macroscopic area:",
             r"P \propto \exp\left(-\frac{\theta_a^2}{2\sigma^2}\right)"),
            ("All bounces, with the operator T from the radiosity of one wall to the irradiance of the other:",
             r"\pi f_r = \rho\left(R_1 + \rho R_2 + \rho^2 \langle T^2 (1 - \rho T)^{-1} \rangle\right)"),
        ),
        use="To judge the others, or to render one small picture: it is a quadrature, and slow.",
        code=("theory", "reflectance_by_bounces"),
        slips=(
            "“Rough surfaces are brighter”: the theory keeps the light or loses some, and moves it toward the edge.",
            "“The classic form errs mainly for want of bounces”: on dark surfaces, which have few, it errs too, "
            "because it cuts off its second term where light and view are on opposite sides of the normal.",
            "The density normalised over slopes rather than over the macroscopic area.",
        ),
    ),
}  # fmt: skip
"""By model. Formulas are compared with the code where they are written; numbers stand in generated tables only."""
