"""Workflow Run RO-Crate of a run: its inputs, results, software, times and licence, as JSON-LD.

The profiles are RO-Crate 1.1, Process Run Crate 0.5, Workflow Run Crate 0.5 and Workflow RO-Crate 1.0. The graph is a
list of plain dictionaries; a library for crates would add nothing that is needed here. Files are named by their paths
relative to the project's folder. Their hashes are those of whole files, as ``sha256sum`` prints them. Before, every
result is compared with the hash that its rule recorded.
"""

import base64
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from irodori import __version__
from irodori.config.definitions import KINDS
from irodori.config.loaded import Loaded
from irodori.config.orcid import orcid_address
from irodori.config.photograph_sets import PhotographSets
from irodori.config.project import configuration_files, load_project
from irodori.config.reports import Reports
from irodori.config.scene_files import SceneFiles
from irodori.core import custody, store
from irodori.core.atomic_files import file_sha256
from irodori.core.errors import InputError, PlainError

METADATA = "ro-crate-metadata.json"
WORKFLOW = "workflow/Snakefile"
_RESULTS = "results"
_RECORDS = ".snakemake/metadata"
_PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": ("Process Run Crate", "0.5"),
    "https://w3id.org/ro/wfrun/workflow/0.5": ("Workflow Run Crate", "0.5"),
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": ("Workflow RO-Crate", "1.0"),
}
_OWN_LICENCE = "https://spdx.org/licenses/BSD-3-Clause"
_CONTEXT = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "http://schema.org/sha256"}]
_PARAMETER = "https://bioschemas.org/profiles/FormalParameter/1.0-RELEASE"
_FORMATS = {
    ".h5": "application/x-hdf5", ".exr": "image/x-exr", ".png": "image/png", ".tif": "image/tiff", ".html": "text/html",
    ".csv": "text/csv", ".json": "application/json", ".yaml": "application/yaml", ".dng": "image/x-adobe-dng",
    ".py": "text/x-python", ".smk": "text/plain", ".rst": "text/x-rst", ".payload": "text/plain", "": "text/plain",
}  # fmt: skip
#: Final outputs of the workflow: name of the formal parameter, and its description.
_OUTPUTS = {
    "pictures": "Pictures of the scenes",
    "materials": "Materials of the objects",
    "environments": "Light of the environments",
    "pages": "Report and classroom pages",
    "tables": "Tables of figures and errors",
}
_BY_SUFFIX = {".exr": "pictures", ".png": "pictures", ".tif": "pictures", ".html": "pages", ".csv": "tables"}
#: Packages whose installed versions are listed in addition to those recorded in the results.
_TOLD = ("snakemake", "numba", "scipy", "opencv-python", "OpenImageIO", "rawpy", "embreex", "nlopt", "colour-science")


@dataclass(frozen=True)
class Job:
    """A job of the workflow as Snakemake recorded it.

    Parameters
    ----------
    rule : str
    start_s, end_s : float
        Seconds since 1970, UTC.
    inputs, outputs : tuple of str
        Paths relative to the project's folder.
    """

    rule: str
    start_s: float
    end_s: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def jobs_of(project: Path) -> list[Job]:
    """Return the jobs whose outputs exist in a project, in the order in which they began.

    Raises
    ------
    InputError
        If Snakemake's records of the jobs are missing or cannot be read.
    """
    folder = project / _RECORDS
    found: dict[tuple, list[tuple[float, str]]] = {}
    for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
        if not path.is_file():
            continue
        try:
            # Snakemake splits long names over folders that begin with @.
            coded = "".join(part.removeprefix("@") for part in path.relative_to(folder).parts)
            output = base64.urlsafe_b64decode(coded).decode()
            note = json.loads(path.read_bytes())
            # Of the outputs of one job Snakemake notes starts that are some tenths of a millisecond apart.
            start_s = float(note["starttime"])
            key = (note["rule"], float(note["endtime"]), tuple(sorted(note["input"] or ())))
        except (ValueError, KeyError, TypeError):
            raise InputError(path, "", "a note of a job that cannot be read", "those that Snakemake wrote") from None
        if (project / output).exists():
            found.setdefault(key, []).append((start_s, output))
    if not found:
        raise InputError(folder, "", "no notes of jobs", "those of the folder in which snakemake ran")
    jobs = [
        Job(rule, min(starts), end, inputs, tuple(sorted(outputs)))
        for (rule, end, inputs), made in found.items()
        for starts, outputs in [zip(*made, strict=True)]
    ]
    return sorted(jobs, key=lambda job: (job.start_s, job.outputs))


