"""The report as one HTML page that needs nothing beside it."""

import csv
import html
import json
from pathlib import Path

from irodori.core import store
from irodori.evaluation.coefficient_storage import storage_sentence
from irodori.evaluation.error_budget import BudgetRow, read_budget
from irodori.evaluation.imperfection_costs import CostRow, read_costs
from irodori.evaluation.pose_planning import PlanRow, read_plan
from irodori.evaluation.registration_errors import read_registration, summarise
from irodori.evaluation.truth_errors import read_errors
from irodori.material.material_file import Material
from irodori.reflection.registry import lobe
from irodori.report.calibration_part import calibration_section
from irodori.report.compression_part import compression_section
from irodori.report.figures import material_figure, planning_figure, spectra_figure
from irodori.report.light_part import light_section
from irodori.report.markup import data_uri, figure, number, table, write_page

#: What the report says of a camera: attribute of its reference file, and what it is.
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


def _errors_section(rows: list[dict]) -> str:
    parts = ["<h2>Errors</h2>"]
    if not rows:
        return parts[0] + "<p>No ground truth is known for this configuration.</p>"
    for subject in dict.fromkeys(row["subject"] for row in rows):
        lines = [
            [r["quantity"], r["light"], r["count"], *(number(r[k]) for k in ("mean", "p95", "p99", "max"))]
            for r in rows
            if r["subject"] == subject
        ]
        parts.append(f"<h3>{html.escape(subject)}</h3>")
        parts.append(table(["quantity", "light", "count", "mean", "p95", "p99", "max"], lines))
    return "".join(parts)


def _views_section(views: list[str], pictures: list, figures: list, truths: dict) -> str:
    parts = ["<h2>Pictures</h2>"]
    for name, picture, numbers in zip(views, pictures, figures, strict=True):
        measured = json.loads(Path(numbers).read_text(encoding="utf-8"))
        parts.append(figure(data_uri(picture), f"{name}, from the measured materials", 560))
        if name in truths:
            parts.append(figure(data_uri(truths[name]), f"{name}, from the true materials", 560))
        rows = [
            ["integrator", measured["integrator"]],
            ["seconds", f"{measured['seconds']:.2f}"],
            ["pixels per second", f"{measured['pixels_per_second']:.0f}"],
            *_integrator_rows(measured),
            *_plan_rows(measured.get("plan")),
            ["display", measured["display"]],
            ["pixels outside the display's gamut", f"{measured['out_of_gamut_fraction']:.2%}"],
            ["of them under 0 in a channel", f"{measured['out_of_gamut_below_fraction']:.2%}"],
            ["of them over 1 in a channel", f"{measured['out_of_gamut_above_fraction']:.2%}"],
        ]
        rows += [
            [f"{name}: texels that no capture determined, filled from their neighbours", f"{share:.1%}"]
            for name, share in measured["filled_fraction"].items()
        ]
        parts.append(table(["rendering", ""], rows))
    return "".join(parts)


def _plan_rows(plan: dict | None) -> list[list[str]]:
    """Return what a plan predicted and what the check of its picture found."""
    if plan is None:
        return []
    rows = [
        [
            "tolerance of the plan, and its prediction",
            f"{plan['tolerance_ciede2000']:g}, {plan['predicted_delta_e']:.3g}",
        ]
    ]
    if "measured_delta_e" in plan:
        found = plan["measured_delta_e"]
        values = ", ".join(f"{found[key]:.3g}" for key in ("mean", "p95", "p99", "max"))
        rows.append([f"ΔE2000 to the full model at {found['count']} pixels: mean, p95, p99, max", values])
    return rows


def _photographs_section(names: list[str], pictures: list, figures: list) -> str:
    if not names:
        return ""
    parts = [
        "<h2>Beside the real thing</h2><p>Photographs that no material was fitted to, against the same view rendered "
        "with all its reflections. Noise alone: the difference that the noise of photograph and rendering makes of two "
        "equal pictures.</p>"
    ]
    for name, picture, numbers in zip(names, pictures, figures, strict=True):
        found = json.loads(Path(numbers).read_text(encoding="utf-8"))
        parts.append(figure(data_uri(picture), name))
        lines = [
            [label, *(number(found[key][of]) for of in ("mean", "p95", "p99", "max"))]
            for label, key in (
                ("CIEDE2000", "delta_e"),
                ("CIEDE2000, objects only", "delta_e_objects"),
                ("noise alone", "noise_floor"),
                ("noise alone, objects only", "noise_floor_objects"),
            )
        ]
        parts.append(table(["difference", "mean", "p95", "p99", "max"], lines))
        parts.append(
            f"<p>{found['compared_fraction']:.1%} of the pixels are compared; factor on the photograph "
            f"{found['scale']:.4g}; its luminance over the rendering's, median of the pixels, "
            f"{found['luminance_ratio']:.4g}; {found['samples']} paths a pixel. "
            f"In the noise: {', '.join(found['noise_counts'])}.</p>"
        )
    return "".join(parts)


