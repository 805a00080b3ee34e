# What a session leaves is its RAW files and a table that grows with every photograph; Snakemake deletes the outputs of a
# job before it runs, so neither is an output. The record is: it exists once the session is complete.
rule capture_object:
    input:
        user_files=ancient(sets.files_of_session),
    output:
        session="results/{object}/captures/session.json",
    log:
        "results/logs/capture_object/{object}.log",
    benchmark:
        "results/benchmarks/capture_object/{object}.tsv"
    # Before it comes what all objects wait for (60); then a long picture (45), so that it is rendered beside the first
    # registration (40): two of these would wait for each other's kernels.
    priority: 50
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
        rig=sets.rigs_taken,
    params:
        definition=sets.photographed,
        camera=sets.camera,
        rig=sets.rig,
        rig_name=sets.rig_of,
        table=sets.table,
        folder=sets.folder,
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.capture.stage"),
    script:
        "../scripts/capture_object.py"


rule capture_camera:
    input:
        user_files=ancient(sets.files_of_session),
    output:
        session="results/cameras/{camera}/captures/session.json",
    log:
        "results/logs/capture_camera/{camera}.log",
    benchmark:
        "results/benchmarks/capture_camera/{camera}.tsv"
    # What every object waits for, and the longest jobs behind it, come first: no core is idle at the end.
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
        rig=sets.rigs_taken,
    params:
        camera=sets.camera,
        rig=sets.rig,
        rig_name=sets.rig_of,
        table=sets.table,
        folder=sets.folder,
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.capture.stage"),
    script:
        "../scripts/capture_camera.py"


rule capture_environment:
    input:
        user_files=ancient(sets.files_of_session),
    output:
        session="results/environments/{environment}/captures/session.json",
    log:
        "results/logs/capture_environment/{environment}.log",
    benchmark:
        "results/benchmarks/capture_environment/{environment}.tsv"
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        definition=sets.photographed_place,
        camera=sets.camera,
        rig=sets.rig,
        table=sets.table,
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.capture.stage"),
    script:
        "../scripts/capture_environment.py"


rule capture:
    input:
        sets.sessions,
