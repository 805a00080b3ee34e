rule calibrate:
    input:
        sets.calibrations,
        sets.lenses,


rule calibrate_camera:
    input:
        linear=sets.charts,
        user_files=ancient(sets.tables_of_calibration),
    output:
        calibration="results/cameras/{camera}/calibration.h5",
        errors=report(
            "results/cameras/{camera}/calibration_errors.csv",
            caption="../report/calibration_errors.rst",
            category="Calibration",
            labels={"camera": "{camera}"},
        ),
        selection=report(
            "results/cameras/{camera}/calibration_selection.csv",
            caption="../report/calibration_selection.rst",
            category="Calibration",
            labels={"camera": "{camera}"},
        ),
    log:
        "results/logs/calibrate_camera/{camera}.log",
    benchmark:
        "results/benchmarks/calibrate_camera/{camera}.tsv"
    # What every object waits for, and the longest jobs behind it, come first: no core is idle at the end.
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
    params:
        chart=lookup(within=config["cameras"], dpath="{camera}/chart"),
        further_charts=lookup(within=config["cameras"], dpath="{camera}/further_charts"),
        calibration=lookup(within=config["cameras"], dpath="{camera}/calibration"),
        comb_filter=lookup(within=config["cameras"], dpath="{camera}/comb_filter", default=None),
        sensitivities=lookup(within=config["cameras"], dpath="{camera}/sensitivities", default=None),
        light=sets.light,
        light_error_percent=sets.light_error_percent,
        lights=lookup(within=config["report"], dpath="lights"),
        user_files=ledger.content(sets.tables_of_calibration),
        code=code_hash("irodori.calibration.stage"),
    script:
        "../scripts/calibrate_camera.py"


rule calibrate_lens:
    input:
        user_files=ancient(sets.sheet),
    output:
        lens="results/cameras/{camera}/lens.yaml",
    log:
        "results/logs/calibrate_lens/{camera}.log",
    benchmark:
        "results/benchmarks/calibrate_lens/{camera}.tsv"
    # The objects of the camera wait for it.
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        table=sets.table,
        folder=sets.folder,
        optics=sets.optics,
        user_files=ledger.content(sets.sheet),
        code=code_hash("irodori.lens.stage"),
    script:
        "../scripts/calibrate_lens.py"
