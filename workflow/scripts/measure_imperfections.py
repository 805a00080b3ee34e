from irodori.config.models import Placing, Rectify
from irodori.config.parts import ImperfectObject
from irodori.core.run_rule import run_rule
from irodori.evaluation.imperfection_costs import Settings, SmallChain, measure_imperfections
from irodori.fitting.solvers import FitOptions
from irodori.ingest.ingest_options import IngestOptions
from irodori.material.principal_components.basis_count import CompressOptions

with run_rule(snakemake):
    settings = Settings(
        IngestOptions(**snakemake.params.ingest),
        Placing.of(snakemake.params.place),
        Rectify.of(snakemake.params.rectify),
        FitOptions(**snakemake.params.fit),
        CompressOptions(**snakemake.params.compress),
        snakemake.params.lights,
    )
    subject = ImperfectObject.of(snakemake.params.subject)
    measure_imperfections(SmallChain(**vars(subject), settings=settings), snakemake.output.costs)