@dataclass(frozen=True)
class RunFiles:
    """Files of a run: path in the crate -> SHA-256 of the whole file, 64 hexadecimal digits.

    All but the workflow lie under the same path in the project's folder. The workflow may lie elsewhere: ``snakefile``
    is ``workflow/Snakefile`` of the crate, and the other files are where they are relative to it.
    """

    project: Path
    snakefile: Path
    workflow: Mapping[str, str]
    settings: Mapping[str, str]
    given: Mapping[str, str]
    results: Mapping[str, str]

    def path(self, name: str) -> Path:
        """Return where a file of the crate lies."""
        if name == WORKFLOW:
            return self.snakefile
        if name in self.workflow:
            return self.snakefile.parent / PurePosixPath(name).relative_to("workflow")
        return self.project / name

    @property
    def all(self) -> dict[str, str]:
        """All files of the run."""
        return {**self.workflow, **self.settings, **self.given, **self.results}


def collect(
    project: Path, configuration: Iterable[str], snakefile: Path, loaded: Loaded, jobs: Iterable[Job]
) -> RunFiles:
    """Find the files of a configuration's run, and compare inputs and results with the hashes recorded for them.

    The results are those that the configuration asks for, those from which they were made, and the other outputs of the
    same jobs.

    Parameters
    ----------
    project : path
        The folder in which snakemake ran, which is the working directory.
    configuration : iterable of str
        Configuration files.
    snakefile : path
        The workflow's Snakefile.
    loaded : Loaded
        Configuration and definitions.
    jobs : iterable of Job
        All jobs that ran in the project.

    Raises
    ------
    InputError
        If a result is missing, or a file lies outside the project's folder.
        If a material or a light was made of another definition than today's.
    PlainError
        If a result is not as its rule wrote it, or a file from which it was made is missing or has changed since.
    """
    targets = [project / file for file in Reports(SceneFiles(PhotographSets(loaded))).targets()]
    for path in targets:
        if not path.is_file():
            accepted = "a finished run of this configuration: snakemake --cores 2 --configfile=FILE"
            raise InputError(path.relative_to(project), "", "no such file", accepted)
    chain = custody.Chain(project / _RESULTS)
    asked = {_inside(path, project) for path in chain.made_from(targets)[0]}
    beside = (project / name for job in jobs if not asked.isdisjoint(job.outputs) for name in job.outputs)
    wanted = {*targets, *(path for path in beside if path.is_file())}
    for broken in chain.broken(sorted(wanted)):
        raise PlainError(broken)
    made, given = chain.made_from(wanted)
    configuration = list(configuration)
    _refuse_edited(loaded, {_inside(path, project) for path in made}, configuration)
    kinds = ((kind, name) for kind in KINDS for name in getattr(loaded, kind))
    definitions = (f"{loaded.config.definitions}/{kind}/{name}.yaml" for kind, name in kinds)
    settings = [project / name for name in (*configuration, *definitions)]

    def hashed(paths: Iterable[Path]) -> dict[str, str]:
        return {_inside(path, project): file_sha256(path) for path in paths}

    workflow = {_in_crate(path, snakefile): file_sha256(path) for path in workflow_files(snakefile)}
    return RunFiles(project, snakefile, workflow, hashed(settings), hashed(given), hashed(made))