def _integrator_rows(measured: dict) -> list[list[str]]:
    """Return what only one of the integrators measures."""
    if measured["integrator"] != "reference":
        return [["rays per second", f"{measured['rays_per_second']:.3g}"]]
    error = measured["relative_standard_error"]
    return [
        ["paths per pixel", f"{measured['samples']}"],
        ["paths per second", f"{measured['paths_per_second']:.3g}"],
        ["relative standard error of a pixel, mean and p95", f"{error['mean']:.2%}, {error['p95']:.2%}"],
        ["paths that were cut", f"{measured['paths_cut']}"],
    ]


def typical_gloss_text(material: Material) -> str:
    """Return β and μ of the object's typical gloss with the unit and the title of the lobe, of every component."""
    parts = []
    for component, name in enumerate(material.lobes):
        kind = lobe(name)
        beta, mu = material.typical_gloss[2 * component : 2 * component + 2]
        unit = "" if kind.roughness.unit == "1" else f" {kind.roughness.unit}"
        parts.append(f"β = {beta:.3g}, {kind.roughness.symbol} = {mu:.3g}{unit} ({kind.title})")
    return "; ".join(parts)


def _objects_section(objects: list[str], materials: list, truths: dict) -> str:
    parts = ["<h2>Objects</h2>"]
    for name, path in zip(objects, materials, strict=True):
        material = Material.load(path)
        truth = Material.load(truths[name]) if name in truths else None
        with store.open_file(path) as file:
            maps = {n: file.read(n) for n in ("status", "residual_rms", "reflectance_error", "training_distance")}
            errors = file.attribute("errors")
            stored = storage_sentence(file, "reflectance/coefficients")
        gloss = typical_gloss_text(material)
        parts.append(f"<h3>{html.escape(name)}</h3>")
        parts.append(figure(material_figure(material, maps, truth), f"{name}: maps over the texture"))
        if truth is not None:
            parts.append(figure(spectra_figure(material, truth), f"{name}: spectra"))
        speed = errors["texels_fitted"] / max(errors["fit_seconds"], 1e-9)
        parts.append(
            f"<p>{errors['texels_fitted']} texels fitted, {speed:.0f} a second; "
            f"{errors['observed_fraction']:.1%} of texels observed; {material.basis.shape[1]} bases, "
            f"{errors['negative_fraction']:.3%} of spectral samples negative; typical gloss {gloss}. "
            f"Standard deviation of the recovered reflectance, by the camera's noise and "
            "by what cross-validation found: median "
            f"{errors['reflectance_error_median']:.2g}; {errors['out_of_training_fraction']:.1%} of texels have a "
            "colour that the chart has none like.</p>"
        )
        parts.append(compression_section(name, errors["compression"], stored))
    return "".join(parts)


def _time_section(folder) -> str:
    """Return time and peak memory by rule from the benchmark files of the jobs that ran."""
    totals: dict[str, list[float]] = {}
    for path in sorted(Path(folder).glob("*/*.tsv")):
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream, delimiter="\t"):
                entry = totals.setdefault(path.parent.name, [0, 0.0, 0.0])
                memory = float(row["max_rss"]) if row["max_rss"] not in ("-", "NA") else 0.0
                entry[0], entry[1], entry[2] = entry[0] + 1, entry[1] + float(row["s"]), max(entry[2], memory)
    rows = [
        [rule, f"{n}", f"{s:.1f}", f"{m:.0f}"] for rule, (n, s, m) in sorted(totals.items(), key=lambda t: -t[1][1])
    ]
    heading = "<h2>Time and memory</h2><p>Of the jobs that made these results, with the start of each process.</p>"
    return heading + table(["rule", "jobs", "seconds", "peak MB"], rows)


def _planning_section(rows: list[PlanRow]) -> str:
    if not rows:
        return ""
    parts = [
        "<h2>Poses</h2><p>Simulated photographs of random materials, fitted: poses that the planner chose, and others "
        "of the same number. Errors are those of the fits that state the parameter; their share stands beside them.</p>"
    ]
    header = ["poses", "design", "parameter", "median", "p95", "fits that state it", "expected standard error"]
    for name in dict.fromkeys(row.object for row in rows):
        own = [row for row in rows if row.object == name]
        lines = [
            [r.poses, r.design, r.parameter, *(number(v) for v in (r.median, r.p95)), f"{r.identified_fraction:.1%}",
             number(r.expected_standard_error)]
            for r in own
        ]  # fmt: skip
        parts.append(f"<h3>{html.escape(name)}</h3>")
        parts.append(figure(planning_figure(own), f"{name}: fit error against the number of poses"))
        parts.append(f"<details><summary>as a table</summary>{table(header, lines)}</details>")
    return "".join(parts)


