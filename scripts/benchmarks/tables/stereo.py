"""Tables of photometric stereo, calibration, large captures and synthetic data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scripts.benchmarks.markdown import NOTHING, fixed, least_in_bold, mean_of, short, table
from scripts.benchmarks.record import Section, load_section, load_sections, sources

STEREO = "evaluate_stereo"
PUBLISHED = {
    "ball": {"ST14": 1.74, "neural 2018": 1.47, "CNN-PS": 2.2, "LINO": 1.74},
    "cat": {"ST14": 6.12, "neural 2018": 5.44, "CNN-PS": 4.6, "LINO": 3.38},
    "reading": {"ST14": 13.63, "neural 2018": 11.03, "CNN-PS": 12.6, "LINO": 6.67},
}
"""Mean angular errors in degrees quoted from publications: CNN-PS and LINO are trained on data, the others are not."""
OWN = ("least squares", "lambert", "vcavity", "network", "auto")
"""Methods of this package that tables show."""
OTHERS = {"trimmed": "trimmed least squares", "L1": "L1", "SBL": "sparse Bayesian", "RPCA": "robust PCA"}
"""Other people's methods, by the name in the results."""

Methods = Mapping[str, Mapping[str, Any]]


def _chosen(row: Mapping[str, Any]) -> str:
    """What `auto` chose, in words."""
    highlights = len(row["exponents"])
    parts = [row["model"]] if row["model"] != "lambert" else []
    parts += [f"roughness {row['roughness']:.0f}°"] if row["roughness"] else []
    falloff = row["falloff"]
    parts += [f"falloff {falloff:.2f}"] if isinstance(falloff, float) and falloff != 1 else []
    parts += [f"{highlights} highlight{'s' * (highlights != 1)}"] if highlights else []
    parts += ["interreflection"] if "interreflection-removed" in row["findings"] else []
    return ", ".join(parts) or "lambert"


def _photographs() -> tuple[dict[str, Section], dict[str, Methods]]:
    found = load_sections(STEREO, "photographs")
    return found, {name: section.results["methods"] for name, section in found.items()}


def photographs() -> str:
    """Error by object and method, beside published ones."""
    found, methods = _photographs()
    published = list(PUBLISHED["ball"])
    rows = []
    for name, section in found.items():
        errors = [methods[name][m]["mean"] for m in OWN]
        quoted = [fixed(PUBLISHED.get(name, {}).get(p), 2) for p in published]
        cells = least_in_bold(errors, [fixed(e, 2) for e in errors])
        rows.append([f"{name}, {section.results['pixels']:,} pixels", *cells, _chosen(methods[name]["auto"]), *quoted])
    means = [mean_of(methods, m, "mean") for m in OWN]
    quoted = [
        fixed(sum(PUBLISHED[n][p] for n in found) / len(found), 2) if set(found) <= set(PUBLISHED) else NOTHING
        for p in published
    ]
    rows.append(["mean", *least_in_bold(means, [fixed(m, 2) for m in means]), "", *quoted])
    rows.append(["seconds, mean", *(short(mean_of(methods, m, "seconds")) for m in OWN), "", *[""] * len(published)])
    header = ["mean angular error in degrees", *(f"`{m}`" if " " not in m else m for m in OWN), "`auto` chose"]
    return f"{sources(*found.values())}\n\n{table([*header, *published], rows)}"


def several_materials() -> str:
    """Error on renders of two to eight materials, by solver, of the half that nothing was set on."""
    section = load_section("evaluate_materials", "judging")
    methods = ("network", "one material", "auto")
    rows = []
    for name, row in section.results.items():
        errors = [row[m]["mean"] for m in methods]
        rows.append([name, *least_in_bold(errors, [fixed(e, 2) for e in errors]), f"{row['auto']['materials']:.0f}"])
    means = [mean_of(section.results, m, "mean") for m in methods]
    rows.append(["mean", *least_in_bold(means, [fixed(m, 2) for m in means]), ""])
    rows.append(["seconds, mean", *(short(mean_of(section.results, m, "seconds")) for m in methods), ""])
    header = ["mean angular error in degrees", "`network`", "one material", "`auto`", "materials found"]
    return f"{section.source}\n\n{table(header, rows)}"


