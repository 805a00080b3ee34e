rule write_truth:
    input:
        user_files=ancient(sets.files_of_session),
    output:
        truth="results/{object}/truth.h5",
    log:
        "results/logs/write_truth/{object}.log",
    benchmark:
        "results/benchmarks/write_truth/{object}.tsv"
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
    params:
        definition=sets.true_object,
        camera=sets.camera,
        rig=sets.rig,
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.simulation.virtual_rig.ground_truth"),
    script:
        "../scripts/write_truth.py"


rule write_true_environment:
    input:
        user_files=ancient(sets.files_of_session),
    output:
        truth="results/environments/{environment}/truth.h5",
    log:
        "results/logs/write_true_environment/{environment}.log",
    benchmark:
        "results/benchmarks/write_true_environment/{environment}.tsv"
    # The photograph of the scene waits for it.
    priority: 60
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1500 * attempt,
    params:
        definition=sets.photographed_place,
        rig=sets.rig,
        irradiance=lookup(within=config["environment"], dpath="irradiance"),
        user_files=ledger.content(sets.files_of_session),
        code=code_hash("irodori.simulation.virtual_rig.ground_truth"),
    script:
        "../scripts/write_true_environment.py"


# A report is that of a scene, or of a camera that the configuration names by itself: `reports` tells them apart by their
# wildcards.
rule measure_errors:
    input:
        materials=reports.objects("results/{object}/material.h5", virtual_only=True),
        true_materials=reports.objects("results/{object}/truth.h5", virtual_only=True),
        environments=reports.environments("results/environments/{environment}.h5", virtual_only=True),
        true_environments=reports.environments("results/environments/{environment}/truth.h5", virtual_only=True),
        calibrations=reports.cameras("results/cameras/{camera}/calibration.h5"),
        light=reports.light,
        views=reports.views("results/{scene}/{view}.exr", virtual_only=True),
        true_views=reports.views("results/{scene}/truth/{view}.exr", virtual_only=True),
    output:
        errors=report(
            "results/{scene}/errors.csv",
            caption="../report/errors.rst",
            category="Errors",
            labels={"scene": "{scene}"},
        ),
    log:
        "results/logs/measure_errors/{scene}.log",
    benchmark:
        "results/benchmarks/measure_errors/{scene}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        objects=reports.objects("{object}", virtual_only=True),
        environments=reports.environments("{environment}", virtual_only=True),
        cameras=reports.cameras("{camera}"),
        views=reports.views("{scene}/{view}", virtual_only=True),
        light=reports.light_name,
        scene=reports.scene,
        shapes=reports.shapes,
        lights=lookup(within=config["report"], dpath="lights"),
        code=code_hash("irodori.evaluation.truth_errors"),
    script:
        "../scripts/measure_errors.py"


use rule measure_errors as measure_camera_errors with:
    output:
        errors=report(
            "results/cameras/{camera}/errors.csv",
            caption="../report/errors.rst",
            category="Errors",
            labels={"camera": "{camera}"},
        ),
    log:
        "results/logs/measure_errors/cameras-{camera}.log",
    benchmark:
        "results/benchmarks/measure_errors/cameras-{camera}.tsv"


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
    # Beside the page, and before what takes less long.
    priority: 2
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
        errors=reports.errors,
        budgets=reports.views("results/{scene}/error_budget/{view}.csv", virtual_only=True),
        lenses=reports.lenses,
        references=reports.cameras("results/cameras/{camera}/reference.h5"),
        sessions=reports.sessions,
        registrations=reports.objects("results/{object}/registration.csv"),
        placements=reports.placements,
        materials=reports.objects("results/{object}/material.h5"),
        true_materials=reports.objects("results/{object}/truth.h5", virtual_only=True),
        environments=reports.environments("results/environments/{environment}.h5"),
        calibrations=reports.cameras("results/cameras/{camera}/calibration.h5"),
        selections=reports.cameras("results/cameras/{camera}/calibration_selection.csv"),
        calibration_errors=reports.cameras("results/cameras/{camera}/calibration_errors.csv"),
        pictures=reports.views("results/{scene}/{view}.png"),
        figures=reports.views("results/{scene}/{view}.json"),
        true_pictures=reports.views("results/{scene}/truth/{view}.png", virtual_only=True),
        comparisons=reports.photographs("results/{scene}/photographs/{photograph}/comparison.png"),
        comparison_figures=reports.photographs("results/{scene}/photographs/{photograph}/comparison.json"),
        pages=reports.pages,
    output:
        page=report(
            "results/{scene}/report.html",
            caption="../report/report.rst",
            category="Errors",
            labels={"scene": "{scene}"},
        ),
    log:
        "results/logs/write_report/{scene}.log",
    benchmark:
        "results/benchmarks/write_report/{scene}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        title=reports.title,
        objects=reports.objects("{object}"),
        virtual_objects=reports.objects("{object}", virtual_only=True),
        environments=reports.environments("{environment}"),
        cameras=reports.cameras("{camera}"),
        lens_cameras=reports.lens_cameras,
        views=reports.views("{scene}/{view}"),
        virtual_views=reports.views("{scene}/{view}", virtual_only=True),
        photographs=reports.photographs("{scene}/{photograph}"),
        jobs=reports.jobs,
        benchmarks="results/benchmarks",
        code=code_hash("irodori.report.page"),
    script:
        "../scripts/write_report.py"


use rule write_report as write_camera_report with:
    output:
        page=report(
            "results/cameras/{camera}/report.html",
            caption="../report/report.rst",
            category="Errors",
            labels={"camera": "{camera}"},
        ),
    log:
        "results/logs/write_report/cameras-{camera}.log",
    benchmark:
        "results/benchmarks/write_report/cameras-{camera}.tsv"
