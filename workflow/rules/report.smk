rule write_truth:
    input:
        user_files=ancient(sets.mesh),
    output:
        truth="results/{object}/truth.h5",
    log:
        "results/logs/write_truth/{object}.log",
    benchmark:
        "results/benchmarks/write_truth/{object}.tsv"
    priority: 30
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
    params:
        definition=lookup(within=config["objects"], dpath="{object}"),
        camera=sets.camera,
        rig=sets.rig,
        user_files=ledger.content(sets.mesh),
        code=code_hash("irodori.simulation.virtual_rig.ground_truth"),
    script:
        "../scripts/write_truth.py"


rule write_true_environment:
    output:
        truth="results/environments/{environment}/truth.h5",
    log:
        "results/logs/write_true_environment/{environment}.log",
    benchmark:
        "results/benchmarks/write_true_environment/{environment}.tsv"
    # The photograph of the scene waits for it.
    priority: 30
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        definition=lookup(within=config["environments"], dpath="{environment}"),
        rig=sets.rig,
        irradiance=lookup(within=config["environment"], dpath="irradiance"),
        code=code_hash("irodori.simulation.virtual_rig.ground_truth"),
    script:
        "../scripts/write_true_environment.py"


rule measure_errors:
    input:
        materials=expand("results/{object}/material.h5", object=sets.virtual("objects")),
        true_materials=expand("results/{object}/truth.h5", object=sets.virtual("objects")),
        environments=expand("results/environments/{environment}.h5", environment=sets.virtual("environments")),
        true_environments=expand(
            "results/environments/{environment}/truth.h5", environment=sets.virtual("environments")
        ),
        calibrations=expand("results/cameras/{camera}/calibration.h5", camera=config["cameras"]),
        view_lights=scenes.views("results/environments/{environment}.h5", virtual_only=True),
        views=scenes.views("results/{scene}/{view}.exr", virtual_only=True),
        true_views=scenes.views("results/{scene}/truth/{view}.exr", virtual_only=True),
    output:
        errors=report("results/errors.csv", caption="../report/errors.rst", category="Errors"),
    log:
        "results/logs/measure_errors/all.log",
    benchmark:
        "results/benchmarks/measure_errors/all.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        objects=sets.virtual("objects"),
        environments=sets.virtual("environments"),
        cameras=list(config["cameras"]),
        views=scenes.views("{scene}/{view}", virtual_only=True),
        view_environments=scenes.views("{environment}", virtual_only=True),
        view_scenes=scenes.view_scenes(virtual_only=True),
        lights=lookup(within=config["report"], dpath="lights"),
        code=code_hash("irodori.evaluation.truth_errors"),
    script:
        "../scripts/measure_errors.py"


rule measure_plan:
    input:
        user_files=ancient(sets.tables_of_plates),
    output:
        planning=report("results/planning.csv", caption="../report/planning.rst", category="Poses"),
    log:
        "results/logs/measure_plan/all.log",
    benchmark:
        "results/benchmarks/measure_plan/all.tsv"
    # No stage waits for it, and the loops it shares with them are compiled by then.
    priority: -10
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
    params:
        objects=sets.plates,
        fit=lookup(within=config, dpath="fit"),
        max_angle_deg=lookup(within=config["rectify"], dpath="max_angle_deg"),
        planning=lookup(within=config["report"], dpath="planning"),
        user_files=ledger.content(sets.tables_of_plates),
        code=code_hash("irodori.evaluation.pose_planning"),
    script:
        "../scripts/measure_plan.py"


rule measure_imperfections:
    input:
        user_files=ancient(sets.files_of_imperfections),
    output:
        costs=report(
            "results/imperfections.csv",
            caption="../report/imperfections.rst",
            category="Errors",
        ),
    log:
        "results/logs/measure_imperfections/all.log",
    benchmark:
        "results/benchmarks/measure_imperfections/all.tsv"
    # No stage waits for it, and the loops it shares with them are compiled by then.
    priority: -10
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        subject=sets.imperfect_object,
        ingest=sets.ingest_options,
        rectify=lookup(within=config, dpath="rectify"),
        fit=lookup(within=config, dpath="fit"),
        compress=lookup(within=config, dpath="compress"),
        lights=lookup(within=config["report"], dpath="lights"),
        user_files=ledger.content(sets.files_of_imperfections),
        code=code_hash("irodori.evaluation.imperfection_costs"),
    script:
        "../scripts/measure_imperfections.py"


