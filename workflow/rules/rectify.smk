rule register_object:
    input:
        linear=sets.linear_of_placement,
        first=sets.first_registration,
        first_linear=sets.first_linear,
        lens=sets.lens,
        user_files=ancient(sets.mesh_and_tables_of_index),
    output:
        registration="results/{object}/registration.h5",
    log:
        "results/logs/register_object/{object}.log",
    benchmark:
        "results/benchmarks/register_object/{object}.tsv"
    priority: 40
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        shape=lookup(within=config["objects"], dpath="{object}/shape"),
        texels=lookup(within=config["objects"], dpath="{object}/texels"),
        placements=lookup(within=config["objects"], dpath="{object}/placements"),
        optics=sets.optics,
        white_pose=sets.white_pose,
        rig=sets.rig_geometry,
        place=lookup(within=config, dpath="place"),
        markers=lookup(within=config["objects"], dpath="{object}/markers", default=None),
        fit=lookup(within=config, dpath="fit"),
        lobes=lookup(within=config["objects"], dpath="{object}/lobes"),
        coat=lookup(within=config["objects"], dpath="{object}/coat"),
        refractive_index=lookup(within=config["objects"], dpath="{object}/refractive_index"),
        max_angle_deg=lookup(within=config["rectify"], dpath="max_angle_deg"),
        user_files=ledger.content(sets.mesh_and_tables_of_index),
        code=code_hash(
            "irodori.rectification.object_registration",
            "irodori.fitting.light_angle",
            "irodori.lens.lens_file",
        ),
    script:
        "../scripts/register_object.py"


# An object that was laid down again is registered anew, and its texture tells how it was turned.
use rule register_object as register_placement with:
    output:
        registration="results/{object}/registration-{placement}.h5",
    log:
        "results/logs/register_object/{object}_{placement}.log",
    benchmark:
        "results/benchmarks/register_object/{object}_{placement}.tsv"


# One job for objects that were photographed together, and for the placements of one. No wildcard stands for a list of
# them: each job is a rule of its own.
for units in sets.together():

    rule:
        name:
            f"combine_registrations_{units[0].object_name}".replace("-", "_")
        input:
            registrations=[unit.file("registration") for unit in units],
        output:
            placements=[unit.file("placement") for unit in units],
        log:
            f"results/logs/combine_registrations/{units[0].object_name}.log",
        benchmark:
            f"results/benchmarks/combine_registrations/{units[0].object_name}.tsv"
        priority: 40
        conda:
            "../../envs/irodori.yaml"
        threads: 1
        resources:
            mem_mb=lambda wildcards, attempt: 500 * attempt,
        params:
            labels=[unit.label for unit in units],
            code=code_hash("irodori.rectification.shared_camera"),
        script:
            "../scripts/combine_registrations.py"


rule rectify_object:
    input:
        linear=sets.linear_files,
        lens=sets.lens,
        registration=sets.registration,
        user_files=ancient(sets.mesh),
    output:
        observations=intermediate("results/{object}/observations/tile-{tile}.h5"),
    log:
        "results/logs/rectify_object/{object}_{tile}.log",
    benchmark:
        "results/benchmarks/rectify_object/{object}_{tile}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        shape=lookup(within=config["objects"], dpath="{object}/shape"),
        texels=lookup(within=config["objects"], dpath="{object}/texels"),
        placements=lookup(within=config["objects"], dpath="{object}/placements"),
        sheet=lookup(within=config["objects"], dpath="{object}/sheet", default=None),
        rows=lambda wildcards: sets.tiles_of(wildcards.object)[int(wildcards.tile)],
        optics=sets.optics,
        white_pose=sets.white_pose,
        rig=sets.rig_geometry,
        max_angle_deg=lookup(within=config["rectify"], dpath="max_angle_deg"),
        user_files=ledger.content(sets.mesh),
        code=code_hash("irodori.rectification.stage", "irodori.lens.lens_file"),
    script:
        "../scripts/rectify_object.py"


rule measure_patch:
    input:
        linear=sets.linear_files,
        registration=sets.registration,
        user_files=ancient(sets.mesh),
    output:
        levels="results/{object}/patch_levels.h5",
    log:
        "results/logs/measure_patch/{object}.log",
    benchmark:
        "results/benchmarks/measure_patch/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        patch=lookup(within=config["objects"], dpath="{object}/level_patch"),
        shape=lookup(within=config["objects"], dpath="{object}/shape"),
        texels=lookup(within=config["objects"], dpath="{object}/texels"),
        placements=lookup(within=config["objects"], dpath="{object}/placements"),
        optics=sets.optics,
        white_pose=sets.white_pose,
        rig=sets.rig_geometry,
        model_error=lookup(within=config["fit"], dpath="model_error"),
        level_error=lookup(within=config["fit"], dpath="level_error"),
        user_files=ledger.content(sets.mesh),
        code=code_hash("irodori.rectification.level_patch"),
    script:
        "../scripts/measure_patch.py"
