rule capture_object:
    input:
        spectra=tables_of_capture,
    output:
        table="results/{object}/captures/captures.csv",
    log:
        "results/logs/capture_object/{object}.log",
    benchmark:
        "results/benchmarks/capture_object/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        definition=photographed,
        camera=definition_of("cameras"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.virtual.session"),
    script:
        "../scripts/capture_object.py"


rule capture_camera:
    input:
        spectra=tables_of_capture,
    output:
        table="results/cameras/{camera}/captures/captures.csv",
    log:
        "results/logs/capture_camera/{camera}.log",
    benchmark:
        "results/benchmarks/capture_camera/{camera}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        camera=lookup(within=config, dpath="cameras/{camera}"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.virtual.session"),
    script:
        "../scripts/capture_camera.py"


rule capture_environment:
    input:
        spectra=tables_of_capture,
    output:
        table="results/environments/{environment}/captures/captures.csv",
    log:
        "results/logs/capture_environment/{environment}.log",
    benchmark:
        "results/benchmarks/capture_environment/{environment}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        definition=lookup(within=config, dpath="environments/{environment}"),
        camera=definition_of("cameras"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.virtual.session"),
    script:
        "../scripts/capture_environment.py"
