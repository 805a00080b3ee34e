"""Benchmark of the virtual rig's imperfections: how far they set the default plate's material off.

``python -m benchmarks.imperfections [--faults light_drift ...] [--output imperfections.csv]``, at the top of the
repository. Snakemake makes the plate's material on a rig without faults, with each fault alone, with all, and with all
on a plate whose gloss follows GGX in place of equation (5). Errors are those away from seams.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

import yaml

from benchmarks.ten_megapixels import ROOT, run_chain
from irodori.config.models import Imperfections
from irodori.evaluation.result_tables import ErrorRow, write_rows
from irodori.evaluation.truth_errors import material_errors
from irodori.material.material_file import Material

OBJECT = "tile-plate"
FAULTS = tuple(field.name for field in fields(Imperfections))
_GGX = "all, GGX"
_FILES = [f"results/{OBJECT}/{kind}.h5" for kind in ("material", "truth")]
_SHOWN = ("reflectance CIEDE2000 away from seams", "beta relative away from seams, where known",
          "mu relative away from seams, where known")  # fmt: skip


def edit(path: Path, change: Callable[[dict], None]) -> None:
    """Change the content of a YAML file."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def make_project(folder: Path, enabled: Sequence[str], lobe: str | None = None) -> None:
    """Write the default configuration with a rig of some faults and, if named, another lobe of the plate's gloss."""
    shutil.copytree(ROOT / "config", folder / "config")

    def switch(rig: dict) -> None:
        for name in FAULTS:
            rig["virtual"]["imperfections"][name]["enabled"] = name in enabled

    edit(folder / "config/rigs/virtual.yaml", switch)
    edit(folder / "config/config.yaml", lambda config: config.update(photographed_together=[]))
    if lobe:
        materials = f"config/objects/{OBJECT}.yaml"
        edit(folder / materials, lambda plate: [one.update(lobe=lobe) for one in plate["virtual"]["materials"]])


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", nargs="*", default=FAULTS, choices=FAULTS, help="those that are tried alone")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--output", type=Path, help="CSV to write")
    given = parser.parse_args()
    runs = {"none": (), **{f"{name} alone": (name,) for name in given.faults}, "all": FAULTS, _GGX: FAULTS}
    rows: list[ErrorRow] = []
    for label, enabled in runs.items():
        with tempfile.TemporaryDirectory(prefix="irodori-") as temporary:
            folder = Path(temporary)
            make_project(folder, enabled, "ggx" if label == _GGX else None)
            run_chain(folder, given.cores, *_FILES)
            material, truth = (Material.load(folder / file) for file in _FILES)
        own = [row for row in material_errors(label, material, truth, ["D65"]) if row.quantity in _SHOWN]
        for row in own:
            print(f"{label:>19}, {row.quantity}: mean {row.mean:.4g}, p95 {row.p95:.4g}", flush=True)
        rows += own
    if given.output:
        write_rows(given.output, ErrorRow, rows)


if __name__ == "__main__":
    main()