def network_errors() -> str:
    """Error of the network by object, beside the solver that was not trained."""
    found, methods = _photographs()
    rows = [[f"`{m}`", *(fixed(methods[name][m]["mean"], 2) for name in found)] for m in ("network", "auto")]
    return f"{sources(*found.values())}\n\n{table(['mean angular error in degrees', *found], rows)}"


def other_methods() -> str:
    """Mean error and seconds of other people's methods on the same photographs."""
    found, methods = _photographs()
    names = [*OTHERS, *OWN]
    titles = [*OTHERS.values(), *OWN]
    rows = [
        ["mean error, degrees", *(fixed(mean_of(methods, m, "mean"), 2) for m in names)],
        ["seconds", *(short(mean_of(methods, m, "seconds")) for m in names)],
    ]
    return f"{sources(*found.values())}\n\n{table(['mean over objects', *titles], rows)}"


def summary() -> str:
    """Mean error and seconds on photographs, for the front page."""
    found, methods = _photographs()
    rows = [
        ["mean angular error, degrees", *(fixed(mean_of(methods, m, "mean"), 2) for m in OWN)],
        ["seconds per object", *(short(mean_of(methods, m, "seconds")) for m in OWN)],
    ]
    return table([f"DiLiGenT {', '.join(found)}", *OWN], rows)


def rendered() -> str:
    """Mean error on rendered captures, by kind of material."""
    section = load_section(STEREO, "rendered")
    groups: dict[str, dict[str, Methods]] = {"measured materials": {}, "rough V-cavities": {}}
    for name, row in section.results.items():
        groups["rough V-cavities" if "V-cavity" in name else "measured materials"][name] = row
    names = ["least squares", *OTHERS, *OWN[1:]]
    titles = ["least squares", *OTHERS.values(), *OWN[1:]]
    rows = []
    for title, cases in {**groups, "all": section.results}.items():
        means = [mean_of(cases, m, "mean") for m in names]
        rows.append([f"{title}, {len(cases)} captures", *least_in_bold(means, [fixed(m, 2) for m in means])])
    rows.append(["seconds, mean", *(short(mean_of(section.results, m, "seconds")) for m in names)])
    return f"{section.source}\n\n{table(['mean angular error in degrees', *titles], rows)}"


def _curves(curves: Mapping[str, Mapping[str, float]], head: str, decimals: int = 2) -> str:
    """Rows of curves over the union of their positions."""
    places = sorted({float(k) for curve in curves.values() for k in curve})
    rows = []
    for name, curve in curves.items():
        values = {float(k): v for k, v in curve.items()}
        rows.append([name, *(fixed(values.get(place), decimals) for place in places)])
    return table([head, *(f"{place:g}" for place in places)], rows)


def few_lights() -> str:
    """Error by the number of lights."""
    section = load_section(STEREO, "few lights")
    head = f"{section.results['object']}: mean error in degrees by number of lights"
    return f"{section.source}\n\n{_curves(section.results['curves'], head)}"


def wrong_calibration() -> str:
    """Error with wrong lights."""
    section = load_section(STEREO, "wrong calibration")
    head = f"{section.results['object']}: mean error in degrees of `lambert` with errors of"
    return f"{section.source}\n\n{_curves(section.results['curves'], head)}"


def unknown_lights() -> str:
    """Errors of lights and normals with lights known and found."""
    section = load_section("evaluate_unknown_lights", "photographs")
    rendered = load_section("evaluate_unknown_lights", "rendered")
    rows = []
    for name, row in {**section.results, **rendered.results}.items():
        cells = [fixed(row["known"]["normals"], 2)]
        for kind in ("equal", "unknown"):
            found = row[kind]
            cells += [f"{found['lights']:.2f} ({found['expected']:.1f})", fixed(found["normals"], 2)]
        spread, seconds = f"{row['unknown']['brightness']:.1%}", row["unknown"]
        rows.append([name, *cells, spread, short(row["known"]["seconds"]), short(seconds["seconds"])])
    header = [
        "degrees", "lights known: normals", "equally bright: lights (expected)", "normals",
        "brightness unknown: lights (expected)", "normals", "brightness off by", "seconds, known", "seconds, unknown",
    ]  # fmt: skip
    return f"{section.source}\n\n{table(header, rows)}"


