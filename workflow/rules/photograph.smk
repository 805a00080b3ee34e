# A scene beside its photograph. What stands before a virtual camera is rendered from the true materials.
rule render_photographed:
    input:
        materials=scene_materials("results/{object}/truth.h5"),
        environment=true_light,
        meshes=scene_meshes,
        tables=scene_tables,
    output:
        radiance="results/{scene}/photographs/{photograph}/radiance.h5",
    log:
        "results/logs/render_photographed/{scene}_{photograph}.log",
    benchmark:
        "results/benchmarks/render_photographed/{scene}_{photograph}.tsv"
    # As of render_truth: one core is free early, and compiles what all later renderings need.
    priority: 20
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        scene=part_of_scene("objects", "bodies", "lights"),
        placed=photograph_of,
        optics=lambda wildcards: photograph_camera(wildcards)["optics"],
        shapes=scene_shapes,
        code=code_hash("irodori.rendering.photographed_view"),
    script:
        "../scripts/render_photographed.py"


rule capture_photograph:
    input:
        radiance="results/{scene}/photographs/{photograph}/radiance.h5",
        spectra=lambda wildcards: named_tables(
            photograph_camera(wildcards), config["rigs"][photograph_camera(wildcards)["rig"]]
        ),
    output:
        session="results/{scene}/photographs/{photograph}/captures/session.json",
    log:
        "results/logs/capture_photograph/{scene}_{photograph}.log",
    benchmark:
        "results/benchmarks/capture_photograph/{scene}_{photograph}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        placed=photograph_of,
        camera=photograph_camera,
        rig=lambda wildcards: config["rigs"][photograph_camera(wildcards)["rig"]],
        table=photograph_table,
        code=code_hash("irodori.capture.stage"),
    script:
        "../scripts/capture_photograph.py"


rule ingest_photograph:
    input:
        made=photograph_made,
        reference=of_photograph("results/cameras/{camera}/reference.h5"),
    output:
        linear="results/{scene}/photographs/{photograph}/linear/scene.h5",
    log:
        "results/logs/ingest_photograph/{scene}_{photograph}.log",
    benchmark:
        "results/benchmarks/ingest_photograph/{scene}_{photograph}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        table=photograph_table,
        folder=photograph_folder,
        options=ingest_options,
        code=code_hash("irodori.ingest.stage"),
    script:
        "../scripts/ingest_photograph.py"


rule compare_photograph:
    input:
        linear="results/{scene}/photographs/{photograph}/linear/scene.h5",
        calibration=of_photograph("results/cameras/{camera}/calibration.h5"),
        radiance=photograph_radiance,
        materials=scene_materials("results/{object}/material.h5"),
        environment=scene_environment,
        meshes=scene_meshes,
        tables=scene_tables,
        display=display_file,
    output:
        comparison=report(
            "results/{scene}/photographs/{photograph}/comparison.png",
            caption="../report/photograph.rst",
            category="Beside the real thing",
            labels={"scene": "{scene}", "photograph": "{photograph}"},
        ),
        photograph="results/{scene}/photographs/{photograph}/photograph.png",
        rendering="results/{scene}/photographs/{photograph}/rendering.png",
        difference="results/{scene}/photographs/{photograph}/comparison.h5",
        figures="results/{scene}/photographs/{photograph}/comparison.json",
    log:
        "results/logs/compare_photograph/{scene}_{photograph}.log",
    benchmark:
        "results/benchmarks/compare_photograph/{scene}_{photograph}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        scene=part_of_scene("objects", "bodies", "lights", "display"),
        placed=photograph_of,
        optics=lambda wildcards: photograph_camera(wildcards)["optics"],
        shapes=scene_shapes,
        code=code_hash("irodori.evaluation.photograph_comparison"),
    script:
        "../scripts/compare_photograph.py"
