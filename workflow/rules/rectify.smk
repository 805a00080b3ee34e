rule rectify_object:
    input:
        linear=linear_files,
        mesh=mesh_of,
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
        shape=lookup(within=config, dpath="objects/{object}/shape"),
        texels=lookup(within=config, dpath="objects/{object}/texels"),
        rows=lambda wildcards: tiles_of(wildcards)[int(wildcards.tile)],
        optics=of_camera("optics"),
        white_pose=lambda wildcards: white_pose(wildcards) if light_place(wildcards) else None,
        rig=lambda wildcards: {
            "camera_distance_mm": of_rig("camera_distance_mm")(wildcards),
            "table_radius_mm": of_rig("table_radius_mm")(wildcards),
            "light": light_place(wildcards),
        },
        max_angle_deg=lookup(within=config, dpath="rectify/max_angle_deg"),
        code=code_hash("irodori.rectification.stage"),
    script:
        "../scripts/rectify_object.py"
