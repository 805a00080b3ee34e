from dataclasses import asdict
from typing import NamedTuple

from irodori.config.capture_table import read_captures
from irodori.config.definitions import captures_of, is_taken_here, is_virtual, load_definitions
from irodori.core.errors import InputError
from irodori.geometry.mesh_sources import shape_files
from irodori.geometry.shape_blocks import is_flat
from irodori.core.provenance import code_hash, modules_of
from irodori.spectra.spectral_files import SUFFIXES
from irodori.rectification.texture_tiles import tile_rows

try:
    # The repository's own file first, then those of the command line, which override it.
    files = sorted(map(str, workflow.configfiles), key=lambda file: file != "config/config.yaml")
    config.update(load_definitions(config, Path(), files))
    CAPTURES = {
        kind: {name: captures_of(config, kind, name) for name in config[kind]}
        for kind in ("objects", "cameras", "environments")
    }
except InputError as error:
    raise WorkflowError(str(error)) from None

FOLDER = {"objects": "results", "cameras": "results/cameras", "environments": "results/environments"}
ROLES = {"objects": ["object"], "cameras": ["chart", "white", "dark"], "environments": ["environment"]}
SET_OF = {"object": "objects", "camera": "cameras", "environment": "environments"}


def capture_set(wildcards):
    """Return kind and name of the set of captures that a job's wildcards name."""
    return next((kind, getattr(wildcards, key)) for key, kind in SET_OF.items() if hasattr(wildcards, key))


def captures_table(wildcards):
    """Return the capture table of a set: the virtual rig's, or the user's own."""
    kind, name = capture_set(wildcards)
    if is_virtual(config, kind, name):
        return f"{FOLDER[kind]}/{name}/captures/captures.csv"
    return config[kind][name]["captures"]["table"]


def captures_made(wildcards):
    """Return the file that says that a set's photographs are there: a session's record, or the user's own table."""
    kind, name = capture_set(wildcards)
    if is_taken_here(config, kind, name):
        return f"{FOLDER[kind]}/{name}/captures/session.json"
    return captures_table(wildcards)


def captures_folder(wildcards):
    """Return the folder of a set's RAW files."""
    kind, name = capture_set(wildcards)
    own = {} if is_virtual(config, kind, name) else config[kind][name]["captures"]
    return own.get("folder") or str(Path(captures_table(wildcards)).parent)


def raw_files(wildcards):
    """Return a user's RAW files; those of a session stand in its capture table with their hashes."""
    kind, name = capture_set(wildcards)
    if is_taken_here(config, kind, name):
        return []
    shots = read_captures(captures_table(wildcards), captures_folder(wildcards))
    return [f"{captures_folder(wildcards)}/{shot.file}" for shot in shots if shot.role in ROLES[kind]]


def rigs_taken(wildcards):
    """Return 1 where a session moves a real rig, of which there is one at a time, 0 on a virtual one."""
    return int(config["rigs"][rig_of(wildcards)]["kind"] == "driven")


def roles_of(wildcards):
    """Return the roles whose shots belong to a set."""
    return ROLES[capture_set(wildcards)[0]]


def mosaic_size(wildcards):
    """Return width and height in pixels that a set's RAW files must have, where its definition states them."""
    kind, name = capture_set(wildcards)
    if kind == "environments":
        equirectangular = config[kind][name]["source"]["kind"] == "captures"
        image = config[kind][name].get("image") if equirectangular else None
        return [2 * image["width"], 2 * image["height"]] if image else None
    optics = config["cameras"][camera_of(wildcards)].get("optics")
    return [optics["width_px"], optics["height_px"]] if optics else None


def named_tables(*values):
    """Return the user's tables that definitions name, so that a change of one is seen."""
    found = []
    for value in values:
        if isinstance(value, dict):
            found += named_tables(*value.values())
        elif isinstance(value, list):
            found += named_tables(*value)
        elif isinstance(value, str) and value.lower().endswith(SUFFIXES):
            found.append(value)
    return found


def meshes_of(*names):
    """Return the files of the meshes among objects; a changed one is seen."""
    shapes = [config["objects"][name]["shape"] for name in names]
    return [file for shape in shapes for file in shape_files(shape)]


def mesh_of(wildcards):
    """Return the files of an object's mesh."""
    return meshes_of(wildcards.object)


