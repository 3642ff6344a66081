"""Load a photometric-stereo capture: a folder of photographs and a file of lights."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError, RangeError
from .images import IMAGE_SUFFIXES, read_image, to_unit, write_image
from .photographs import read_photographs

LIGHT_FILES = ("light_directions.txt", "lights.txt")
INTENSITY_FILES = ("light_intensities.txt", "intensities.txt")
TRUTH_FILES = ("Normal_gt.mat", "normal_gt.npy")
AMBIENT = "ambient"
"""Name, without suffix, of a photograph taken with all lights off."""


@dataclass(frozen=True)
class Capture:
    """Photographs of one object under known lights, in linear light.

    Attributes:
        images: (K, 3, H, W) float32 (float16 for captures of more than half a billion samples), linear, each
            divided by its light's intensity; 1 is a white Lambertian surface facing the light where intensities
            are calibrated so.
        lights: (K, 3) unit directions to the light, camera frame (x right, y up, z to the viewer).
        intensities: (K, 3) RGB irradiance that the images were divided by.
        mask: (1, H, W) bool, the object.
        normal: (3, H, W) true normals, or None.
        names: file names of the images.
        notes: what the loader decided, one sentence each (encoding, masks, lengths).
    """

    images: Tensor
    lights: Tensor
    intensities: Tensor
    mask: Tensor
    normal: Tensor | None
    names: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    def with_own_intensities(self, *, seed: int = 0) -> Capture:
        """The capture with intensities found from itself instead of those that it was loaded with."""
        from ..stereo.calibrate import own_intensities

        raw = self.images * self.intensities[:, :, None, None].to(self.images)
        found = own_intensities(raw, self.lights, self.mask, seed=seed)
        note = f"intensities of the lights found from the capture itself, {found.min():.2f} to {found.max():.2f}."
        images = raw.div_(found[:, :, None, None])
        return replace(self, images=images, intensities=found.expand(-1, 3).float(), notes=(*self.notes, note))


def load_capture(
    path: str | os.PathLike[str],
    *,
    lights: str | os.PathLike[str] | None = None,
    mask: str | os.PathLike[str] | None = None,
    chrome: str | os.PathLike[str] | None = None,
    ambient: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
) -> Capture:
    """Load a capture from a DiLiGenT folder, a folder with a light file, an ``.lp`` file, or beside a chrome ball.

    Looked for in the folder: ``filenames.txt`` (else every image but the mask, in natural order);
    ``light_directions.txt`` or ``lights.txt`` (a line ``x y z`` per image, an image's name may stand
    first) or one ``*.lp``; ``light_intensities.txt`` (1 or 3 numbers per line, default 1); ``mask.png``
    (brighter than half its maximum; default all pixels); ``ambient.*``, a photograph with all lights off, which is
    subtracted; ``Normal_gt.mat`` or ``normal_gt.npy`` ((H, W, 3), truth).

    Args:
        path: the folder, or an ``.lp`` file beside its images.
        lights: a light file kept elsewhere.
        mask: a mask image kept elsewhere; white is the object.
        chrome: a folder of photographs of a mirror ball under the same lights, in the same order, with or without a
            ``mask.png`` of the ball; directions then come from its highlights and no light file is read.
        ambient: a photograph with all lights off, kept elsewhere.
        encoding: ``"linear"``, ``"srgb"``, or ``"auto"``: 8-bit files are sRGB-encoded, all others linear.

    Returns:
        A `Capture`.

    Raises:
        FileError: a file is missing, damaged or truncated, lies outside the folder, or images differ in
            size or bit depth, or the numbers of lights and images differ.
        RangeError: lights that are no unit vectors, intensities that are not positive.

    Source:
        File layout of Shi et al., "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated
        Photometric Stereo" (DiLiGenT), 2016; ``.lp`` as in reflectance transformation imaging.

    Example:
        >>> import tempfile, torch, torch_orennayar as ton
        >>> from torch_orennayar.io.capture import save_capture
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), dim=-1)
        >>> folder = tempfile.mkdtemp()
        >>> save_capture(folder, torch.full((3, 3, 4, 5), 0.25), lights, torch.ones(1, 4, 5, dtype=torch.bool))
        >>> ton.load_capture(folder).images.shape
        torch.Size([3, 3, 4, 5])
    """
    _check_encoding(encoding)
    source = Path(path)
    if not source.exists():
        raise FileError(str(source), expected="a capture folder or .lp file", got="nothing there", mend="check it")
    folder = source if source.is_dir() else source.parent
    if chrome is not None and lights is not None:
        raise FileError(str(chrome), expected="a light file or a chrome ball", got="both", mend="leave one out")
    mask_file = Path(mask) if mask is not None else folder / "mask.png"
    ambient_file = Path(ambient) if ambient is not None else _find_ambient(folder)
    others = tuple(f for f in (mask_file, ambient_file) if f is not None)
    notes: list[str] = []
    if chrome is not None:
        files = _image_files(folder, others)
        directions = _read_chrome(Path(chrome), len(files), encoding, notes)
    else:
        files, directions = _pair(folder, Path(lights) if lights is not None else _find_light_file(source), others)
    intensities = _read_intensities(folder, len(files), notes)
    images = read_photographs(files, encoding, notes, intensities, ambient_file)
    height, width = images.shape[-2:]
    return Capture(
        images=images,
        lights=directions,
        intensities=intensities,
        mask=_read_mask(mask_file, (height, width), required=mask is not None, notes=notes),
        normal=_read_truth(folder, (height, width)),
        names=tuple(f.name for f in files),
        notes=tuple(notes),
    )


def _check_encoding(encoding: str) -> None:
    if encoding not in ("auto", "linear", "srgb"):
        raise RangeError("encoding", expected="'auto', 'linear' or 'srgb'", got=repr(encoding), mend="choose one")


def load_photograph(
    path: str | os.PathLike[str],
    light: Tensor,
    *,
    mask: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
) -> Capture:
    """Read one photograph under one light, as `shape_from_shading` takes it.

    Args:
        path: the picture.
        light: (3,) unit direction.
        mask: its mask file; default: every pixel is the object.
        encoding: as in `load_capture`.

    Raises:
        FileError: a file is missing, damaged or of another size.
        RangeError: unknown encoding.
    """
    _check_encoding(encoding)
    notes: list[str] = []
    images = read_photographs([Path(path)], encoding, notes, torch.ones(1, 3), None)
    size = (images.shape[2], images.shape[3])
    inside = torch.ones(1, *size, dtype=torch.bool)
    if mask is not None:
        inside = _read_mask(Path(mask), size, required=True, notes=notes)
    return Capture(images, light[None], torch.ones(1, 3), inside, None, (Path(path).name,), tuple(notes))


def save_capture(
    path: str | os.PathLike[str],
    images: Tensor,
    lights: Tensor,
    mask: Tensor,
    normal: Tensor | None = None,
) -> None:
    """Write a capture that `load_capture` reads: 16-bit linear PNGs, each stretched to its full range.

    Args:
        path: the folder.
        images: (K, 3, H, W) linear light, >= 0; what the format cannot hold goes into the intensities.
        lights: (K, 3) unit.
        mask: (1, H, W) bool.
        normal: (3, H, W) true normals, or None.
    """
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    top = images.amax((1, 2, 3)).clamp_min(1e-6)
    names = [f"{index + 1:03d}.png" for index in range(len(images))]
    for name, image, scale in zip(names, images, top, strict=True):
        write_image(folder / name, image / scale, bits=16)
    (folder / "filenames.txt").write_text("\n".join(names) + "\n")
    np.savetxt(folder / "light_directions.txt", lights.cpu().numpy(), fmt="%.8f")
    np.savetxt(folder / "light_intensities.txt", (1 / top)[:, None].expand(-1, 3).cpu().numpy(), fmt="%.8g")
    write_image(folder / "mask.png", mask.float())
    if normal is not None:
        np.save(folder / "normal_gt.npy", normal.permute(1, 2, 0).cpu().numpy())


def _find_light_file(source: Path) -> Path:
    if source.is_file():
        return source
    found = [source / name for name in LIGHT_FILES if (source / name).is_file()] or sorted(source.glob("*.lp"))
    if len(found) > 1 and found[0].suffix == ".lp":
        raise FileError(str(source), expected="one .lp file", got=str(len(found)), mend="name the one that counts")
    if not found:
        raise FileError(
            str(source),
            expected=f"{' or '.join(LIGHT_FILES)} or an .lp file",
            got="none of them",
            mend="write one line 'x y z' per image, or pass lights= (--lights)",
        )
    return found[0]


def _lines(file: Path) -> list[list[str]]:
    """The words of each line, without comments, blank lines and the marks of other systems."""
    if not file.is_file():
        raise FileError(str(file), expected="a text file", got="nothing there", mend="check the name")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(str(file), expected="a text file", got="binary data", mend="save it as UTF-8") from error
    rows = (line.split("#")[0].replace(",", " ").split() for line in text.splitlines())
    return [row for row in rows if row]


def _find_ambient(folder: Path) -> Path | None:
    found = [f for f in sorted(folder.iterdir()) if f.stem.lower() == AMBIENT and f.suffix.lower() in IMAGE_SUFFIXES]
    return found[0] if found else None


def load_ball(
    path: str | os.PathLike[str], *, mask: str | os.PathLike[str] | None = None, encoding: str = "auto"
) -> tuple[Tensor, Tensor | None]:
    """Photographs of a calibration ball, without lights: images (K, 3, H, W) and its mask (1, H, W) or None.

    Args:
        path: a folder; ``mask.png`` in it, white on the ball, is its mask.
        mask: a mask kept elsewhere.
        encoding: as `load_capture` takes it.

    Raises:
        FileError: as `load_capture`.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise FileError(str(folder), expected="a folder of photographs", got="no folder", mend="check the name")
    mask_file = Path(mask) if mask is not None else folder / "mask.png"
    files = _image_files(folder, (mask_file,))
    images = read_photographs(files, encoding, [], torch.ones(len(files), 3), None)
    if mask is None and not mask_file.is_file():
        return images, None
    return images, _read_mask(mask_file, (images.shape[2], images.shape[3]), required=True, notes=[])