def unknown_lights_few() -> str:
    """Errors of lights found from few photographs."""
    section = load_section("evaluate_unknown_lights", "few")
    head = f"{section.results['object']}: degrees by number of photographs, `lambert`"
    return f"{section.source}\n\n{_curves(section.results['rows'], head, 1)}"


def wrong_light_files() -> str:
    """What is left of errors of a light file after it was refined."""
    section = load_section("evaluate_unknown_lights", "wrong")
    rows = [
        [k, fixed(v["given"], 2), fixed(v["refined"], 2), str(v["replaced"])]
        for k, v in section.results["rows"].items()
    ]
    header = [f"{section.results['object']}, 96 lights", "given, degrees off", "refined, degrees off", "replaced"]
    return f"{section.source}\n\n{table(header, rows)}"


def edge_cases() -> str:
    """What is made of captures that do not determine a surface."""
    section = load_section("stereo_edge_cases", "cases")
    rows = [[name, *(_outcome(row[way]) for way in ("known", "unknown"))] for name, row in section.results.items()]
    return f"{section.source}\n\n{table(['degrees off, or what is said', 'lights known', 'lights unknown'], rows)}"


def _outcome(found: dict[str, Any]) -> str:
    if "refused" in found:
        return f"refused: {found['refused']}"
    doubts = "".join(f", `{code}`" for code in found["findings"])
    return fixed(found["normals"], 2) + doubts


def near_lights() -> str:
    """Error of near-light stereo with a wrong distance."""
    section = load_section(STEREO, "near lights")
    return f"{section.source}\n\n{_curves(section.results, 'mean error in degrees with an error of')}"


def light_positions() -> str:
    """Error under near lights by what is known of them."""
    section = load_section(STEREO, "light positions")
    columns = ("as distant", "distance found", "positions known", "distance found / true")
    rows = [[name, *(f"{row[column]:.2f}" for column in columns)] for name, row in section.results.items()]
    return f"{section.source}\n\n{table(['mean error in degrees of normals', *columns], rows)}"


def confidence() -> str:
    """Error by predicted error."""
    section = load_section(STEREO, "confidence")
    rows = [[name, *(f"{float(p):.1f} → {e:.1f}" for p, e in curve.items())] for name, curve in section.results.items()]
    header = ["degrees, predicted → measured (RMS)", *(f"group {k + 1}" for k in range(len(rows[0]) - 1))]
    return f"{section.source}\n\n{table(header, rows)}"


def two_roughnesses() -> str:
    """Error on objects of two roughnesses."""
    section = load_section(STEREO, "two roughnesses")
    rows = [[name, fixed(row["vcavity"], 2), fixed(row["auto"], 2)] for name, row in section.results.items()]
    header = [
        "mean error in degrees, roughness left and right",
        "one roughness (`vcavity`)",
        "map of roughness (`auto`)",
    ]
    return f"{section.source}\n\n{table(header, rows)}"


def interreflection() -> str:
    """Error on balls that illuminate each other."""
    section = load_section(STEREO, "light between parts")
    rows = [
        [name, fixed(row["lambert"], 2), fixed(row["auto"], 2), fixed(row["albedo found"], 2)]
        for name, row in section.results.items()
    ]
    header = ["mean error in degrees", "`lambert`", "`auto`", "albedo found by `auto`"]
    return f"{section.source}\n\n{table(header, rows)}"


def stereo_memory() -> str:
    """Peak memory of solving photographs."""
    section = load_section(STEREO, "memory")
    rows = [[name.removesuffix("PNG"), short(value, 3)] for name, value in section.results["MB"].items()]
    return f"{section.source}\n\n{table(['peak memory of a process that solves it by `auto`', 'MB'], rows)}"


def light_directions() -> str:
    """Angles between light directions found in three ways, and the errors of the grey ball."""
    section, balls = (load_section("evaluate_calibration", title) for title in ("directions", "grey ball"))
    rows = [[n, *(fixed(r[k], 1) for k in ("mean", "median", "most"))] for n, r in section.results.items()]
    angles = table(["light directions, angle in degrees", "mean", "median", "largest"], rows)
    rows = [[encoding, fixed(r["chrome ball"], 1), fixed(r["file"], 1)] for encoding, r in balls.results.items()]
    header = ["grey ball, mean error in degrees, images read as", "lights from the chrome ball", "lights from the file"]
    return f"{sources(section, balls)}\n\n{angles}\n\n{table(header, rows)}"


