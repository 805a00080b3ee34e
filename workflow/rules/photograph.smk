# A scene beside its photograph. What stands before a virtual camera is rendered from the true materials.
rule render_photographed:
    input:
        materials=scenes.materials("results/{object}/truth.h5"),
        environment=scenes.true_light,
        user_files=ancient(scenes.files),
    output:
        radiance="results/{scene}/photographs/{photograph}/radiance.h5",
    log:
        "results/logs/render_photographed/{scene}_{photograph}.log",
    benchmark:
        "results/benchmarks/render_photographed/{scene}_{photograph}.tsv"
    # As of render_truth: one core is free early, and compiles what all later renderings need.
    priority: 45
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        scene=scenes.part("objects", "bodies", "lights"),
        placed=scenes.photograph,
        optics=sets.optics,
        shapes=scenes.shapes,
        user_files=ledger.content(scenes.files),
        code=code_hash("irodori.rendering.photographed_view"),
    script:
        "../scripts/render_photographed.py"


rule capture_photograph:
    input:
        radiance="results/{scene}/photographs/{photograph}/radiance.h5",
        user_files=ancient(sets.files_of_session),
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
        placed=scenes.photograph,
        camera=sets.camera,
        rig=sets.rig,
        table=sets.table,
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.capture.stage"),
    script:
        "../scripts/capture_photograph.py"


rule ingest_photograph:
    input:
        made=sets.made,
        user_files=ancient(sets.own_photographs),
        reference=sets.camera_file("results/cameras/{camera}/reference.h5"),
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
        table=sets.table,
        folder=sets.folder,
        options=sets.ingest_options,
        near_lamp=sets.near_lamp,
        user_files=ledger.content(sets.own_photographs),
        altered=ledger.altered(sets.photographs_of_session),
        code=code_hash("irodori.ingest.stage"),
    script:
        "../scripts/ingest_photograph.py"


rule compare_photograph:
    input:
        linear="results/{scene}/photographs/{photograph}/linear/scene.h5",
        calibration=sets.camera_file("results/cameras/{camera}/calibration.h5"),
        radiance=scenes.photograph_radiance,
        materials=scenes.materials("results/{object}/material.h5"),
        environment=scenes.environment,
        lens=sets.lens,
        user_files=ancient(scenes.shown_files),
    output:
        comparison=report(
            "results/{scene}/photographs/{photograph}/comparison.png",
            caption="../report/photograph.rst",
            category="Beside a photograph",
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
        scene=scenes.part("objects", "bodies", "lights", "display"),
        placed=scenes.photograph,
        optics=sets.optics,
        shapes=scenes.shapes,
        user_files=ledger.content(scenes.shown_files),
        code=code_hash("irodori.evaluation.photograph_comparison", "irodori.lens.lens_file"),
    script:
        "../scripts/compare_photograph.py"
