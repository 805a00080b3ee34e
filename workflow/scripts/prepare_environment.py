from dataclasses import replace

from irodori.config.models import Chart, IrradianceMap, Size
from irodori.config.parts import typed_source
from irodori.core.made_of import made_of
from irodori.core.run_rule import run_rule
from irodori.light.stage import make_environment, prepare_environment
from irodori.material.principal_components.basis_count import CompressOptions

with run_rule(snakemake) as provenance:
    options = dict(snakemake.params.compress)
    irradiance = IrradianceMap.of(options.pop("irradiance"))
    gloss_maps = options.pop("gloss_maps")
    definition = snakemake.params.definition
    stated = replace(provenance, made_of=made_of(definition, snakemake.input.user_files))
    common = snakemake.output.environment, CompressOptions(**options), irradiance, stated
    source = typed_source(definition["source"])
    image = Size.of(definition["image"]) if definition["image"] else None
    if snakemake.params.photographed:
        files = snakemake.input.linear, snakemake.input.calibration
        charts = {
            name: (file, Chart.of(chart))
            for (name, chart), file in zip(definition["room_charts"].items(), snakemake.input.room_charts, strict=True)
        }
        told = {"room_charts": charts, "lamps": definition["lamps"]}
        told["lamps_error_percent"] = definition["lamps_error_percent"]
        prepare_environment(*files, *common, source=source, image=image, gloss_maps=gloss_maps, **told)
    else:
        make_environment(source, image, *common, gloss_maps=gloss_maps)
