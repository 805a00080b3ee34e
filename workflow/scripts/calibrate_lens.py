from irodori.config.models import Optics
from irodori.core.run_rule import run_rule
from irodori.lens.stage import calibrate_lens

with run_rule(snakemake):
    calibrate_lens(
        snakemake.params.table,
        snakemake.params.folder,
        Optics.of(snakemake.params.optics),
        snakemake.output.lens,
    )
