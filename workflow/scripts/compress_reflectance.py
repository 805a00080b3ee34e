from irodori.compression import compress_reflectance
from irodori.principal import CompressOptions
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    compress_reflectance(
        snakemake.input.tiles,
        snakemake.input.calibration,
        {key: snakemake.params[key] for key in ("texels", "refractive_index", "mirror_weight")},
        snakemake.output.material,
        CompressOptions(**snakemake.params.compress),
        snakemake.params.lights,
        provenance,
    )
