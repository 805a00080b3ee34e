# What takes long waits for no picture: it is done beside the rendering.
rule encode_viewer:
    input:
        materials=scenes.materials("results/{object}/material.h5"),
        environments=scenes.rooms,
        user_files=ancient(scenes.page_files),
    output:
        payload="results/{scene}/viewer.payload",
    log:
        "results/logs/encode_viewer/{scene}.log",
    benchmark:
        "results/benchmarks/encode_viewer/{scene}.tsv"
    # The longest of those that only the page or the report waits for.
    priority: 5
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        words=lookup(within=config["words"], dpath="{scene}"),
        shapes=scenes.shapes,
        render=lookup(within=config, dpath="render"),
        user_files=ledger.content(scenes.page_files),
        code=code_hash("irodori.viewer.stage"),
    script:
        "../scripts/encode_viewer.py"


rule export_viewer:
    input:
        payload="results/{scene}/viewer.payload",
        environment=scenes.environment,
        poster=scenes.page_view("results/{scene}/{view}.png"),
        picture=scenes.page_view("results/{scene}/{view}.exr"),
        user_files=ancient(scenes.tables),
    output:
        page=report(
            "results/{scene}/viewer.html",
            caption="../report/viewer.rst",
            category="Pages",
            labels={"scene": "{scene}"},
        ),
    log:
        "results/logs/export_viewer/{scene}.log",
    benchmark:
        "results/benchmarks/export_viewer/{scene}.tsv"
    conda:
        "../../envs/irodori.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 3000 * attempt,
    params:
        scene=lookup(within=config["scenes"], dpath="{scene}"),
        user_files=ledger.content(scenes.tables),
        code=code_hash("irodori.viewer.stage"),
    script:
        "../scripts/export_viewer.py"
