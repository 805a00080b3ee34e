from irodori.report.registration import measure_registration
from irodori.rules import run_rule

with run_rule(snakemake):
    measure_registration(snakemake.input.linear, snakemake.output.registration)
