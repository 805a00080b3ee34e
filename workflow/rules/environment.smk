rule prepare_environment:
    input:
        unpack(sets.photographed_light),
        user_files=ancient(sets.files_of_light),
    output:
        environment="results/environments/{environment}.h5",
    log:
        "results/logs/prepare_environment/{environment}.log",
    benchmark:
        "results/benchmarks/prepare_environment/{environment}.tsv"
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    # One core is free long before both are.
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2500 * attempt,
    params:
        compress=lookup(within=config, dpath="environment"),
        definition=sets.light_definition,
        photographed=sets.is_photographed,
        user_files=ledger.content(sets.files_of_light),
        code=code_hash("irodori.light.stage", "irodori.core.made_of"),
    script:
        "../scripts/prepare_environment.py"
