"""The report as one self-contained HTML page."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path

from irodori.core import store
from irodori.evaluation.registration_errors import summarise
from irodori.evaluation.result_tables import BudgetRow, ErrorRow, RegistrationRow, read_rows
from irodori.lens.lens_file import LensFile
from irodori.material.angle_errors import AngleErrors
from irodori.material.material_file import Material
from irodori.reflection.registry import lobe
from irodori.report.calibration_part import camera_calibrations
from irodori.report.figures import material_figure, spectra_figure
from irodori.report.html_page import data_uri, write_page
from irodori.report.sittings import sittings
from irodori.spectra.grid import SAMPLES

#: Lines of the report about a camera: attribute of its reference file, and its meaning.
_CAMERA_FIGURES = {
    "gain_e_per_dn": "gain by photon transfer, electrons per digital number",
    "gain_error": "its standard error",
    "read_noise_dn": "read noise, digital numbers",
    "hot_pixels": "hot pixels of the mosaic",
    "max_nonlinearity": "largest deviation from linearity over the exposure series, ratio",
    "linearity_repeatability": "repeatability of equal exposures, ratio",
    "registration_residual_px": "residual of registering the chart's two filter states, superpixels",
    "registration_sigma_px": "standard error of that registration, superpixels",
}


def rendered_views(names: list[str], pictures: list, figures: list, truths: dict) -> list[dict]:
    """Return the data of ``views.html.j2``: name, picture, figures and, if known, true picture of each view."""
    return [view | {"truth": data_uri(truths[view["name"]]) if view["name"] in truths else None}
            for view in _pictures(names, pictures, figures)]  # fmt: skip


def _pictures(names: list[str], pictures: list, figures: list) -> list[dict]:
    return [
        {"name": name, "picture": data_uri(picture), "figures": json.loads(Path(numbers).read_text(encoding="utf-8"))}
        for name, picture, numbers in zip(names, pictures, figures, strict=True)
    ]


def typical_gloss_text(material: Material) -> str:
    """Return a line of text with β, μ, unit and lobe of every component of the object's typical gloss."""
    parts = []
    for component, name in enumerate(material.lobes):
        kind = lobe(name)
        beta, mu = material.typical_gloss[2 * component : 2 * component + 2]
        unit = "" if kind.roughness.unit == "1" else f" {kind.roughness.unit}"
        parts.append(f"β = {beta:.3g}, {kind.roughness.symbol} = {mu:.3g}{unit} ({kind.title})")
    return "; ".join(parts)


def _storage(file: store.Reader, name: str) -> str:
    """Return a sentence with the size on disk of a dataset of coefficients."""
    dataset = file.dataset(name)
    packed, spectra = dataset.id.get_storage_size(), dataset.size // dataset.shape[-1] * SAMPLES * 4
    return (
        f"Coefficients: {packed / 1e6:.3g} MB on disk, {spectra / packed:.0f} times less than {SAMPLES} bands of "
        "32-bit floats."
    )


def _object(name: str, path, truth_file, placement) -> dict:
    material = Material.load(path)
    truth = Material.load(truth_file) if truth_file else None
    with store.open_file(path) as file:
        maps = {n: file.read(n) for n in ("status", "residual_rms", "reflectance_error", "delta_e_error")}
        errors, stored = file.attribute("errors"), _storage(file, "reflectance/coefficients")
    return {
        "name": name,
        "maps": material_figure(material, maps, truth),
        "spectra": spectra_figure(material, truth) if truth else None,
        "bases": material.basis.shape[1],
        "gloss": typical_gloss_text(material),
        "lobes": list(material.lobes),
        "coat": material.coat,
        "mirror": material.mirror,
        "angles": str(AngleErrors(**errors["angle_errors"])) if errors.get("angle_errors") else "",
        "errors": errors,
        "stored": stored,
        "placement": placement,
    }


def objects(names: list[str], files: list, truths: dict, placements: Sequence = ()) -> list[dict]:
    """Return the data of ``objects.html.j2``.

    Parameters
    ----------
    names : list of str
    files : list of path
        Their material files.
    truths : dict
        {name: file of the true material}, as far as there are such.
    placements : sequence of path
        Files of the objects' registrations, in the same order, those of one object's placements side by side; empty if
        objects are not registered.
    """
    said: dict[str, list[str]] = {}
    for path in placements:
        said.setdefault(Path(path).parent.name, []).append(_sentence(path))
    placed = ["; ".join(one) for one in said.values()] or [""] * len(names)
    return [_object(name, path, truths.get(name), at) for name, path, at in zip(names, files, placed, strict=True)]


