"""The report's part on light: where it came from, what compression and maps cost, rough reflection by look-up."""

import html

from irodori.core import store
from irodori.evaluation.coefficient_storage import storage_sentence
from irodori.reflection.registry import lobe
from irodori.report.markup import details, number, table


def _gloss_tables(rows: list[dict]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return title, header and lines of a table for each lobe."""
    tables = []
    for name in dict.fromkeys(row["lobe"] for row in rows):
        kind = lobe(name)
        own = [row for row in rows if row["lobe"] == name]
        found = {(row["mu"], row["theta_r_deg"]): row for row in own}
        angles, roughnesses = (list(dict.fromkeys(row[key] for row in own)) for key in ("theta_r_deg", "mu"))
        lines = [
            [f"{mu:g}", *(f"{found[mu, angle]['rms']:.1%} ({found[mu, angle]['max']:.1%})" for angle in angles)]
            for mu in roughnesses
        ]
        unit = "" if kind.roughness.unit == "1" else f", {kind.roughness.unit}"
        tables.append((kind.title, [f"{kind.roughness.symbol}{unit}", *(f"θ_r {a:g}°" for a in angles)], lines))
    return tables


def light_section(names: list[str], files: list) -> str:
    """Return the part on environments.

    Parameters
    ----------
    names : list of str
    files : list of path
        Files of `irodori.light.stage`.
    """
    parts = ["<h2>Light</h2>"]
    for name, path in zip(names, files, strict=True):
        with store.open_file(path) as file:
            errors, origin = file.attribute("errors"), file.attribute("origin")
            stored = storage_sentence(file, "coefficients")
        parts.append(f"<h3>{html.escape(name)}</h3>")
        made = errors["compression"]
        lines = [
            [light, made["bases"], made["rank"], *(number(e[key]) for key in ("mean", "p95", "p99", "max"))]
            for light, e in made["delta_e"].items()
        ]
        parts.append(table(["CIEDE2000 of the compression", "bases", "rank", "mean", "p95", "p99", "max"], lines))
        missed = "" if made["budget_met"] else " The colour error stays above its target with all bases."
        said = f"Source: {origin.get('kind', 'not stated')}."
        if "assumption" in origin:
            said += f" Assumed: {origin['assumption']}."
        if "negative_pixels" in origin:
            said += f" {origin['negative_pixels']} pixels of the source had negative values, set to 0."
        irradiance = errors["irradiance"]
        parts.append(
            f"<p>{html.escape(said)}{missed} {stored} "
            f"Irradiance map of {irradiance['height']} rows, error between its normals up to "
            f"{irradiance['max_error']:.2%} of the largest irradiance.</p>"
        )
        if "gloss" in errors:
            for title, header, lines in _gloss_tables(errors["gloss"]):
                what = (
                    f"{title}: rough reflection by look-up against the sum of the true lobe over this light, n = 1.5: "
                    "rms error over the rms radiance (largest error over the largest radiance)"
                )
                parts.append(details(what, table(header, lines)))
    return "".join(parts)
