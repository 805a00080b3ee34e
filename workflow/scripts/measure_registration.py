from irodori.core.run_rule import run_rule
from irodori.evaluation.registration_errors import measure_registration

with run_rule(snakemake):
    measure_registration(snakemake.input.linear, snakemake.output.registration)
