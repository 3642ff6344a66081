"""
Where every method fails
========================

What the methods of this package cannot do, on made-up captures whose truth is known.
"""

import matplotlib.pyplot as plt
import torch

import torch_orennayar as ton

cases: list[tuple[str, torch.Tensor, torch.Tensor, torch.Tensor]] = []


def capture(number: int, lights: int, mix: ton.Ingredients) -> ton.SyntheticImages:
    """A made-up capture with its truth."""
    return ton.SyntheticCaptures("images", seed=1, mix=mix, size=(80, 80), lights=(lights, lights)).sample(number)


def add(title: str, made: ton.SyntheticImages, found: torch.Tensor) -> None:
    """Keep a case for the picture, and print its error."""
    error = ton.angular_error(found, made["normal"], made["mask"])
    cases.append((f"{title}: {error.summary()['mean']:.0f}°", made["images"][0], found, error))


# %%
# Metal has almost no diffuse part; three lights leave nothing to tell highlights and shadows by; and photographs of
# an object in another order than the light file's contradict it as a whole.
metal = capture(3, 24, ton.Ingredients.plain(glossy=1.0, metal=1.0))
add("metal, 24 lights", metal, ton.photometric_stereo(metal["images"], metal["lights"], metal["mask"]).normal)
shiny = capture(6, 3, ton.Ingredients.plain(glossy=1.0, shadows=1))
add("3 lights", shiny, ton.photometric_stereo(shiny["images"], shiny["lights"], shiny["mask"]).normal)
order = capture(4, 12, ton.Ingredients.plain(rough=1.0))
turned = ton.photometric_stereo(order["images"], order["lights"].roll(4, 0), order["mask"], model="vcavity")
add("lights in another order", order, turned.normal)

# %%
# One picture does not tell paint from shape.
painted = capture(2, 1, ton.Ingredients.plain(rough=1.0))
one = ton.shape_from_shading(painted["images"][0], painted["lights"][0], painted["mask"], albedo=None, roughness=0.5)
add("one picture, painted", painted, one.normal)

# %%
# Some things are refused rather than guessed: the lights of a flat object, or of too few photographs.
for given in (metal["images"], order["images"][:4]):
    try:
        ton.find_lights(given, torch.ones(1, 80, 80, dtype=torch.bool))
    except ton.TorchOrenNayarError as error:  # noqa: PERF203
        print(error)

figure, axes = plt.subplots(3, 4, figsize=(10, 7.4), layout="constrained")
for column, (title, image, normal, off) in zip(axes.T, cases, strict=True):
    column[0].imshow(ton.linear_to_srgb((image / image.max()).clamp(0, 1)).permute(1, 2, 0))
    column[0].set_title(title, fontsize=9)
    column[1].imshow(ton.encode_normals(normal).permute(1, 2, 0))
    column[2].imshow(off[0], vmin=0, vmax=45, cmap="magma")
for axis in axes.flat:
    axis.axis("off")
plt.show()
