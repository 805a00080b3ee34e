from pathlib import Path

from snakemake.exceptions import WorkflowError
from snakemake.utils import min_version

min_version("9.0")


configfile: "config/config.yaml"


# There is one real rig: sessions that move it come one after the other. Limits of a workflow's own profile replace those
# of the profile that a user names, so that this one stands here.
workflow.register_resource("rig", 1)


include: "workflow/rules/common.smk"


wildcard_constraints:
    object="[a-z0-9-]+",
    camera="[a-z0-9-]+",
    environment="[a-z0-9-]+",
    scene="[a-z0-9-]+",
    view="[a-z0-9-]+",
    photograph="[a-z0-9-]+",
    capture="[a-z0-9-]+",
    tile="[0-9]+",
    stage="[a-z0-9-]+",


report: "workflow/report/workflow.rst"


include: "workflow/rules/capture.smk"
include: "workflow/rules/ingest.smk"
include: "workflow/rules/calibrate.smk"
include: "workflow/rules/rectify.smk"
include: "workflow/rules/fit.smk"
include: "workflow/rules/compress.smk"
include: "workflow/rules/environment.smk"
include: "workflow/rules/render.smk"
include: "workflow/rules/photograph.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/benchmark.smk"


localrules:
    all,
    benchmark,
    calibrate,
    capture,
    stability,


rule all:
    default_target: True
    input:
        scenes.pictures,
        sets.calibrations,
        "results/errors.csv",
        "results/report.html",


onsuccess:
    if config["make"]["scenes"]:
        print("Pictures, errors and times: results/report.html")
