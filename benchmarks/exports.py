"""Benchmark of exports and pictures of the default scene in every format: loss, size and processor time.

``python -m benchmarks.exports [--results FOLDER]`` at the top of the repository, after ``snakemake --cores 2``: writes
``exports.csv`` into the results' folder ``benchmark``, which `benchmarks.published_tables` shows in docs/exports.md.
Times are processor times of this process and its child processes, without imports; each export is made once.
"""

import argparse
import csv
import os
import resource
import shlex
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.written_pictures import loss_stated_in, spectra_in
from irodori.colour.colorimetry import delta_e, delta_e_reflectance, lab_from_xyz, xyz_from_radiance
from irodori.config.definitions import load_definitions
from irodori.core.atomic_files import written_whole
from irodori.core.yaml_files import read_yaml
from irodori.export.export_command import command_parser, export_named
from irodori.export.loss import Loss, Losses
from irodori.light.environment_file import Environment
from irodori.light.omnidirectional import to_panorama
from irodori.material.material_file import Material
from irodori.rendering.stage import write_tiff, write_xyz

COLUMNS = ("export", "compared", "count", "mean", "p95", "max", "mb", "cpu_s")
SCENE, OBJECT, LIGHT, VIEW = "still-life", "tile-plate", "classroom", "front"
CALLS = (
    f"{SCENE} --to gltf",
    f"{SCENE} --to mitsuba",
    f"{OBJECT} --to tiff",
    f"{OBJECT} --to tiff --illuminant A",
    f"{OBJECT} --to tiff --illuminant D65 --display 'Adobe RGB (1998)'",
    f"{OBJECT} --to spectral-exr",
    f"{OBJECT} --to envi",
    f"{LIGHT} --to spectral-exr",
    f"{LIGHT} --to envi",
)
#: Pictures of a view that are made on request -> functions that write them.
ON_REQUEST = {"tif": write_tiff, "xyz.exr": write_xyz}
_PICTURE = "every pixel"


def processor_s() -> float:
    """Return the processor time of this process and its finished child processes, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def size_mb(path: Path) -> float:
    """Return the size of an export on disk without its preview, MB."""
    files = list(path.iterdir()) if path.is_dir() else [path]
    if path.suffix == ".img":
        files += [path.with_suffix(".hdr"), path.with_name(f"{path.stem}-maps.img")]
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def of_spectra(read: Callable[[], np.ndarray], material: Material) -> Loss:
    """Return the loss of a material's spectra (h, w, 61) that were read back from an export."""
    diffuse = material.spectrum_scale[..., None] * material.spectra().astype(np.float64)
    return Loss.of(delta_e_reflectance(diffuse, read())[material.observed])


def of_light(read: Callable[[], np.ndarray], light: Environment) -> Loss:
    """Return the loss of a panorama's radiance (h, w, 61) that was read back; white is a diffuser that faces up."""
    white = light.upward_white()
    matrix = xyz_from_radiance(white)
    exact = to_panorama(light.coefficients.astype(np.float64)) @ light.basis.T
    labs = (lab_from_xyz(radiance @ matrix.T, matrix @ white) for radiance in (exact, read().astype(np.float64)))
    return Loss.of(delta_e(*labs))


def envi_spectra(path: Path) -> np.ndarray:
    """Return the spectra in an ENVI file, (h, w, 61)."""
    from spectral.io import envi

    return np.asarray(
        envi.open(str(path.with_suffix(".hdr")), str(path)).open_memmap(interleave="bip"), dtype=np.float64
    )


def measured(call: str, folder: Path) -> list[dict]:
    """Make an export in a folder and return its rows of the table."""
    given = command_parser("export").parse_args(shlex.split(call))
    path = folder / f"{given.source}-{given.to}"
    suffix = {"gltf": ".glb", "tiff": ".tif", "spectral-exr": ".exr", "envi": ".img"}.get(given.to, "")
    start = processor_s()
    path, losses = export_named(given.source, path.with_suffix(suffix), given)
    seconds = processor_s() - start
    if given.to in ("spectral-exr", "envi"):
        layers = "S0" if given.source == LIGHT else "T"
        read = (lambda: spectra_in(path, layers)[1]) if given.to == "spectral-exr" else (lambda: envi_spectra(path))
        if given.source == LIGHT:
            light = Environment.load(f"results/environments/{LIGHT}.h5")
            losses = {"light of every direction, read back": of_light(read, light)}
        else:
            material = Material.load(f"results/{given.source}/material.h5")
            losses = {"spectra read back, under D65": of_spectra(read, material)}
    return _rows(call.replace("--to ", ""), losses, path, seconds)


def pictures(folder: Path) -> list[dict]:
    """Return the table's rows for the pictures of a view: those of every run and those made on request."""
    run = Path(f"results/{SCENE}")
    rows = []
    for kind in ("exr", "png"):
        path = run / f"{VIEW}.{kind}"
        rows += _rows(str(path), {_PICTURE: loss_stated_in(path)}, path, None)
    scene = load_definitions(read_yaml("config/config.yaml") | {"make": {"scenes": [SCENE]}}, Path()).scenes[SCENE]
    for kind, write in ON_REQUEST.items():
        path, start = folder / f"{VIEW}.{kind}", processor_s()
        write(scene, run / f"{VIEW}.exr", f"results/environments/{scene.environment}.h5", path)
        seconds = processor_s() - start
        rows += _rows(f"{run}/{VIEW}.{kind}", {_PICTURE: loss_stated_in(path)}, path, seconds)
    return rows


def _rows(export: str, losses: Losses, path: Path, seconds: float | None) -> list[dict]:
    cost = {"mb": f"{size_mb(path):.4g}", "cpu_s": "" if seconds is None else f"{seconds:.3g}"}
    found = []
    for what, loss in losses.items():
        figures = loss.figures() if isinstance(loss, Loss) else {"count": loss}
        found.append({"export": export, "compared": what, **figures, **cost})
    return found


def main() -> None:
    """Run the benchmark and write its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results"))
    out = parser.parse_args().results.resolve() / "benchmark" / "exports.csv"
    os.chdir(out.parents[2])
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for call in CALLS for row in measured(call, Path(folder))] + pictures(Path(folder))
    out.parent.mkdir(exist_ok=True)
    with written_whole(out) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(out)


if __name__ == "__main__":
    main()
