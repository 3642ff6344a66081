"""``orennayar batch``."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from ..core.errors import FileError, TorchOrenNayarError
from ..core.files import atomic_path, read_json
from .options import (
    BallOutline,
    ChromeFolder,
    Crop,
    EncodingOption,
    LightFile,
    MaskChoice,
    Output,
    Report,
    Scale,
    StereoModel,
)

COLUMNS = ("capture", "images", "model", "verdict", "seconds")
LISTED = "captures.json"
"""Name of the file, among the results, that says which folder each of them is of."""
RETRIES = 2
"""How often a capture whose worker died is given to another; set by hand. Then it counts as failed."""

Row: TypeAlias = tuple[str, ...]


def batch(
    captures: Annotated[list[Path], typer.Argument(help="Folders, or text files that list folders, one per line.")],
    output: Output = Path("out"),
    model: Annotated[StereoModel, typer.Option(help="Reflectance model, or network; auto chooses.")] = "auto",
    lights: LightFile = None,
    mask: MaskChoice = None,
    chrome: ChromeFolder = None,
    ball: BallOutline = None,
    crop: Crop = None,
    scale: Scale = 1.0,
    encoding: EncodingOption = "auto",
    report: Report = True,
    again: Annotated[bool, typer.Option("--again", help="Solve captures that have a result, too.")] = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers solve the captures.")
    ] = None,
) -> None:
    """Many captures, each into a folder of its own name; one that fails is named and the rest go on.

    What is said of lights, masks and pictures holds for all of them.
    """
    from .tables import print_table

    folders = name_folders(captures)
    files = {"lights": lights, "mask": mask, "chrome": chrome}
    paths = {name: path if str(path) == "whole" else path.resolve() for name, path in files.items() if path}
    options: dict[str, Any] = {**paths, "ball": ball, "crop": crop, "scale": scale, "encoding": encoding}
    wanted = {"model": model, **{name: str(value) for name, value in options.items() if value is not None}}
    _claim(output, folders, wanted, again=again)
    solve = partial(solve_capture, model=model, report=report, again=again, options=options)
    jobs = [(folder, (output / name).resolve()) for folder, name in folders.items()]
    rows = []
    for row in _on_cluster(scheduler, solve, jobs) if scheduler else (solve(*job) for job in jobs):
        rows.append(row)
        typer.echo(f"{row[0]}: {row[-1] if row[3] == 'failed' else row[3]}")
    rows.sort()
    print_table(COLUMNS, [(*row[:4], "" if row[3] == "failed" else row[4]) for row in rows])
    if any(row[3] == "failed" for row in rows):
        raise typer.Exit(1)


def _claim(output: Path, folders: dict[Path, str], options: dict[str, str], *, again: bool) -> None:
    """Write down whose results the folders of ``output`` hold, so that those of others are not taken for them.

    Raises:
        FileError: one of them holds the results of another capture or other options, or the list is damaged.
    """
    listed = output / LISTED
    known = read_json(listed) if listed.is_file() else {}
    for folder, name in folders.items():
        wanted = {"folder": str(folder), **options}
        if name in known and known[name] != wanted and not (again and known[name].get("folder") == str(folder)):
            mend = "use another -o, or --again for other options with the same captures"
            raise FileError(str(output), expected=f"no results but of {wanted}", got=f"{known[name]}", mend=mend)
        known[name] = wanted
    with atomic_path(listed) as temporary:
        temporary.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def solve_capture(
    folder: Path, place: Path, *, model: StereoModel, report: bool, again: bool, options: dict[str, Any]
) -> Row:
    """Solve one capture, with ``options`` of `stereo`, unless it has a result.

    Returns:
        Its row of the table; of a failure with the reason at its end.
    """
    from .stereo import stereo

    try:
        last = "report.html" if report else "result.json"  # what is written last
        if not _is_whole(place):
            (place / "result.json").unlink(missing_ok=True)
        if again or not all((place / name).is_file() for name in ("result.json", last)):
            stereo(folder, place, model, report=report, animation=False, **options)
        else:
            typer.echo(f"{place.name} has a result; --again solves it again")
        return _row(place)
    except (TorchOrenNayarError, MemoryError) as error:
        return _failed(place, error)


def _on_cluster(address: str, solve: Callable[..., Row], jobs: Iterable[tuple[Path, Path]]) -> Iterator[Row]:
    """Rows in the order in which workers finish; results are written by the workers, into a folder that all share.

    A capture whose worker dies is given to another one; one that its workers die of, `RETRIES` times, has failed.

    Raises:
        FileError: no scheduler answers.
    """
    from ..core.optional import require  # imports torch, which `orennayar --help` need not wait for

    require("distributed")
    from distributed import Client, as_completed

    try:
        client = Client(address, timeout=10)
    except (OSError, TimeoutError, ValueError) as error:
        raise FileError(
            "--scheduler", expected="the address of a Dask scheduler", got=f"{address}, {error}",
            mend="start one with `dask scheduler`, workers with `dask worker ADDRESS`, and give tcp://HOST:8786",
        ) from error  # fmt: skip
    with client:
        places = {
            client.submit(solve, *job, pure=False, retries=RETRIES, key=f"solve-{job[1]}"): job[1] for job in jobs
        }
        for future in as_completed(places):
            trouble = future.exception()
            yield future.result() if trouble is None else _failed(places[future], trouble)


def name_folders(captures: list[Path]) -> dict[Path, str]:
    """Every folder once, and the name of its results: as many of the last parts of its path as tell it from the others.

    Raises:
        FileError: a name that is neither folder nor list, or no folder at all.
    """
    found: list[Path] = []
    for entry in captures:
        if entry.is_dir() or entry.suffix.lower() == ".lp":
            found.append(entry)
        elif entry.is_file():
            try:
                lines = [line.strip() for line in entry.read_text(encoding="utf-8-sig").splitlines()]
            except UnicodeDecodeError as error:
                mend = "give folders of photographs, or text files that list them"
                raise FileError(
                    str(entry), expected="a folder or a list in UTF-8", got="other bytes", mend=mend
                ) from error
            found += [entry.parent / line for line in lines if line and not line.startswith("#")]
        else:
            raise FileError(
                str(entry), expected="a folder, or a file that lists folders", got="nothing", mend="check it"
            )
    if not found:
        raise FileError("captures", expected="at least one folder", got="an empty list", mend="name folders")
    possible = {}
    for folder in dict.fromkeys(f.resolve() for f in found):
        parts = folder.parts[1:] or ("root",)
        possible[folder] = ["--".join(parts[-count:]) for count in range(1, len(parts) + 1)]
    uses = Counter(name for names in possible.values() for name in names)
    return {folder: next(name for name in names if uses[name] == 1) for folder, names in possible.items()}


def _is_whole(place: Path) -> bool:
    """Whether the numbers of a result can be read."""
    try:
        return bool(read_json(place / "result.json"))
    except FileError:
        return False


def _row(place: Path) -> Row:
    numbers = read_json(place / "result.json")
    seconds = numbers["seconds"]
    took = "" if seconds is None else f"{seconds:.1f}"
    return place.name, str(numbers["images"]), numbers["model"], numbers["verdict"], took


def _failed(place: Path, error: BaseException) -> Row:
    return place.name, "", "", "failed", f"failed: {' '.join(str(error).split())}"