def _refuse_edited(loaded: Loaded, made: set[str], configuration: list[str]) -> None:
    """Raise `InputError` if a material or a light was made of another definition than the one in the crate."""
    from irodori.export.export_sources import light_of, material_of  # slow to import

    for name in loaded.objects:
        if f"results/{name}/material.h5" in made:
            material_of(loaded, name, configuration)
    for name in loaded.environments:
        if f"results/environments/{name}.h5" in made:
            light_of(loaded, name, configuration)


def _in_crate(path: Path, snakefile: Path) -> str:
    """Return the path that a file of the workflow has in the crate."""
    return WORKFLOW if path == snakefile else f"workflow/{path.relative_to(snakefile.parent).as_posix()}"


def _inside(path: Path, project: Path) -> str:
    """Return the path of a file relative to the project's folder; raise `InputError` if it lies elsewhere."""
    try:
        return path.absolute().relative_to(project).as_posix()
    except ValueError:
        accepted = "files in the project's folder, which a crate is made of"
        raise InputError(path, "", "a file elsewhere", accepted) from None


def _identifier(name: str) -> str:
    return quote(name)


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")


def _reference(*identifiers: str):
    """Return a JSON-LD reference to one entity, or a list of references to several."""
    found = [{"@id": identifier} for identifier in identifiers]
    return found[0] if len(found) == 1 else found


def _pointing(key: str, identifiers: Iterable[str]) -> dict:
    """Return a JSON-LD property that refers to entities; an empty dictionary if there are none."""
    found = list(identifiers)
    return {key: _reference(*found)} if found else {}


def _output_kind(name: str) -> str | None:
    """Return the name of the formal parameter to which a result belongs; None for files between stages."""
    path = PurePosixPath(name)
    if path.name == "material.h5":
        return "materials"
    if path.suffix == ".h5":
        return "environments" if path.parent.name == "environments" else None
    return _BY_SUFFIX.get(path.suffix)


def _versions(files: RunFiles) -> Iterator[tuple[str, str]]:
    """Yield name and version of software: packages recorded in the results, then others that are installed here."""
    made: dict[str, set[str]] = {}
    for name in files.results:
        if name.endswith(".h5"):
            with store.open_unread(files.project / name) as file:
                for package, number in file.attribute("created_by", dict).items():
                    made.setdefault(package, set()).add(str(number))
    for package in sorted(made.keys() - {"irodori"}):
        yield package, ", ".join(sorted(made[package]))
    for package in (package for package in _TOLD if package not in made):
        try:
            yield package, version(package)
        except PackageNotFoundError:
            continue


