rule capture_object:
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
        mem_mb=1500,
    params:
        definition=photographed,
        camera=definition_of("cameras"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.capture"),
    script:
        "../scripts/capture_object.py"


rule capture_camera:
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
        mem_mb=1500,
    params:
        camera=lookup(within=config, dpath="cameras/{camera}"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.capture"),
    script:
        "../scripts/capture_camera.py"


rule capture_environment:
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
        mem_mb=2000,
    params:
        definition=lookup(within=config, dpath="environments/{environment}"),
        camera=definition_of("cameras"),
        rig=definition_of("rigs"),
        code=code_hash("irodori.rig.capture"),
    script:
        "../scripts/capture_environment.py"
