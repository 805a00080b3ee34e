from irodori.config.definition import as_plain
from irodori.config.definitions import load_definitions
from irodori.config.photograph_sets import PhotographSets, material_definition, material_files
from irodori.config.reports import Reports
from irodori.config.scene_files import SceneFiles
from irodori.core.errors import InputError
from irodori.core.ledger import Ledger
from irodori.core.provenance import code_hash, modules_of

try:
    # The repository's own file first, then those of the command line, which override it.
    files = sorted(map(str, workflow.configfiles), key=lambda file: file != "config/config.yaml")
    loaded = load_definitions(config, Path(), files)
    # Apart from their scenes: other words change no picture.
    words = {
        name: {"description": one.description, "lesson": as_plain(one.lesson)} for name, one in loaded.scenes.items()
    }
    loaded = loaded.without_descriptions()
    plain = loaded.plain()
    config.update(plain.pop("config"), **plain, words=words)  # where `lookup` finds them, with every default
    for scene in config["scenes"].values():
        scene.pop("lesson", None)
    sets = PhotographSets(loaded)
    scenes = SceneFiles(sets)
    reports = Reports(scenes)
except InputError as error:
    raise WorkflowError(str(error)) from None

#: The user's own files are inputs `user_files`, whose time counts for nothing; the hash of their content is a parameter.
ledger = Ledger("results/inputs.json")

#: Stages whose speed and error `snakemake benchmark` measures; each is a module of benchmarks/.
BENCHMARKS = ["ingest", "calibrate", "fit", "compress", "light", "environment", "render", "reference", "plan", "viewer"]


def any_of(names):
    """Return the regular expression of some names; of none, one that nothing matches."""
    return "|".join(dict.fromkeys(names)) or "(?!)"


def tests_of_stability(wildcards):
    """Return the tests, of which the hard cases are tried."""
    return sorted(map(str, Path(REPOSITORY, "tests").rglob("*.py")))


def intermediate(files):
    """Return output files that are removed after their last use, unless the configuration keeps them."""
    return files if config["keep_intermediate"] else temp(files)