def describe(files: RunFiles, jobs: list[Job], loaded: Loaded) -> dict:
    """Assemble the content of ``ro-crate-metadata.json``.

    Parameters
    ----------
    files : RunFiles
    jobs : list of Job
    loaded : Loaded

    Returns
    -------
    dict
        JSON-LD: context and graph.
    """
    graph: list[dict] = []
    publication, config = loaded.config.publication, loaded.config
    person = _person(publication)
    licence = _licence(publication.licence)
    software = [
        {"@id": f"#software-{name}", "@type": "SoftwareApplication", "name": name, "softwareVersion": number}
        for name, number in _versions(files)
    ]  # fmt: skip
    own = {
        "@id": "#software-irodori", "@type": "SoftwareApplication", "name": "irodori", "softwareVersion": __version__,
        **_pointing("softwareRequirements", (one["@id"] for one in software)),
    }  # fmt: skip
    inputs = {"settings": ("Configuration and definitions", files.settings),
              "photographs": ("Photographs and measured files", files.given)}  # fmt: skip
    made = {kind: [name for name in files.results if _output_kind(name) == kind] for kind in _OUTPUTS}
    outputs = {kind: (title, made[kind]) for kind, title in _OUTPUTS.items()}
    parameters: list[dict] = []
    example_of: dict[str, str] = {}
    for kind, (title, names) in {**inputs, **outputs}.items():
        if names:
            identifier = f"#parameter-{kind}"
            parameters.append({
                "@id": identifier, "@type": "FormalParameter", "conformsTo": _reference(_PARAMETER), "name": kind,
                "description": title, "additionalType": "File", "multipleValues": "True", "valueRequired": "True",
                **_pointing("workExample", map(_identifier, names)),
            })  # fmt: skip
            example_of |= dict.fromkeys(names, identifier)
    known = {one["@id"] for one in parameters}
    main = {
        "@id": WORKFLOW, "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"], "name": "Irodori",
        "description": "From RAW photographs of a real object to its picture under any light", "version": __version__,
        "license": _reference(_OWN_LICENCE), "programmingLanguage": _reference("#snakemake"),
        "conformsTo": _reference("https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE"),
        **_pointing("input", (i for kind in inputs if (i := f"#parameter-{kind}") in known)),
        **_pointing("output", (i for kind in outputs if (i := f"#parameter-{kind}") in known)),
        **_content(files, WORKFLOW),
    }  # fmt: skip
    entities = [_file(files, name, example_of) for name in sorted(files.all) if name != WORKFLOW]
    actions = [*_actions(files, jobs, made, person)]
    end = max(job.end_s for job in jobs)
    devices = list(_devices(loaded))
    root = {
        "@id": "./", "@type": "Dataset", "conformsTo": [_reference(profile) for profile in _PROFILES],
        "name": f"Irodori: {', '.join(config.make.scenes or config.make.cameras) or 'a run'}",
        "description": "Photographs of real objects, their spectral reflectance and gloss, and pictures of them.",
        "datePublished": _time(end), "license": _reference(licence["@id"]),
        "mainEntity": _reference(WORKFLOW), **_pointing("hasPart", map(_identifier, sorted(files.all))),
        **_pointing("mentions", (one["@id"] for one in (*actions, *devices))),
    }  # fmt: skip
    if person is not None:
        root["author"] = _reference(person["@id"])
    descriptor = {
        "@id": METADATA, "@type": "CreativeWork", "about": _reference("./"),
        "conformsTo": [_reference("https://w3id.org/ro/crate/1.1"), _reference(list(_PROFILES)[-1])],
    }  # fmt: skip
    profiles = (
        {"@id": address, "@type": "CreativeWork", "name": name, "version": number}
        for address, (name, number) in _PROFILES.items()
    )
    language = {"@id": "#snakemake", "@type": "ComputerLanguage", "name": "Snakemake",
                "identifier": "https://w3id.org/workflowhub/workflow-ro-crate#snakemake",
                "url": "https://snakemake.readthedocs.io"}  # fmt: skip
    own_licence = {"@id": _OWN_LICENCE, "@type": "CreativeWork", "name": "BSD 3-Clause"}
    graph += [descriptor, root, *profiles, main, language, own_licence, licence, own, *software]
    graph += [*([person] if person else []), *parameters, *devices, *actions, *entities]
    return {"@context": _CONTEXT, "@graph": graph}


def _content(files: RunFiles, name: str) -> dict[str, str]:
    kind = _FORMATS.get(PurePosixPath(name).suffix.lower(), "application/octet-stream")
    size = files.path(name).stat().st_size
    return {"encodingFormat": kind, "contentSize": str(size), "sha256": files.all[name]}


def _file(files: RunFiles, name: str, example_of: Mapping[str, str]) -> dict:
    found: dict = {"@id": _identifier(name), "@type": "File", "name": PurePosixPath(name).name}
    found |= _content(files, name)
    if name in example_of:
        found["exampleOfWork"] = _reference(example_of[name])
    return found


