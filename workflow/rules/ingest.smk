rule check_captures:
    input:
        made=sets.made,
        user_files=ancient(sets.own_photographs),
    output:
        table="results/{object}/captures.csv",
    log:
        "results/logs/check_captures/{object}.log",
    benchmark:
        "results/benchmarks/check_captures/{object}.tsv"
    # A broken file is found before any long work starts.
    priority: 100
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        table=sets.table,
        folder=sets.folder,
        roles=sets.roles,
        size_px=sets.size_px,
        lens_mm=sets.lens_mm,
        user_files=ledger.content(sets.own_photographs),
        altered=ledger.altered(sets.photographs_of_session),
        code=code_hash("irodori.ingest.first_look"),
    script:
        "../scripts/check_captures.py"


use rule check_captures as check_camera_captures with:
    output:
        table="results/cameras/{camera}/captures.csv",
    log:
        "results/logs/check_captures/cameras-{camera}.log",
    benchmark:
        "results/benchmarks/check_captures/cameras-{camera}.tsv"


use rule check_captures as check_environment_captures with:
    output:
        table="results/environments/{environment}/captures.csv",
    log:
        "results/logs/check_captures/environments-{environment}.log",
    benchmark:
        "results/benchmarks/check_captures/environments-{environment}.tsv"


rule ingest_reference:
    input:
        table="results/cameras/{camera}/captures.csv",
        user_files=ancient(sets.tables_of_white),
    output:
        reference="results/cameras/{camera}/reference.h5",
    log:
        "results/logs/ingest_reference/{camera}.log",
    benchmark:
        "results/benchmarks/ingest_reference/{camera}.tsv"
    # What every object waits for, and the longest jobs behind it, come first: no core is idle at the end.
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2500 * attempt,
    params:
        folder=sets.folder,
        options=sets.ingest_options,
        white_reflectance=sets.white_reflectance,
        user_files=ledger.content(sets.tables_of_white),
        code=code_hash("irodori.ingest.camera_reference"),
    script:
        "../scripts/ingest_reference.py"


rule ingest_chart:
    input:
        table=sets.checked_table,
        reference=sets.camera_file("results/cameras/{camera}/reference.h5"),
    output:
        linear=intermediate("results/cameras/{camera}/linear/{capture}.h5"),
    log:
        "results/logs/ingest_raw/cameras-{camera}_{capture}.log",
    benchmark:
        "results/benchmarks/ingest_raw/cameras-{camera}_{capture}.tsv"
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    # Captures are many: one core each does more of them than both on one.
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        folder=sets.folder,
        options=sets.ingest_options,
        near_lamp=sets.near_lamp,
        code=code_hash("irodori.ingest.stage"),
    script:
        "../scripts/ingest_raw.py"


use rule ingest_chart as ingest_environment with:
    output:
        linear=intermediate("results/environments/{environment}/linear/{capture}.h5"),
    log:
        "results/logs/ingest_raw/environments-{environment}_{capture}.log",
    benchmark:
        "results/benchmarks/ingest_raw/environments-{environment}_{capture}.tsv"


# A job ingests several captures of an object, for starting takes longer than ingesting one. No wildcard stands for
# a list of files, so that every such job is a rule of its own.
for part in sets.ingest_parts():

    rule:
        name:
            part.rule_name
        input:
            table=sets.checked_table,
            reference=sets.camera_file("results/cameras/{camera}/reference.h5"),
        output:
            linear=intermediate(expand("results/{{object}}/linear/{capture}.h5", capture=part.captures)),
        log:
            f"results/logs/ingest_raw/{{object}}_{part.number}.log",
        benchmark:
            f"results/benchmarks/ingest_raw/{{object}}_{part.number}.tsv"
        wildcard_constraints:
            object=part.object_name,
        # Registration, which one core does, follows; the light can be recovered beside it.
        priority: 40
        conda:
            "../../envs/irodori.yaml"
        threads: 1
        resources:
            mem_mb=lambda wildcards, attempt: 1500 * attempt,
        params:
            folder=sets.folder,
            options=sets.ingest_options,
            near_lamp=sets.near_lamp,
            code=code_hash("irodori.ingest.stage"),
        script:
            "../scripts/ingest_raw.py"
