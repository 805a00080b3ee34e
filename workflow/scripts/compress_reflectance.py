from irodori.compression import compress_reflectance
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    compress_reflectance(
        snakemake.input.tiles,
        snakemake.input.calibration,
        {key: snakemake.params[key] for key in ("texels", "refractive_index", "mirror_weight")},
        snakemake.output.material,
        snakemake.params.compress["target_delta_e_mean"],
        snakemake.params.compress["align"],
        snakemake.params.lights,
        provenance,
    )
