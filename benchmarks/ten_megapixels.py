"""Benchmark of the whole workflow on a ten-megapixel object: time, memory, disk space, and the most expensive rules.

``python -m benchmarks.ten_megapixels [--megapixels 10.1] [--poses 24] [--folder DIR] [--output ten_megapixels.csv]``,
at the top of the repository. The virtual rig photographs a plate in two shots per pose; that takes long and is timed
separately, because a camera would do it. Then Snakemake makes the material, its 61-band picture and its PNG. Times come
from the benchmark files that Snakemake writes for each job of this run. Twice a second, the largest memory that each
job has had so far and the space on the disk, photographs included, are looked at: Snakemake looks at memory every
thirty seconds, which is longer than most jobs reach their largest.
"""

import argparse
import csv
import math
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import yaml

ROOT = Path(__file__).resolve().parents[1]
OBJECT, SCENE, VIEW = "tile-plate", "still-life", "front"
#: What a job may take of memory, MB.
MEMORY_MB = 2048.0
_COLUMNS = ("rule", "jobs", "seconds", "cpu_seconds", "peak_mb", "share")
_TOP = 3


@dataclass(frozen=True)
class Size:
    """Size of the project.

    Parameters
    ----------
    megapixels : float
        Size of a mosaic, and of the object's texture.
    poses : int
        Number of poses, each photographed without and with the comb filter.
    tile_texels : int
    """

    megapixels: float
    poses: int
    tile_texels: int

    @property
    def texels_side(self) -> int:
        """Height and width of the square texture, texels."""
        return round(math.sqrt(self.megapixels * 1e6))


@dataclass(frozen=True)
class Cost:
    """Cost of a rule's jobs: times in s, the largest job's memory in MB."""

    rule: str
    jobs: int
    seconds: float
    cpu_seconds: float
    peak_mb: float


