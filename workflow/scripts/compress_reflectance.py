from dataclasses import replace

from irodori.config.parts import Surface
from irodori.core.made_of import made_of
from irodori.core.run_rule import run_rule
from irodori.material.lobe_choices import read_choice
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.material.stage import compress_reflectance

with run_rule(snakemake) as provenance:
    definition = snakemake.params.definition
    compress_reflectance(
        snakemake.input.tiles,
        snakemake.input.calibration,
        Surface.of({key: definition[key] for key in ("texels", "refractive_index", "mirror_weight", "sheet")}),
        snakemake.output.material,
        options=CompressOptions(**snakemake.params.compress),
        lights=snakemake.params.lights,
        lobe_choice=read_choice(snakemake.input.lobes),
        observations=snakemake.input.observations,
        levels=snakemake.input.levels,
        provenance=replace(provenance, made_of=made_of(definition, snakemake.input.user_files)),
    )