def _read_chrome(folder: Path, count: int, encoding: str, notes: list[str]) -> Tensor:
    """Light directions (K, 3) from photographs of a mirror ball."""
    from ..stereo.calibrate import find_ball, find_circle, light_directions

    images, mask = load_ball(folder, encoding=encoding)
    if len(images) != count:
        raise FileError(
            str(folder), expected=f"{count} photographs, one per light", got=str(len(images)), mend="pair them"
        )
    ball = find_circle(images) if mask is None else find_ball(mask)
    notes.append(f"lights from the chrome ball at ({ball.x:.1f}, {ball.y:.1f}), radius {ball.radius:.1f} pixels.")
    return light_directions(images, ball)


def _pair(folder: Path, light_file: Path, others: tuple[Path, ...]) -> tuple[list[Path], Tensor]:
    """Image files and their light directions, matched by name where the light file has names."""
    rows = _lines(light_file)
    if not rows:
        raise FileError(str(light_file), expected="one line 'x y z' per image", got="an empty file", mend="fill it")
    if rows and len(rows[0]) == 1:  # .lp files begin with their count
        count = rows.pop(0)[0]
        if count != str(len(rows)):
            raise FileError(
                str(light_file), expected=f"{count} lights as its first line says", got=str(len(rows)), mend="mend it"
            )
    named = [" ".join(row[:-3]) for row in rows if len(row) > 3]
    if named and len(named) != len(rows):
        raise FileError(str(light_file), expected="a name in all lines or in none", got="both", mend="mend the file")
    directions = _numbers(light_file, [row[-3:] if named else row for row in rows], (3,))
    length = directions.norm(dim=1, keepdim=True)
    for index in ((length - 1).abs() > 0.02).flatten().nonzero().flatten().tolist():
        raise RangeError(
            f"{light_file} entry {index + 1}",
            expected="a unit vector",
            got=f"length {length[index].item():.4g}",
            mend=f"divide it by its length; intensities belong into {INTENSITY_FILES[0]}",
        )
    files = [_inside(folder, name) for name in named] or _image_files(folder, others)
    if named and (extra := _intensity_file(folder)):
        raise FileError(
            str(extra),
            expected="no intensities beside lights that have names",
            got="lines without names, which may be in another order",
            mend="remove it, or give the lights without names, in the order of the images",
        )
    if len(files) != len(rows):
        listed = f"{files[0].name} to {files[-1].name}" if files else "none"
        raise FileError(
            str(light_file),
            expected=f"{len(files)} lights, one per image ({listed})",
            got=str(len(rows)),
            mend="add the missing lines, or list the images that count in filenames.txt"
            if len(rows) < len(files)
            else "remove the lines that have no image",
        )
    return files, (directions / length).float()


