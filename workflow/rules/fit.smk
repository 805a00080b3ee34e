# One job an object, before its tiles are fitted: all of them have the same lobes. Also where these are named, photographs
# are left out and predicted, because they may contradict what was named.
rule choose_lobes:
    input:
        observations=sets.observed_tiles,
        user_files=ancient(sets.tables_of_index),
        calibration=sets.calibration_of_index,
    output:
        choice="results/{object}/lobes.h5",
    log:
        "results/logs/choose_lobes/{object}.log",
    benchmark:
        "results/benchmarks/choose_lobes/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        fit=lookup(within=config, dpath="fit"),
        lobes=lookup(within=config["objects"], dpath="{object}/lobes"),
        coat=lookup(within=config["objects"], dpath="{object}/coat"),
        lamp_radius_deg=sets.lamp_radius_deg,
        refractive_index=lookup(within=config["objects"], dpath="{object}/refractive_index"),
        user_files=ledger.content(sets.tables_of_index),
        code=code_hash("irodori.fitting.lobe_stage", "irodori.spectra.published"),
    script:
        "../scripts/choose_lobes.py"


# One job an object, before its tiles are fitted: the lamp is the same for all of them.
rule measure_levels:
    input:
        observations=sets.observed_tiles,
        lobes="results/{object}/lobes.h5",
        user_files=ancient(sets.tables_of_index),
        calibration=sets.calibration_of_index,
    output:
        levels="results/{object}/levels.h5",
    log:
        "results/logs/measure_levels/{object}.log",
    benchmark:
        "results/benchmarks/measure_levels/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        fit=lookup(within=config, dpath="fit"),
        lamp_radius_deg=sets.lamp_radius_deg,
        refractive_index=lookup(within=config["objects"], dpath="{object}/refractive_index"),
        user_files=ledger.content(sets.tables_of_index),
        code=code_hash("irodori.fitting.level_stage", "irodori.material.lobe_choices", "irodori.spectra.published"),
    script:
        "../scripts/measure_levels.py"


rule fit_brdf:
    input:
        observations="results/{object}/observations/tile-{tile}.h5",
        lobes="results/{object}/lobes.h5",
        levels=sets.photograph_levels,
        user_files=ancient(sets.tables_of_index),
        calibration=sets.calibration_of_index,
    output:
        brdf=intermediate("results/{object}/brdf/tile-{tile}.h5"),
    log:
        "results/logs/fit_brdf/{object}_{tile}.log",
    benchmark:
        "results/benchmarks/fit_brdf/{object}_{tile}.tsv"
    conda:
        "../../envs/irodori.yaml"
    # Tiles are fitted beside each other: a job that wanted two cores would wait for both, and all that needs it too.
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        fit=lookup(within=config, dpath="fit"),
        lamp_radius_deg=sets.lamp_radius_deg,
        refractive_index=lookup(within=config["objects"], dpath="{object}/refractive_index"),
        user_files=ledger.content(sets.tables_of_index),
        code=code_hash("irodori.fitting.stage", "irodori.material.lobe_choices", "irodori.spectra.published"),
    script:
        "../scripts/fit_brdf.py"


# One job an object: its paints are those of all tiles, and a job for each tile would take longer to start than to run.
rule share_gloss:
    input:
        observations=sets.observed_tiles,
        tiles=sets.own_tiles,
        lobes="results/{object}/lobes.h5",
        levels=sets.photograph_levels,
        user_files=ancient(sets.tables_of_index),
        calibration=sets.calibration_of_index,
    output:
        surface="results/{object}/surface.h5",
    log:
        "results/logs/share_gloss/{object}.log",
    benchmark:
        "results/benchmarks/share_gloss/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    # Of a large object, nothing else can run meanwhile.
    threads: lambda wildcards: min(2, len(sets.tiles_of(wildcards.object)))
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        fit=lookup(within=config, dpath="fit"),
        lamp_radius_deg=sets.lamp_radius_deg,
        refractive_index=lookup(within=config["objects"], dpath="{object}/refractive_index"),
        user_files=ledger.content(sets.tables_of_index),
        code=code_hash("irodori.fitting.paint_stage", "irodori.material.lobe_choices", "irodori.spectra.published"),
    script:
        "../scripts/share_gloss.py"
