rule register_object:
    input:
        linear=sets.linear_files,
        lens=sets.lens,
        user_files=ancient(sets.mesh),
    output:
        registration="results/{object}/registration.h5",
    log:
        "results/logs/register_object/{object}.log",
    benchmark:
        "results/benchmarks/register_object/{object}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
    params:
        shape=lookup(within=config["objects"], dpath="{object}/shape"),
        texels=lookup(within=config["objects"], dpath="{object}/texels"),
        optics=sets.optics,
        white_pose=sets.white_pose,
        rig=sets.rig_geometry,
        place=lookup(within=config, dpath="place"),
        user_files=ledger.content(sets.mesh),
        code=code_hash("irodori.rectification.object_registration", "irodori.lens.lens_file"),
    script:
        "../scripts/register_object.py"


rule rectify_object:
    input:
        linear=sets.linear_files,
        lens=sets.lens,
        registration=sets.registration,
        user_files=ancient(sets.mesh),
    output:
        observations="results/{object}/observations/tile-{tile}.h5",
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
        rows=sets.tile_rows,
        optics=sets.optics,
        white_pose=sets.white_pose,
        rig=sets.rig_geometry,
        max_angle_deg=lookup(within=config["rectify"], dpath="max_angle_deg"),
        user_files=ledger.content(sets.mesh),
        code=code_hash("irodori.rectification.stage", "irodori.lens.lens_file"),
    script:
        "../scripts/rectify_object.py"