rule measure_error_budget:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        true_materials=scenes.materials("results/{object}/truth.h5"),
        calibrations=scenes.calibrations,
        tiles=scenes.tiles,
        observations=scenes.observations,
        environment=scenes.environment,
        true_environment=scenes.true_light,
        user_files=ancient(scenes.files),
        plan=scenes.plan,
    output:
        budget=report(
            "results/{scene}/error_budget/{view}.csv",
            caption="../report/error_budget.rst",
            category="Errors",
            labels={"scene": "{scene}", "view": "{view}"},
        ),
    log:
        "results/logs/measure_error_budget/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/measure_error_budget/{scene}_{view}.tsv"
    # No stage waits for it, and the loops it shares with them are compiled by then.
    priority: -10
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        subjects=scenes.subjects,
        render=lookup(within=config, dpath="render"),
        fit=lookup(within=config, dpath="fit"),
        compress=lookup(within=config, dpath="compress"),
        environment=lookup(within=config, dpath="environment"),
        user_files=ledger.content(scenes.files),
        code=code_hash("irodori.evaluation.error_budget"),
    script:
        "../scripts/measure_error_budget.py"


rule measure_registration:
    input:
        linear=sets.linear_files,
    output:
        registration="results/{object}/registration.csv",
    log:
        "results/logs/measure_registration/{object}.log",
    benchmark:
        "results/benchmarks/measure_registration/{object}.tsv"
    # No stage waits for it.
    priority: -10
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 500 * attempt,
    params:
        code=code_hash("irodori.evaluation.registration_errors"),
    script:
        "../scripts/measure_registration.py"


rule write_report:
    input:
        errors="results/errors.csv",
        planning="results/planning.csv",
        imperfections="results/imperfections.csv",
        budgets=scenes.views("results/{scene}/error_budget/{view}.csv", virtual_only=True),
        references=expand("results/cameras/{camera}/reference.h5", camera=config["cameras"]),
        sessions=sets.sessions,
        registrations=expand("results/{object}/registration.csv", object=config["objects"]),
        materials=expand("results/{object}/material.h5", object=config["objects"]),
        true_materials=expand("results/{object}/truth.h5", object=sets.virtual("objects")),
        environments=expand("results/environments/{environment}.h5", environment=config["environments"]),
        calibrations=expand("results/cameras/{camera}/calibration.h5", camera=config["cameras"]),
        selections=expand("results/cameras/{camera}/calibration_selection.csv", camera=config["cameras"]),
        calibration_errors=expand("results/cameras/{camera}/calibration_errors.csv", camera=config["cameras"]),
        pictures=scenes.views("results/{scene}/{view}.png"),
        figures=scenes.views("results/{scene}/{view}.json"),
        true_pictures=scenes.views("results/{scene}/truth/{view}.png", virtual_only=True),
        comparisons=scenes.photographs("results/{scene}/photographs/{photograph}/comparison.png"),
        comparison_figures=scenes.photographs("results/{scene}/photographs/{photograph}/comparison.json"),
        pages=scenes.pages(),
    output:
        page=report("results/report.html", caption="../report/report.rst", category="Errors"),
    log:
        "results/logs/write_report/all.log",
    benchmark:
        "results/benchmarks/write_report/all.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        objects=list(config["objects"]),
        virtual_objects=sets.virtual("objects"),
        environments=list(config["environments"]),
        cameras=list(config["cameras"]),
        views=scenes.views("{scene}/{view}"),
        virtual_views=scenes.views("{scene}/{view}", virtual_only=True),
        photographs=scenes.photographs("{scene}/{photograph}"),
        pages=scenes.pages("{scene}/viewer.html"),
        benchmarks="results/benchmarks",
        code=code_hash("irodori.report.page"),
    script:
        "../scripts/write_report.py"