def _actions(files: RunFiles, jobs: list[Job], made: Mapping[str, list[str]], person: dict | None) -> Iterator[dict]:
    """Yield the action of the whole run, then those of its jobs."""
    agent = {} if person is None else {"agent": _reference(person["@id"])}
    status = {"actionStatus": "http://schema.org/CompletedActionStatus"}
    yield {
        "@id": "#run", "@type": "CreateAction", "name": "The run", "description": "All jobs of the workflow together",
        "instrument": _reference(WORKFLOW), **agent, **status,
        "startTime": _time(min(job.start_s for job in jobs)), "endTime": _time(max(job.end_s for job in jobs)),
        **_pointing("object", map(_identifier, (*files.settings, *files.given))),
        **_pointing("result", (_identifier(name) for names in made.values() for name in names)),
    }  # fmt: skip
    known = files.all
    for number, job in enumerate(jobs):
        outputs = [name for name in job.outputs if name in known]
        if outputs:
            yield {
                "@id": f"#job-{number}", "@type": "CreateAction", "name": f"{job.rule}: {outputs[0]}",
                "description": f"A job of the rule {job.rule}", "instrument": _reference("#software-irodori"),
                **agent, **status, "startTime": _time(job.start_s), "endTime": _time(job.end_s),
                **_pointing("object", (_identifier(name) for name in job.inputs if name in known)),
                **_pointing("result", map(_identifier, outputs)),
            }  # fmt: skip


def _person(publication) -> dict | None:
    if publication.photographer is None and publication.photographer_orcid is None:
        return None
    orcid = publication.photographer_orcid
    identifier = "#photographer" if orcid is None else orcid_address(orcid)
    return {"@id": identifier, "@type": "Person", "name": publication.photographer or identifier}


def _licence(stated: str | None) -> dict:
    if stated is None:
        said = "No licence was stated: all rights remain with their owners."
        return {"@id": "#licence", "@type": "CreativeWork", "name": "No licence stated", "description": said}
    is_address = stated.startswith(("https://", "http://"))
    return {"@id": stated if is_address else "#licence", "@type": "CreativeWork", "name": stated, "description": stated}


def _devices(loaded: Loaded) -> Iterator[dict]:
    """Yield the cameras and rigs as entities that refer to their definition files."""
    for kind in ("cameras", "rigs"):
        for name, definition in getattr(loaded, kind).items():
            described = {"description": text} if (text := getattr(definition, "description", None)) else {}
            file = f"{loaded.config.definitions}/{kind}/{name}.yaml"
            identifier = f"#{kind.removesuffix('s')}-{name}"
            of = {"subjectOf": _reference(_identifier(file))}
            yield {"@id": identifier, "@type": "IndividualProduct", "name": name, **described, **of}


def workflow_files(snakefile: Path) -> list[Path]:
    """Return the paths of a Snakefile and of the rules, scripts and captions in the folders beside it.

    Raises
    ------
    InputError
        If the Snakefile does not exist.
    """
    if not snakefile.is_file():
        raise InputError(snakefile, "", "no such file", "the workflow's Snakefile, which --snakefile names")
    beside = (snakefile.parent / folder for folder in ("rules", "scripts", "report"))
    return [snakefile, *(path for folder in beside for path in sorted(folder.glob("*.*")) if path.is_file())]


def find_snakefile(project: Path, given: Path | None = None) -> Path:
    """Return the path of a run's Snakefile: the given one, or else that of the project, or that beside this package."""
    beside = Path(__file__).resolve().parents[2] / WORKFLOW
    own = project / WORKFLOW
    return given or (own if own.is_file() or not beside.is_file() else beside)


def run_crate(configuration: list[str], snakefile: Path | None = None) -> tuple[dict, RunFiles]:
    """Return the metadata of the crate of a configuration's finished run, and the files of the run.

    Parameters
    ----------
    configuration : list of str
        Configuration files that override the default one; the working directory is the project's folder.
    snakefile : path, optional
        The workflow's Snakefile, see `find_snakefile`.

    Raises
    ------
    InputError
        If a configuration file, the workflow or Snakemake's records are missing; see `collect` and `jobs_of`.
    """
    project = Path.cwd()
    loaded = load_project(configuration)
    jobs = jobs_of(project)
    files = collect(project, configuration_files(configuration), find_snakefile(project, snakefile), loaded, jobs)
    own = [job for job in jobs if not files.results.keys().isdisjoint(job.outputs)]
    return describe(files, own, loaded), files
