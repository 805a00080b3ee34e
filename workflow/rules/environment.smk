rule prepare_environment:
    input:
        linear="results/environments/{environment}/linear/environment.h5",
        calibration=camera_file("results/cameras/{camera}/calibration.h5"),
    output:
        environment="results/environments/{environment}.h5",
    log:
        "results/logs/prepare_environment/{environment}.log",
    benchmark:
        "results/benchmarks/prepare_environment/{environment}.tsv"
    priority: 30
    conda:
        "../../envs/irodori.yaml"
    # One core is free long before both are.
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2500 * attempt,
    params:
        compress=lookup(within=config, dpath="environment"),
        code=code_hash("irodori.environment"),
    script:
        "../scripts/prepare_environment.py"