def _imperfections_section(rows: list[CostRow]) -> str:
    if not rows:
        return ""
    base = {row.light: row.mean for row in rows if row.faults == "none"}
    lines = [
        [r.faults, r.light, *(number(v) for v in (r.mean, r.p95, r.max)), f"{r.mean - base[r.light]:+.3f}",
         number(r.beta), number(r.mu), f"{r.known:.1%}"]
        for r in rows
    ]  # fmt: skip
    header = ["faults of the rig", "light", "mean", "p95", "max", "cost of the mean", "β", "μ", "gloss known"]
    return (
        "<h2>What the rig's imperfections cost</h2><p>The chain in small, at half the camera's resolution and in some "
        "of the poses: CIEDE2000 of the recovered reflectance away from seams, and medians of the relative errors of "
        "β and μ.</p>" + table(header, lines)
    )


def _budget_section(budgets: dict[str, list[BudgetRow]]) -> str:
    if not budgets:
        return ""
    parts = [
        "<h2>Error budget</h2><p>CIEDE2000 of the pixels that show an object, in a small picture, when one stage's "
        "part is as it was measured and everything else is true; predicted is the mean that the stages' own errors "
        "lead to.</p>"
    ]
    header = ["stage", "mean", "p95", "p99", "max", "predicted mean", "predicted by"]
    for name, rows in budgets.items():
        lines = [[r.stage, *(number(v) for v in (r.mean, r.p95, r.p99, r.max, r.predicted)), r.by] for r in rows]
        parts.append(f"<h3>{html.escape(name)}</h3>{table(header, lines)}")
    return "".join(parts)


def _cameras_section(cameras: list[str], references: list) -> str:
    rows = []
    for name, path in zip(cameras, references, strict=True):
        with store.open_file(path) as file:
            known = {key: file.attribute(key) for key in _CAMERA_FIGURES if file.has_attribute(key)}
        rows += [[name, what, _figure_text(known[key])] for key, what in _CAMERA_FIGURES.items() if key in known]
    return "<h2>Cameras</h2>" + table(["camera", "quantity", "measured"], rows)


def _registration_section(objects: list[str], tables: list) -> str:
    lines = []
    for name, path in zip(objects, tables, strict=True):
        found = summarise(read_registration(path))
        residuals = [number(found.median_px), number(found.max_px), found.worst or "–"]
        lines.append([name, found.by_capture, found.by_chart, found.by_none, *residuals])
    header = ["object", "captures by their own transform", "by the chart's", "as they are", "median residual",
              "largest residual", "its capture"]  # fmt: skip
    return (
        "<h2>Registration of the filter states</h2><p>Residuals in superpixels, of the captures with a transform of "
        "their own; one with too little content takes the chart's.</p>" + table(header, lines)
    )


def _figure_text(value) -> str:
    return ", ".join(f"{v:.4g}" for v in (value if isinstance(value, list) else [value]))


def write_report(inputs: dict, names: dict, benchmarks, output) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    inputs : dict
        Files: errors, planning, imperfections; lists of budgets, references, registrations, materials, true_materials,
        environments, calibration_errors, pictures, figures, true_pictures,
        comparisons, comparison_figures.
    names : dict
        objects, virtual_objects, environments, cameras, views, virtual_views, photographs, in the order of the files.
    benchmarks : path
        Folder of the benchmark files of the run.
    output : path
    """
    true_views = dict(zip(names["virtual_views"], inputs["true_pictures"], strict=True))
    true_objects = dict(zip(names["virtual_objects"], inputs["true_materials"], strict=True))
    budgets = {n: read_budget(path) for n, path in zip(names["virtual_views"], inputs["budgets"], strict=True)}
    body = [
        "<h1>Irodori</h1>",
        _views_section(names["views"], inputs["pictures"], inputs["figures"], true_views),
        _photographs_section(names["photographs"], inputs["comparisons"], inputs["comparison_figures"]),
        _errors_section(read_errors(inputs["errors"])),
        _budget_section(budgets),
        _objects_section(names["objects"], inputs["materials"], true_objects),
        light_section(names["environments"], inputs["environments"]),
        _imperfections_section(read_costs(inputs["imperfections"])),
        _planning_section(read_plan(inputs["planning"])),
        _registration_section(names["objects"], inputs["registrations"]),
        _cameras_section(names["cameras"], inputs["references"]),
        calibration_section(
            names["cameras"], inputs["calibrations"], inputs["calibration_errors"], inputs["selections"]
        ),
        _time_section(benchmarks),
    ]
    write_page(output, "Irodori report", "".join(body))
