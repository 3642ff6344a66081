"""
A broken photograph
===================

The flash did not fire once, and two photographs were swapped. The robust solvers leave out what contradicts the rest
and name it in their report.
"""

import matplotlib.pyplot as plt

import torch_orennayar as ton

mix = ton.Ingredients.plain(rough=1.0, shadows=1)
made = ton.SyntheticCaptures("images", seed=1, mix=mix, size=(96, 96), lights=(16, 16)).sample(6)
images, lights, normal, mask = made["images"], made["lights"], made["normal"], made["mask"]

broken = images.clone()
broken[4] = 0.02 * images[4]  # only the room's light
broken[[9, 12]] = images[[12, 9]]

# %%
# Two solvers on whole and on broken photographs. ``Finding.code`` is stable, its wording is not.
figure, axes = plt.subplots(1, 5, figsize=(11, 2.6), layout="constrained")
axes[0].imshow(ton.linear_to_srgb(images[0].clamp(0, 1)).permute(1, 2, 0))
axes[0].set_title("a photograph", fontsize=9)
panels = iter(axes[1:])
for name, options in (("least squares", {"model": "lambert", "robust": False}), ("vcavity", {"model": "vcavity"})):
    for kind, photographs in (("whole", images), ("broken", broken)):
        found = ton.photometric_stereo(photographs, lights, mask, **options)
        error = ton.angular_error(found.normal, normal, mask)
        axis = next(panels)
        axis.imshow(error[0], vmin=0, vmax=25, cmap="magma")
        axis.set_title(f"{name}, {kind}: {error.summary()['mean']:.1f}°", fontsize=9)
        for finding in found.report:
            if finding.code == "frames-left-out":
                print(name, kind, finding.value, finding)
figure.colorbar(axes[4].images[0], ax=axes[4], label="degrees")
for axis in axes:
    axis.axis("off")

# %%
# Of three photographs there is none to spare: what a dark one leaves does not determine a normal, and that is said.
try:
    ton.photometric_stereo(broken[[0, 4, 9]], lights[[0, 4, 9]], mask, model="lambert")
except ton.CaptureError as error:
    print(error)
plt.show()
