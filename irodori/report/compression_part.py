"""Compression section of the report: bases, colour errors, negative spectra, repeated reflection."""

import html

from irodori.report.markup import details, number, table


def compression_section(name: str, errors: dict, stored: str) -> str:
    """Return the part on one compressed picture.

    Parameters
    ----------
    name : str
    errors : dict
        As `irodori.material.stage.compress_maps` leaves it in a material's file.
    stored : str
        What `irodori.evaluation.coefficient_storage.storage_sentence` says of the file.
    """
    parts = [f"<h4>{html.escape(name)}: compression</h4>"]
    lines = [
        [weighting + (" (in use)" if weighting == errors["weighting"] else ""), made["bases"], light,
         *(number(error[key]) for key in ("mean", "p95", "p99", "max")), number(made["rmse"])]
        for weighting, made in errors["weightings"].items()
        for light, error in made["delta_e"].items()
    ]  # fmt: skip
    parts.append(table(["weighting", "bases", "light", "mean", "p95", "p99", "max", "spectral RMSE"], lines))
    negative = errors["negative"]
    missed = "" if errors["budget_met"] else " The colour error stays above its target with all bases in this storage."
    parts.append(
        f"<p>CIEDE2000 over {negative['pixels']} pixels, {html.escape(errors['storage'])} precision included; "
        f"{errors['masked_pixels']} of {errors['pixels']} pixels masked; rank {errors['rank']}.{missed} "
        f"{negative['fraction']:.3%} of the samples, in {negative['pixel_fraction']:.2%} of the pixels, are negative: "
        f"the lowest by {negative['depth_max']:.2%} of the pixel's largest (99th percentile "
        f"{negative['depth_p99']:.2%}). "
        f"Setting them to zero would add {negative['clipping_bias']:.4%} of light; rendering adds none. {stored}</p>"
    )
    lines = [
        [str(row["reflections"]), light, *(number(row["delta_e"][light][key]) for key in ("mean", "p99")),
         number(row["rmse"]), *(number(row["projected_delta_e"][light][key]) for key in ("mean", "p99")),
         number(row["projected_rmse"])]
        for row in errors["drift"]
        for light in row["delta_e"]
    ]  # fmt: skip
    header = ["reflections", "light", "mean", "p99", "RMSE", "mean, on the basis", "p99, on the basis",
              "RMSE, on the basis"]  # fmt: skip
    what = "after repeated reflection within the object: products of decoded spectra, and brought back to the basis"
    parts.append(details(what, table(header, lines)))
    return "".join(parts)
