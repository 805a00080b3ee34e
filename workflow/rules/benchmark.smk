rule measure_speed:
    output:
        table="results/benchmark/stages/{stage}.csv",
    log:
        "results/logs/measure_speed/{stage}.log",
    # Not beside those of the other rules: the report adds them up as what the results took.
    benchmark:
        "results/benchmark/jobs/measure_speed/{stage}.tsv"
    conda:
        "../../envs/irodori.yaml"
    # Alone on the machine: what is timed beside something else is timed wrong. The number is asked for only when this
    # rule is wanted: a cluster and `snakemake --report` have none.
    threads: lambda wildcards: workflow.cores
    resources:
        mem_mb=lambda wildcards, attempt: 6000 * attempt,
    params:
        size=lookup(within=config, dpath="benchmark_size"),
        code=lambda wildcards: code_hash("benchmarks.table", f"benchmarks.{wildcards.stage}"),
    script:
        "../scripts/measure_speed.py"


rule compare_materials:
    output:
        table="results/benchmark/materials.csv",
    log:
        "results/logs/compare_materials/all.log",
    benchmark:
        "results/benchmark/jobs/compare_materials/all.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        code=code_hash("benchmarks.table", "benchmarks.materials"),
    script:
        "../scripts/compare_materials.py"


rule write_speed_report:
    input:
        tables=expand("results/benchmark/stages/{stage}.csv", stage=BENCHMARKS),
        materials="results/benchmark/materials.csv",
    output:
        table="results/benchmark/speed_error.csv",
        page=report(
            "results/benchmark/speed_error.html",
            caption="../report/speed.rst",
            category="Speed against error",
        ),
    log:
        "results/logs/write_speed_report/all.log",
    benchmark:
        "results/benchmark/jobs/write_speed_report/all.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
    params:
        size=lookup(within=config, dpath="benchmark_size"),
        code=code_hash("benchmarks.speed_page"),
    script:
        "../scripts/write_speed_report.py"


rule benchmark:
    input:
        "results/benchmark/speed_error.html",


rule check_stability:
    input:
        user_files=ancient(tests_of_stability),
    output:
        table="results/benchmark/stability.csv",
        page=report(
            "results/benchmark/stability.html",
            caption="../report/stability.rst",
            category="Stability",
        ),
    log:
        "results/logs/check_stability/all.log",
    benchmark:
        "results/benchmark/jobs/check_stability/all.tsv"
    conda:
        "../../envs/irodori.yaml"
    # Some of its tests have deadlines for simulated devices: it runs alone.
    threads: lambda wildcards: workflow.cores
    resources:
        mem_mb=lambda wildcards, attempt: 6000 * attempt,
    params:
        user_files=ledger.content(tests_of_stability),
        code=lambda wildcards: code_hash("benchmarks.stability", *modules_of("irodori")),
    script:
        "../scripts/check_stability.py"


rule stability:
    input:
        "results/benchmark/stability.html",
