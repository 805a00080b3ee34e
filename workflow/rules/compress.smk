rule compress_reflectance:
    input:
        tiles=sets.fitted_tiles,
        lobes="results/{object}/lobes.h5",
        observations=sets.observations_of_sheet,
        levels=sets.levels_of_sheet,
        user_files=ancient(lambda wildcards: material_files(loaded.objects[wildcards.object])),
        calibration=sets.camera_file("results/cameras/{camera}/calibration.h5"),
    output:
        material="results/{object}/material.h5",
    log:
        "results/logs/compress_reflectance/{object}.log",
    benchmark:
        "results/benchmarks/compress_reflectance/{object}.tsv"
    # Before the lobes of the next object are chosen: two of these jobs would wait for each other's kernels.
    priority: 3
    conda:
        "../../envs/irodori.yaml"
    # Of a large object, nothing else can run meanwhile.
    threads: lambda wildcards: min(2, len(sets.tiles_of(wildcards.object)))
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        definition=lambda wildcards: material_definition(loaded.objects[wildcards.object]),
        compress=lookup(within=config, dpath="compress"),
        lights=lookup(within=config["report"], dpath="lights"),
        user_files=ledger.content(lambda wildcards: material_files(loaded.objects[wildcards.object])),
        code=code_hash("irodori.material.stage", "irodori.core.made_of"),
    script:
        "../scripts/compress_reflectance.py"