def _image_files(folder: Path, others: tuple[Path, ...]) -> list[Path]:
    """Photographs in natural order: those of ``filenames.txt``, or all images but the mask and ``others``."""
    listing = folder / "filenames.txt"
    if listing.is_file():
        return [_inside(folder, " ".join(row)) for row in _lines(listing)]

    def natural(file: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]

    def is_photograph(file: Path) -> bool:
        hidden = file.name.startswith(".") or file.stem.lower() == "mask"
        hidden = hidden or file.resolve() in {other.resolve() for other in others}
        return file.suffix.lower() in IMAGE_SUFFIXES and not hidden

    return sorted(filter(is_photograph, folder.iterdir()), key=natural)


def _inside(folder: Path, name: str) -> Path:
    """``folder / name``, refused if that is not inside the folder."""
    file = folder / name.replace("\\", "/")
    if not file.resolve().is_relative_to(folder.resolve()):
        raise FileError(
            name, expected=f"a file inside {folder}", got="a path that leaves it", mend="move the image into the folder"
        )
    return file


def _numbers(file: Path, rows: list[list[str]], widths: tuple[int, ...]) -> Tensor:
    table: list[list[float]] = []
    for index, row in enumerate(rows):
        try:
            values = [float(word) for word in row]
        except ValueError:
            values = []
        if len(values) not in widths or len(values) != len(table[0] if table else values):
            raise FileError(
                f"{file} entry {index + 1}",
                expected=f"{' or '.join(str(w) for w in widths)} numbers, as many in every line",
                got=" ".join(row)[:60],
                mend="mend the line",
            )
        table.append(values)
    result = torch.tensor(table, dtype=torch.float64).reshape(len(table), -1)
    if not bool(result.isfinite().all()):
        raise RangeError(str(file), expected="finite numbers", got="NaN or infinity", mend="mend the file")
    return result