def poses(count: int) -> list[dict]:
    """Return poses, degrees, distributed as equally as possible around the highlights of three lights.

    Raises
    ------
    ValueError
        For fewer than six.
    """
    if count < 6:
        raise ValueError(f"{count} poses; accepted: 6 or more")
    found = []
    for light, number in zip((40.0, 50.0, 60.0), (count // 3 + (i < count % 3) for i in range(3)), strict=True):
        step = 36.0 / (number - 1)
        cameras = [round(light - 24.0 + step * i, 1) for i in range(number)]
        found.append({"light_deg": [light], "camera_deg": cameras})
    return found


def make_project(folder: Path, size: Size) -> None:
    """Write the configuration of one plate, one camera and a room; the field of view is that of the default camera."""
    shutil.copytree(ROOT / "config", folder / "config")
    camera = _read(folder / "config/cameras/d5100-comb.yaml")
    optics, chart = camera["optics"], camera["chart"]
    factor = math.sqrt(size.megapixels * 1e6 / (optics["width_px"] * optics["height_px"]))
    width, height = (2 * round(optics[key] * factor / 2) for key in ("width_px", "height_px"))
    optics |= {"width_px": width, "height_px": height, "pixel_pitch_um": optics["pixel_pitch_um"] / factor}
    optics["principal_point_px"] = [width / 2, height / 2]
    chart["centres_px"] = {k: [round(v * factor, 2) for v in xy] for k, xy in chart["centres_px"].items()}
    chart["patch_px"] = round(chart["patch_px"] * factor)
    _write(folder / "config/cameras/d5100-comb.yaml", camera)
    plate = _read(folder / "config/objects/tile-plate.yaml")
    plate |= {"texels": {"width": size.texels_side, "height": size.texels_side}, "poses": poses(size.poses)}
    _write(folder / "config/objects/tile-plate.yaml", plate)
    scene = _read(folder / "config/scenes/still-life.yaml")
    scene["objects"] = scene["objects"][:1]
    _write(folder / "config/scenes/still-life.yaml", scene)
    config = _read(folder / "config/config.yaml")
    config["rectify"]["tile_texels"] = size.tile_texels
    config |= {"photographed_together": [], "keep_intermediate": False}
    _write(folder / "config/config.yaml", config)


def _read(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _write(path: Path, content: dict) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def run_chain(folder: Path, cores: int, *targets: str) -> float:
    """Run the workflow for targets and return its duration, s.

    Raises
    ------
    RuntimeError
        If it fails; the message has the end of its output.
    """
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", str(cores)]
    begun = time.perf_counter()
    done = subprocess.run([*command, *targets], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(targets)}: {done.stdout[-3000:]}")
    return time.perf_counter() - begun


def photograph(folder: Path, cores: int) -> float:
    """Take all photographs on the virtual rig and return the duration, s."""
    kinds = (OBJECT, "cameras/d5100-comb", "environments/classroom")
    return run_chain(folder, cores, *(f"results/{kind}/captures/session.json" for kind in kinds))


def make_pictures(folder: Path, cores: int) -> float:
    """Run the workflow from photographs to the 61-band picture and return the duration, s."""
    return run_chain(folder, cores, *(f"results/{SCENE}/{VIEW}.{suffix}" for suffix in ("exr", "png")))


def costs(folder: Path, peaks_mb: dict[str, float] | None = None) -> list[Cost]:
    """Return the costs of each rule's jobs, the most expensive rule first; parts of ``ingest_raw`` are one rule.

    ``peaks_mb`` has the largest memory of a rule's jobs where it was looked at.

    Raises
    ------
    ValueError
        If the project has no benchmark files, or one of them lacks the figures of a job.
    """
    jobs: dict[str, list[dict]] = {}
    for path in sorted((folder / "results/benchmarks").glob("*/*.tsv")):
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream, delimiter="\t"))
        if len(rows) != 1:
            raise ValueError(f"{path}: {len(rows)} lines of figures, not one")
        jobs.setdefault(path.parent.name, []).append(rows[0])
    if not jobs:
        raise ValueError(f"{folder}: no benchmark files")
    found = [
        Cost(
            rule,
            len(rows),
            sum(float(row["s"]) for row in rows),
            sum(_number(row["cpu_time"]) for row in rows),
            max((peaks_mb or {}).get(rule, 0.0), *(_number(row["max_rss"]) for row in rows)),
        )
        for rule, rows in jobs.items()
    ]
    return sorted(found, key=lambda cost: -cost.seconds)


def _number(text: str) -> float:
    """Return a number in a benchmark file; Snakemake writes none for a job that ended before its first measurement."""
    return float(text) if text not in ("NA", "-") else 0.0


def disk_mb(folder: Path) -> dict[str, float]:
    """Return the disk space of the results by kind of file, MB, the largest first."""
    found: dict[str, float] = {}
    for path in (folder / "results").rglob("*"):
        try:
            size = path.lstat()
        except FileNotFoundError:
            continue  # a job has just removed or renamed it
        if stat.S_ISREG(size.st_mode):
            kind = path.parent.name if path.parent.name in ("captures", "linear", "observations", "brdf") else path.name
            found[kind] = found.get(kind, 0.0) + size.st_size / 1e6
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def is_of_the_rig(rule: str) -> bool:
    """Return whether a rule takes photographs on the virtual rig."""
    return rule.startswith("capture_")


def report(found: list[Cost], disk: dict[str, float], size: Size, rig_s: float, chain_s: float, output: Path | None):
    """Print the tables, and write that of the rules if there is an output."""
    chain = [cost for cost in found if not is_of_the_rig(cost.rule)]
    total_s = sum(cost.seconds for cost in chain)
    print(f"{size.megapixels} megapixels, {size.poses} poses, two shots, load {os.getloadavg()[0]:.1f}")
    print(f"virtual rig {rig_s:.0f} s; chain from photographs to the picture {chain_s:.0f} s")
    rows = [
        dict(zip(_COLUMNS, (c.rule, str(c.jobs), f"{c.seconds:.2f}", f"{c.cpu_seconds:.2f}", f"{c.peak_mb:.0f}",
                            f"{c.seconds / total_s:.3f}"), strict=True))
        for c in chain
    ]  # fmt: skip
    for row in ({name: name for name in _COLUMNS}, *rows):
        print("  ".join(f"{row[name]:>22}" if name == "rule" else f"{row[name]:>12}" for name in _COLUMNS))
    print("the largest costs: " + ", ".join(f"{c.rule} {100 * c.seconds / total_s:.0f} %" for c in chain[:_TOP]))
    largest = max(chain, key=lambda cost: cost.peak_mb)
    verdict = "within" if largest.peak_mb <= MEMORY_MB else "OVER"
    print(f"peak memory of a job: {largest.peak_mb:.0f} MB ({largest.rule}), {verdict} {MEMORY_MB:.0f} MB")
    print(f"disk {sum(disk.values()):.0f} MB: " + ", ".join(f"{k} {v:.0f}" for k, v in list(disk.items())[:6]))
    if output:
        with output.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, _COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


@dataclass
class Largest:
    """Largest space of the results on the disk, MB, and largest memory of each rule's jobs, MB, so far."""

    disk_mb: float = 0.0
    memory_mb: dict[str, float] = field(default_factory=dict)

    def look(self, folder: Path) -> None:
        """Take what the disk and the running jobs hold now into account."""
        self.disk_mb = max(self.disk_mb, sum(disk_mb(folder).values()))
        for process in psutil.Process().children(recursive=True):
            try:
                script = re.search(r"\.(\w+)\.py$", " ".join(process.cmdline()))
                status = Path(f"/proc/{process.pid}/status").read_text()
            except (psutil.Error, OSError):
                continue  # it has just ended
            if script and (told := re.search(r"VmHWM:\s+(\d+) kB", status)):
                self.memory_mb[script[1]] = max(self.memory_mb.get(script[1], 0.0), int(told[1]) * 1024 / 1e6)


@contextmanager
def looked_at(folder: Path) -> Iterator[Largest]:
    """Yield what becomes the `Largest` of the run while the block runs."""
    largest, ended = Largest(), threading.Event()

    def look() -> None:
        while not ended.wait(0.5):
            largest.look(folder)

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        yield largest
    finally:
        ended.set()
        watcher.join()


@contextmanager
def working_folder(folder: Path | None) -> Iterator[Path]:
    """Yield a new folder for a project: the user's, which is kept, or a temporary one, which is removed at the end.

    Raises
    ------
    FileExistsError
        If the user's folder exists.
    """
    if folder is not None:
        folder.mkdir(parents=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="irodori-") as name:
        yield Path(name)


def main() -> None:
    """Make the project, run it in two parts and print the costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megapixels", type=float, default=10.1, help="of a mosaic and of the texture (default 10.1)")
    parser.add_argument("--poses", type=int, default=24)
    parser.add_argument("--tile-texels", type=int, default=2_600_000)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="where to make the project and leave it; otherwise it is removed")
    parser.add_argument("--output", type=Path, help="CSV to write")
    options = parser.parse_args()
    size = Size(options.megapixels, options.poses, options.tile_texels)
    with working_folder(options.folder) as folder:
        make_project(folder, size)
        rig_s = photograph(folder, options.cores)
        photographs_mb = sum(disk_mb(folder).values())
        with looked_at(folder) as largest:
            chain_s = make_pictures(folder, options.cores)
        found = costs(folder, largest.memory_mb)
        report(found, disk_mb(folder), size, rig_s, chain_s, options.output)
        print(f"most on the disk at a time: {largest.disk_mb:.0f} MB, of which photographs {photographs_mb:.0f} MB")


if __name__ == "__main__":
    main()