def mesh_of_capture(wildcards):
    """Return the files of the mesh that the virtual rig photographs; a real one reads none."""
    return mesh_of(wildcards) if is_virtual(config, "objects", wildcards.object) else []


def white_pose(wildcards):
    """Return the pose of the white reference of a set's camera, degrees, None where it has none."""
    name = camera_of(wildcards)
    camera = config["cameras"][name]
    if "poses" in camera:
        return camera["poses"].get("white")
    whites = [shot.pose for shot in read_captures(camera["captures"]["table"]) if shot.role == "white"]
    return asdict(whites[0]) if whites else None


def tables_of_capture(wildcards):
    """Return the tables of spectra that the virtual rig reads for a set; a real one reads none."""
    kind, name = capture_set(wildcards)
    if not is_virtual(config, kind, name):
        return []
    return named_tables(config[kind][name], definition_of("cameras")(wildcards), definition_of("rigs")(wildcards))


def tables_of_calibration(wildcards):
    """Return the tables of spectra that a calibration reads."""
    camera = config["cameras"][wildcards.camera]
    return named_tables(camera["chart"], camera["further_charts"], config["rigs"][camera["rig"]]["light"])


def chart_files(wildcards):
    """Return the linear files of a camera's charts, the first chart's first."""
    return expand(
        "results/cameras/{camera}/linear/{chart}.h5",
        camera=wildcards.camera,
        chart=CAPTURES["cameras"][wildcards.camera],
    )


def tables_of_white(wildcards):
    """Return the table of the white reference's spectrum, where it has one."""
    return named_tables(config["cameras"][wildcards.camera].get("white"))


def tables_of_index(wildcards):
    """Return the table of an object's refractive index, where it has one."""
    return named_tables(config["objects"][wildcards.object]["refractive_index"])


def calibration_of_index(wildcards):
    """Return the calibration of an object's camera, as a list, where its refractive index varies with the wavelength."""
    if not tables_of_index(wildcards):
        return []
    return [f"results/cameras/{camera_of(wildcards)}/calibration.h5"]


def checked_table(wildcards):
    """Return the table of a set after every file of it was decoded once."""
    kind, name = capture_set(wildcards)
    return f"{FOLDER[kind]}/{name}/captures.csv"


def camera_of(wildcards):
    """Return the camera of a set of captures."""
    kind, name = capture_set(wildcards)
    return name if kind == "cameras" else config[kind][name]["camera"]


def rig_of(wildcards):
    """Return the rig of a set of captures."""
    return config["cameras"][camera_of(wildcards)]["rig"]


def of_camera(dpath, default=None):
    """Return a function from wildcards to a value of the set's camera."""
    return lambda wildcards: lookup(within=config["cameras"][camera_of(wildcards)], dpath=dpath, default=default)


def of_rig(dpath):
    """Return a function from wildcards to a value of the set's rig."""
    return lambda wildcards: lookup(within=config["rigs"][rig_of(wildcards)], dpath=dpath)


def definition_of(kind):
    """Return a function from wildcards to the whole definition of the camera or the rig."""
    name = {"cameras": camera_of, "rigs": rig_of}[kind]
    return lambda wildcards: config[kind][name(wildcards)]


def light_place(wildcards):
    """Return what a rig's definition says of the place of its light; nothing for a far one."""
    light = config["rigs"][rig_of(wildcards)]["light"]
    return {key: light[key] for key in ("distance_mm",) if key in light}


def camera_file(pattern):
    """Return a function from wildcards to a file of the set's camera."""
    return lambda wildcards: pattern.format(camera=camera_of(wildcards))


def photographed(wildcards):
    """Return the parts of an object's definition that a photograph depends on."""
    parts = ("shape", "refractive_index", "mirror_weight", "poses", "exposure_s", "virtual")
    definition = config["objects"][wildcards.object]
    return {key: definition[key] for key in parts if key in definition}


def imperfect_object(wildcards):
    """Return the object on which the faults of the virtual rig are measured, a plate if there is one; None without."""
    known = virtual("objects")
    if not known:
        return None
    name = next((n for n in known if is_flat(config["objects"][n]["shape"]["kind"])), known[0])
    definition = config["objects"][name]
    camera = config["cameras"][definition["camera"]]
    return {"name": name, "definition": definition, "camera": camera, "rig": config["rigs"][camera["rig"]]}


