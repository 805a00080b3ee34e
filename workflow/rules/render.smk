rule plan_scene:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        environment=scenes.environment,
        light_maps=scenes.light_maps("results/{scene}/light-maps.h5"),
        user_files=ancient(scenes.files),
    output:
        plan="results/{scene}/plan.yaml",
    log:
        "results/logs/plan_scene/{scene}.log",
    benchmark:
        "results/benchmarks/plan_scene/{scene}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        user_files=ledger.content(scenes.files),
        code=code_hash("irodori.rendering.planning.stage"),
    script:
        "../scripts/plan_scene.py"


# One job a scene: its views share the light that falls on the objects.
rule bake_light:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        environment=scenes.environment,
        user_files=ancient(scenes.files),
    output:
        maps="results/{scene}/light-maps.h5",
    log:
        "results/logs/bake_light/{scene}.log",
    benchmark:
        "results/benchmarks/bake_light/{scene}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=scenes.baked_of,
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        user_files=ledger.content(scenes.files),
        code=code_hash("irodori.rendering.stage"),
    script:
        "../scripts/bake_light.py"


# The same of the true materials, for the report alone.
use rule bake_light as bake_true_light with:
    input:
        materials=scenes.materials("results/{object}/truth.h5"),
        environment=scenes.environment,
        user_files=ancient(scenes.files),
    output:
        maps="results/{scene}/truth/light-maps.h5",
    log:
        "results/logs/bake_true_light/{scene}.log",
    benchmark:
        "results/benchmarks/bake_true_light/{scene}.tsv"
    params:
        scene=scenes.baked_of,
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        user_files=ledger.content(scenes.files),
        code=code_hash("irodori.rendering.stage"),


rule render_view:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        environment=scenes.environment,
        plan=scenes.plan,
        light_maps=scenes.light_maps("results/{scene}/light-maps.h5"),
        user_files=ancient(scenes.shown_files),
    output:
        exr="results/{scene}/{view}.exr",
        png=report(
            "results/{scene}/{view}.png",
            caption="../report/view.rst",
            category="Pictures",
            labels={"scene": "{scene}", "view": "{view}"},
        ),
        figures="results/{scene}/{view}.json",
    log:
        "results/logs/render_view/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/render_view/{scene}_{view}.tsv"
    # Page, errors and report wait for it, and it takes long.
    priority: 20
    conda:
        "../../envs/irodori.yaml"
    threads: scenes.threads_of_view
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        check=True,
        user_files=ledger.content(scenes.shown_files),
        code=code_hash("irodori.rendering.stage"),
    script:
        "../scripts/render_view.py"


# The same view from the true materials, for the report alone.
use rule render_view as render_truth with:
    input:
        materials=scenes.materials("results/{object}/truth.h5"),
        environment=scenes.environment,
        plan=scenes.plan,
        light_maps=scenes.light_maps("results/{scene}/truth/light-maps.h5"),
        user_files=ancient(scenes.shown_files),
    output:
        exr="results/{scene}/truth/{view}.exr",
        png="results/{scene}/truth/{view}.png",
        figures="results/{scene}/truth/{view}.json",
    log:
        "results/logs/render_truth/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/render_truth/{scene}_{view}.tsv"
    # Beside the first object whose lobes are chosen: two of them would wait for each other's kernels.
    priority: 1
    # The plan is that of the measured materials, whose picture is checked: the same light is seen in both.
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        check=False,
        user_files=ledger.content(scenes.shown_files),
        code=code_hash("irodori.rendering.stage"),


# One job a sequence: the frames that an interrupted one had finished stay in frames.part, which is no output.
rule render_frames:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        environment=scenes.environment,
        light_maps=scenes.frames_light_maps,
        user_files=ancient(scenes.shown_files),
    output:
        frames=directory("results/{scene}/{view}/frames"),
        animation=report(
            "results/{scene}/{view}.frames.png",
            caption="../report/frames.rst",
            category="Frames",
            labels={"scene": "{scene}", "view": "{view}"},
        ),
        figures="results/{scene}/{view}.frames.json",
    log:
        "results/logs/render_frames/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/render_frames/{scene}_{view}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt + scenes.memory_of_frames_mb(wildcards),
    params:
        scene=scenes.with_frames,
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        user_files=ledger.content(scenes.shown_files),
        code=code_hash("irodori.rendering.sequence"),
    script:
        "../scripts/render_frames.py"


rule write_xyz:
    input:
        exr="results/{scene}/{view}.exr",
        environment=scenes.environment,
        user_files=ancient(scenes.tables),
    output:
        picture="results/{scene}/{view}.xyz.exr",
    log:
        "results/logs/write_xyz/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/write_xyz/{scene}_{view}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        user_files=ledger.content(scenes.tables),
        code=code_hash("irodori.rendering.stage"),
    script:
        "../scripts/write_xyz.py"


rule write_tiff:
    input:
        exr="results/{scene}/{view}.exr",
        environment=scenes.environment,
        user_files=ancient(scenes.shown_tables),
    output:
        picture="results/{scene}/{view}.tif",
    log:
        "results/logs/write_tiff/{scene}_{view}.log",
    benchmark:
        "results/benchmarks/write_tiff/{scene}_{view}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        user_files=ledger.content(scenes.shown_tables),
        code=code_hash("irodori.rendering.stage"),
    script:
        "../scripts/write_tiff.py"