def light_intensities() -> str:
    """Error of light intensities that are found from a capture."""
    section = load_section("evaluate_calibration", "intensities")
    rows = [
        [name.removesuffix("PNG"), f"{row['error']:.1%}", f"{row['spread']:.0%}"]
        for name, row in section.results.items()
    ]
    header = ["light intensities", "mean error of those found", "standard deviation of the true ones"]
    return f"{section.source}\n\n{table(header, rows)}"


def large_captures() -> str:
    """Time and memory of large captures."""
    found = load_sections("large_capture", "capture")
    rows = [
        [f"`{r['model']}`", str(r["lights"]), short(r["megapixels"], 3), short(r["seconds"] / 60), short(r["GB"])]
        for r in (section.results for section in found.values())
    ]
    header = ["model", "photographs", "megapixels each", "minutes", "peak memory, GB"]
    return f"{sources(*found.values())}\n\n{table(header, rows)}"


def batch_cost() -> str:
    """What a capture costs in a batch, and what many cost on many machines."""
    costs, scale = load_section("batch_cost", "captures"), load_section("batch_cost", "scale")
    tasks = load_section("batch_cost", "scheduler").results["tasks per second"]
    measured = [[name, *(short(value, 3) for value in cost.values())] for name, cost in costs.results.items()]
    head = ["capture, `lambert`, no report, one thread", *next(iter(costs.results.values()))]
    found = scale.results
    keys = list(next(iter(found["rows"].values())))
    rows = [[name, *(short(row[key]) for key in keys)] for name, row in found["rows"].items()]
    sentence = (
        f"Calculated from this: {found['captures']:,} captures on {found['machines']} machines of {found['workers']} "
        f"workers each. A scheduler hands out {short(tasks, 2)} tasks a second here; where the share reaches 1, it is "
        "the limit, and so is a file system that reads or writes less."
    )
    return f"{costs.source}\n\n{table(head, measured)}\n\n{sentence}\n\n{table(['each like', *keys], rows)}"


def synthetic_speed() -> str:
    """Samples and observations per second."""
    section = load_section("measure_synthetic", "speed")
    rows = [
        [name, short(r["samples per second"]), short(r["million observations per second"])]
        for name, r in section.results["sources"].items()
    ]
    scene = section.results["scene"]
    header = ["`SyntheticCaptures`", "samples per second", "million observations per second"]
    sentence = f"One rendered scene under {scene['lights']} lights takes {short(scene['seconds'])} s."
    return f"{section.source}\n\n{table(header, rows)}\n\n{sentence}"


def synthetic_switches() -> str:
    """What each ingredient of pictures costs, and how long a training step waits."""
    section, waited = load_section("measure_synthetic", "switches"), load_section("measure_synthetic", "waiting")
    plain = section.results["plain"]
    rows = [[f"`{name}`", f"{cost:+.1f}"] for name, cost in section.results["more"].items()]
    sentence = f"Rough surfaces alone, 64 x 64 pixels and 4 lights, take {short(plain)} ms; each ingredient adds:"
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in waited.results["shares"].items())
    step = (
        f"A training step of {1e3 * waited.results['step']:.0f} ms on batches of 8, with {waited.results['workers']} "
        f"workers, waits for this share of its time: {shares}."
    )
    return f"{section.source}\n\n{sentence}\n\n{table(['ingredient', 'ms'], rows)}\n\n{step}"


def training_traffic() -> str:
    """What training sends between processes."""
    section = load_section("measure_synthetic", "training")
    found = section.results
    keys = list(next(iter(found["processes"].values())))
    rows = [[name, *(short(row[k], 3) for k in keys)] for name, row in found["processes"].items()]
    sentence = (
        f"The gradient has {short(found['gradient kB'], 3)} kB; a step of {found['groups']} x "
        f"{found['observations']:,} observations takes {short(found['seconds per step'])} s here. "
        "Traffic is calculated, not measured."
    )
    return f"{section.source}\n\n{table(['processes', *keys], rows)}\n\n{sentence}"