def mesh_of_imperfections(wildcards):
    """Return the files of the mesh that the measurement of the faults reads."""
    subject = imperfect_object(wildcards)
    return meshes_of(subject["name"]) if subject else []


def tables_of_imperfections(wildcards):
    """Return the tables of spectra that the measurement of the faults reads."""
    subject = imperfect_object(wildcards) or {}
    return named_tables(*(subject[key] for key in ("definition", "camera", "rig") if key in subject))


def plates(wildcards):
    """Return what the simulation of poses needs to know of every plate."""
    found = {}
    for name, definition in config["objects"].items():
        if not is_flat(definition["shape"]["kind"]):
            continue
        camera = config["cameras"][definition["camera"]]
        exposures = definition.get("exposure_s", {"out": []})
        found[name] = {
            "definition": {key: definition[key] for key in ("shape", "refractive_index", "plan")},
            "rig": config["rigs"][camera["rig"]],
            "sensor": camera.get("virtual", {}).get("sensor"),
            "exposures_s": exposures["out"],
            "shots_per_pose": max(sum(map(len, exposures.values())), 1),
        }
    return found


def tables_of_plates(wildcards):
    """Return the tables of refractive indices of the plates."""
    return named_tables(*(planned["definition"] for planned in plates(wildcards).values()))


def photographed_environment(wildcards):
    """Whether a camera photographed an environment, as against a file of another program or placed lights."""
    return "camera" in config["environments"][wildcards.environment]


def environment_inputs(wildcards):
    """Return the files that an environment's light is made from."""
    source = config["environments"][wildcards.environment]["source"]
    tables = named_tables(source)
    if photographed_environment(wildcards):
        made = {
            "linear": f"results/environments/{wildcards.environment}/linear/environment.h5",
            "calibration": f"results/cameras/{camera_of(wildcards)}/calibration.h5",
        }
    else:
        made = {"picture": source["file"]} if "file" in source else {}
    return made | ({"tables": tables} if tables else {})


class IngestPart(NamedTuple):
    """Captures of an object that one job ingests."""

    object_name: str
    number: str
    captures: list[str]

    @property
    def rule_name(self):
        """The job's rule: names of rules hold no hyphen."""
        return f"ingest_raw_{self.object_name}_{self.number}".replace("-", "_")


#: Stages whose speed and error `snakemake benchmark` measures; each is a module of benchmarks/.
BENCHMARKS = ["ingest", "calibrate", "fit", "compress", "environment", "render", "reference", "plan"]


def ingest_parts():
    """Yield the parts in which the captures of every object are ingested."""
    size = config["ingest"]["captures_per_job"]
    for name, captures in CAPTURES["objects"].items():
        for number, first in enumerate(range(0, len(captures), size)):
            yield IngestPart(name, f"{number:03d}", captures[first : first + size])


def ingest_options(wildcards):
    """Return what ingestion does to a capture."""
    return {key: value for key, value in config["ingest"].items() if key != "captures_per_job"}


def linear_files(wildcards):
    """Return the linear files of all captures of an object."""
    return expand(
        "results/{object}/linear/{capture}.h5", object=wildcards.object, capture=CAPTURES["objects"][wildcards.object]
    )


def tiles_of(wildcards):
    """Return the texture rows of every tile of an object."""
    texels = config["objects"][wildcards.object]["texels"]
    return tile_rows(texels["height"], texels["width"], config["rectify"]["tile_texels"])


def tile_numbers(wildcards):
    """Return the names of an object's tiles."""
    return [f"{number:03d}" for number in range(len(tiles_of(wildcards)))]


def virtual(kind):
    """Return the names of a kind whose ground truth is known."""
    return [name for name in config[kind] if is_virtual(config, kind, name)]


def sessions(wildcards):
    """Return the records of the sessions to hold."""
    return [
        f"{FOLDER[kind]}/{name}/captures/session.json"
        for kind in FOLDER
        for name in config[kind]
        if is_taken_here(config, kind, name)
    ]


def calibrations(wildcards):
    """Return the calibrations to make."""
    return [f"results/cameras/{name}/calibration.h5" for name in config["cameras"]]
