"""Findings: sentences about a result that a program can branch on by their code."""

from __future__ import annotations

CODES: dict[str, str] = {
    # loading a capture
    "encoding-chosen": "the images state no encoding and were tried as both; value: error if linear over error if sRGB",
    "read-as-srgb": "the images state no encoding and were read as sRGB-encoded, or the caller said so",
    "read-as-linear": "the images state no encoding and were read as linear light, or the caller said so",
    "encoding-stated": "the images were read in the encoding that they state",
    "encoding-overridden": "the caller's encoding was used, not the one that the images state",
    "turned-upright": "the images were turned as they say; value: Exif orientation, 2 to 8",
    "mask-from-alpha": "the mask is the opaque part of its file",
    "mask-from-labels": "the mask is every label of its file but 0",
    "mask-covers-everything": "the mask leaves no pixel out",
    "mask-may-be-inverted": "the mask holds all four corners of the picture",
    "half-precision": "a large capture, whose images are kept in half precision",
    "ambient-subtracted": "a photograph with all lights off was subtracted",
    "no-intensities": "no file of light intensities; all lights are taken as equally bright",
    "intensities-from-capture": "light intensities were estimated from the capture itself",
    "lights-from-ball": "light directions come from a mirror ball; value: its radius in pixels",
    "lights-out-of-order": "lights agree far better with the names in alphabetical order; value: error over error",
    "no-mask": "no mask; every pixel is taken as the object",
    "mask-found": "no mask; the object was found before its dark background",
    "not-photographs": "number of pictures that their names tell to be something else, and were left out",
    "size-changed": "the photographs were cut or reduced; value: the factor of their size",
    # reading a mesh
    "mesh-moved": "the mesh was moved to the origin before it was rounded; value: how far",
    "faces-twice": "number of faces that lay twice between the same vertices and were dropped",
    "faces-turned": "number of faces that were wound against their neighbours and were turned over",
    "one-sided": "the faces cannot be wound alike, as on a Möbius strip",
    # lights that were not given
    "lights-found": "light directions were found from the photographs; value: their standard error in degrees",
    "brightness-found": "so was the brightness of the lights; value: its standard error in percent",
    "lights-uncertain": "that standard error is large; value: the same",
    "lights-unequal": "lights taken as equally bright differ by that many percent; normals, or lights found, are wrong",
    "lights-refined": "lights that were given contradict the photographs and were replaced; value: mean degrees",
    "lights-kept": "the photographs agree with the lights that were given; value: the largest difference in degrees",
    # choice of a model
    "model-chosen": "which model or kind of material was chosen, and why",
    # photometric stereo
    "roughness-found": "one roughness for the capture; value in degrees",
    "roughness-unreliable": "the photographs do not determine the roughness",
    "roughness-map": "roughness differs over the object; value: the median in degrees",
    "falloff-found": "exponent of Minnaert's law for the diffuse part",
    "falloff-steep": "the exponent is as large as that of images with the wrong encoding",
    "interreflection-removed": "light between parts of the surface was removed; value: the albedo found for it",
    "interreflection-kept": "light between parts of the surface was looked for and not found",
    "materials": "number of materials that the capture holds",
    "network-normals": "normals come from the network",
    "network-beside": "the network's normals stand beside fitted ones",
    "network-few-lights": "fewer lights than the network was trained on; value: their number",
    "light-distance-found": "lights were found near; value: their distance in sizes of the object",
    "lights-near": "near lights explain the photographs much better; value: their distance in sizes of the object",
    "frames-left-out": "number of photographs that contradict the others and were left out",
    "lights-contradicted": "other lights explain the photographs far better; value: the share of the error they leave",
    "lights-mirrored": "normals oppose the object's outline along an axis, or lie across it; value: their correlation",
    "clipped-samples": "samples at full scale were left out; value: their share in percent",
    "dark-pixels": "number of pixels that fewer than 3 lights reach",
    "three-lights": "with 3 lights nothing is left to estimate confidence from",
    "albedo-above-one": "number of pixels whose albedo exceeds 1",
    "lights-close-together": "condition number of the light directions",
    # shape from shading
    "light-found": "the direction to the light was found from outline and shading; value: within how many degrees",
    "network-start": "normals that a network read were the start; value: the error that it expects, degrees",
    "outline-trusted": "the inflated silhouette was the start: it explains the picture better than the network",
    "inside-out": "the same surface with dents for bumps explains the picture about as well",
    "light-near-view": "the light is so near to the view that dents and bumps look alike",
    "albedo-estimated": "albedo estimated from one picture",
    "roughness-estimated": "roughness estimated from one picture; value in degrees",
    "ambient-estimated": "ambient light as a share of the light, estimated from one picture",
    "albedo-and-roughness-estimated": "one picture does not determine albedo and roughness together",
    "no-contour": "without an occluding contour a slant of the whole surface shows only as brightness",
    "shadow-pixels": "number of pixels in shadow, where the surface is continued smoothly",
}
"""Every code and what a finding of it says; the table in the documentation is made from this."""


class Finding(str):
    """A sentence about a result, with a stable code and, where there is one, the number that it is about.

    It is a string, so that reports can print, join and serialise it as it is.

    Attributes:
        code: a key of ``core.findings.CODES``; stable between releases, the wording is not.
        value: the number in the sentence, in the unit that the code's entry names; None where there is none.

    Example:
        >>> from torch_orennayar import Finding
        >>> found = Finding("3 pixels are lit by fewer than 3 lights.", "dark-pixels", 3)
        >>> found.code, found.value, found.endswith("lights.")
        ('dark-pixels', 3, True)
    """

    __slots__ = ("code", "value")

    code: str
    value: float | None

    def __new__(cls, text: str, code: str, value: float | None = None) -> Finding:
        """A finding; ``code`` must be listed in `CODES`."""
        if code not in CODES:
            raise KeyError(f"{code!r} is not listed in torch_orennayar.core.findings.CODES")
        made = super().__new__(cls, text)
        made.code, made.value = code, value
        return made

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy with code and value."""
        return Finding, (str(self), self.code, self.value)