def _sentence(path) -> str:
    """Return what a registration found, in words."""
    with store.open_file(path) as file:
        return file.attribute("sentence")


def environments(names: list[str], files: list) -> list[dict]:
    """Return the data of ``light.html.j2`` from environment files that `irodori.light.stage` wrote."""
    found = []
    for name, path in zip(names, files, strict=True):
        with store.open_file(path) as file:
            own = {key: file.attribute(key) for key in ("errors", "origin")}
            found.append(own | {"name": name, "stored": _storage(file, "coefficients")})
    return found


def _rules(folder, jobs: list[str]) -> list[tuple[str, int, float, float]]:
    """Return rule, number of jobs, total seconds and peak MB from Snakemake's benchmark files, the longest first.

    Only files count whose name up to the first ``_`` is one of `jobs`; the rest of the name is a tile, view or capture.
    """
    totals: dict[str, tuple[int, float, float]] = {}
    wanted = set(jobs)
    for path in sorted(path for path in Path(folder).glob("*/*.tsv") if path.stem.partition("_")[0] in wanted):
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream, delimiter="\t"):
                count, seconds, peak = totals.get(path.parent.name, (0, 0.0, 0.0))
                memory = float(row["max_rss"]) if row["max_rss"] not in ("-", "NA") else 0.0
                totals[path.parent.name] = count + 1, seconds + float(row["s"]), max(peak, memory)
    return [(rule, *total) for rule, total in sorted(totals.items(), key=lambda item: -item[1][1])]


def registrations(objects: list[str], tables: list) -> dict:
    """Return the data of ``registration.html.j2``: the summary of each object's table of registrations."""
    return {name: summarise(read_rows(path, RegistrationRow)) for name, path in zip(objects, tables, strict=True)}


def _camera(path) -> dict:
    with store.open_file(path) as file:
        return {what: file.attribute(key) for key, what in _CAMERA_FIGURES.items() if file.has_attribute(key)}


def write_report(inputs: dict, names: dict, benchmarks, output) -> None:
    """Write ``report.html`` of one scene, or of one camera.

    Parameters
    ----------
    inputs : dict
        Files by kind. One file: errors; lists: budgets, lenses, references, registrations, placements, materials,
        true_materials, environments, sessions, calibrations, calibration_errors, selections, pictures, figures,
        true_pictures, comparisons, comparison_figures; and pages, the classroom page in the folder of the report, if
        there is one.
    names : dict
        Names in the order of the files: objects, virtual_objects, environments, cameras, lens_cameras, views,
        virtual_views, photographs; title, of the report; and jobs, the beginnings of the names of the jobs whose time
        the report states.
    benchmarks : path
        Folder of the benchmark files of all runs.
    output : path
    """
    true_views = dict(zip(names["virtual_views"], inputs["true_pictures"], strict=True))
    truths = dict(zip(names["virtual_objects"], inputs["true_materials"], strict=True))
    write_page(
        output,
        "report.html.j2",
        views=rendered_views(names["views"], inputs["pictures"], inputs["figures"], true_views),
        title=names["title"],
        pages=[Path(page).name for page in inputs["pages"]],
        photographs=_pictures(names["photographs"], inputs["comparisons"], inputs["comparison_figures"]),
        errors=read_rows(inputs["errors"], ErrorRow),
        budgets={
            n: read_rows(path, BudgetRow) for n, path in zip(names["virtual_views"], inputs["budgets"], strict=True)
        },
        objects=objects(names["objects"], inputs["materials"], truths, inputs["placements"]),
        environments=environments(names["environments"], inputs["environments"]),
        sittings=sittings(inputs["sessions"]),
        registrations=registrations(names["objects"], inputs["registrations"]),
        lenses={
            name: LensFile.load(path).remarks
            for name, path in zip(names["lens_cameras"], inputs["lenses"], strict=True)
        },
        cameras={n: _camera(path) for n, path in zip(names["cameras"], inputs["references"], strict=True)},
        calibrations=camera_calibrations(
            names["cameras"], inputs["calibrations"], inputs["calibration_errors"], inputs["selections"]
        ),
        rules=_rules(benchmarks, names["jobs"]),
    )