def _intensity_file(folder: Path) -> Path | None:
    return next((folder / name for name in INTENSITY_FILES if (folder / name).is_file()), None)


def _read_intensities(folder: Path, count: int, notes: list[str]) -> Tensor:
    file = _intensity_file(folder)
    if file is None:
        notes.append("no light intensities: all lights taken as equally bright.")
        return torch.ones(count, 3)
    values = _numbers(file, _lines(file), (1, 3))
    if len(values) != count:
        raise FileError(
            str(file), expected=f"{count} lines, one per image", got=str(len(values)), mend="one line per image"
        )
    if not bool((values > 0).all()):
        raise RangeError(str(file), expected="positive intensities", got=f"{values.min():g}", mend="mend the file")
    return values.expand(-1, 3).float().contiguous()


def _read_mask(file: Path, size: tuple[int, int], *, required: bool, notes: list[str]) -> Tensor:
    if not file.is_file() and not required:
        notes.append("no mask.png: every pixel is taken as the object.")
        return torch.ones(1, *size, dtype=torch.bool)
    array = to_unit(read_image(file))
    array = array if array.ndim == 2 else array.max(axis=2)
    if array.shape != size:
        raise FileError(
            str(file),
            expected=f"{size[1]} x {size[0]} pixels as the images have",
            got=f"{array.shape[1]} x {array.shape[0]}",
            mend="crop or resize the mask",
        )
    mask = torch.from_numpy(array > array.max() / 2)[None]  # also for masks of 0 and 1
    if not bool(mask.any()):
        raise FileError(str(file), expected="some white pixels", got="an empty mask", mend="paint the object white")
    return mask


def _read_truth(folder: Path, size: tuple[int, int]) -> Tensor | None:
    file = next((folder / name for name in TRUTH_FILES if (folder / name).is_file()), None)
    if file is None:
        return None
    try:
        array = _load_truth(file)
    except Exception as error:  # scipy and numpy raise many kinds for damaged files
        raise FileError(
            str(file), expected="an array of true normals", got=str(error), mend="replace or remove the file"
        ) from error
    if array.shape != (*size, 3):
        raise FileError(
            str(file), expected=f"shape {(*size, 3)}", got=str(array.shape), mend="crop it as the images are"
        )
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).permute(2, 0, 1)


def _load_truth(file: Path) -> npt.NDArray[np.float64]:
    if file.suffix == ".npy":
        return np.asarray(np.load(file, allow_pickle=False))
    from scipy.io import loadmat

    return np.asarray(loadmat(file, variable_names=["Normal_gt"])["Normal_gt"])
