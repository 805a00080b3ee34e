"""The colour differences between an export for Mitsuba 3, rendered there, and our own picture of the same view.

``python -m irodori.export.mitsuba_loss FOLDER PICTURE VIEW`` prints them as JSON. It runs as a process of its own: a
Mitsuba whose LLVM does not suit it ends the process. Pixels are averaged over squares before they are compared, since
both pictures have noise; what Mitsuba's noise alone makes of the figure is told beside it.
"""

import argparse
import importlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

import irodori
from irodori.colour.colorimetry import delta_e, lab_from_xyz
from irodori.export.loss import Loss
from irodori.export.mitsuba_scene import ABOUT, PLUGIN, SCENE
from irodori.export.pictures import read_xyz

#: Pixels along the side of a square that is averaged, and paths a pixel: rendered in passes, whose memory is the less.
_SIDE, _PASSES, _EACH = 8, 8, 8
_MOST_AT_ONCE = 3_000_000  # paths: Mitsuba holds all of a pass in memory
_VARIANT = "llvm_ad_spectral"
_LONGEST_S = 3600.0


def _blocks(picture: np.ndarray) -> np.ndarray:
    height, width = (size // _SIDE for size in picture.shape[:2])
    whole = picture[: height * _SIDE, : width * _SIDE].reshape(height, _SIDE, width, _SIDE, 3)
    return whole.mean(axis=(1, 3))


def rendered(folder: Path, view: str, passes: int = _PASSES, each: int = _EACH) -> np.ndarray:
    """Return a view as Mitsuba renders it in independent passes, (passes, height, width, 3) XYZ, white Y = 100.

    Parameters
    ----------
    folder : path
        Of the export.
    view : str
    passes, each : int
        Pictures, and paths a pixel of each.
    """
    mitsuba = importlib.import_module("mitsuba")  # no dependency of the package
    mitsuba.set_variant(_VARIANT)
    sys.path.insert(0, str(folder))
    importlib.import_module(Path(PLUGIN).stem)
    sys.path.pop(0)
    scale = json.loads((folder / ABOUT).read_text(encoding="utf-8"))["scale_to_xyz"]
    scene = mitsuba.load_file(str(folder / SCENE))
    sensor = next(i for i, one in enumerate(scene.sensors()) if one.id() == view)
    pictures = [mitsuba.render(scene, sensor=sensor, spp=each, seed=1 + seed) for seed in range(passes)]
    return scale * np.stack([np.array(picture, dtype=np.float64) for picture in pictures])


def compared(ours: np.ndarray, theirs: np.ndarray, white_xyz: np.ndarray) -> dict:
    """Return the loss of pictures (passes, height, width, 3) against ours, and what their own noise makes of it."""

    def labs(xyz: np.ndarray) -> np.ndarray:
        return lab_from_xyz(_blocks(xyz), white_xyz)

    loss = Loss.of(delta_e(labs(ours), labs(theirs.mean(axis=0))))
    # Two halves differ by twice the error of the whole.
    noise = Loss.of(0.5 * delta_e(labs(theirs[::2].mean(axis=0)), labs(theirs[1::2].mean(axis=0))))
    return {"pixels_averaged": _SIDE**2, **loss.figures(), "of_mitsubas_noise_alone": noise.figures()}


def measure(folder: Path, picture: Path, view: str) -> dict:
    """Return `compared` of an export and our picture, or ``{"not_measured": reason}``."""
    command = [sys.executable, "-m", __name__, str(folder), str(picture), view]
    # The package itself may be installed or not: it is found where this process found it.
    paths = [str(Path(irodori.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_LONGEST_S, env=environment
        )
    except subprocess.TimeoutExpired:
        return {"not_measured": f"no picture in {_LONGEST_S:.0f} s"}
    if done.returncode < 0:  # a library's own words stand before the state that it prints when it ends the process
        said = [line for line in done.stderr.splitlines() if "error" in line.lower()] or ["nothing said"]
        return {"not_measured": f"Mitsuba ended by {signal.Signals(-done.returncode).name}: {said[0].strip()}"}
    if done.returncode:
        return {"not_measured": (done.stderr.strip().splitlines() or ["nothing said"])[-1].strip()}
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("view")
    given = parser.parse_args()
    about = json.loads((given.folder / ABOUT).read_text(encoding="utf-8"))
    ours = read_xyz(given.picture, np.array(about["xyz_from_radiance"]))
    each = max(1, min(_EACH, _MOST_AT_ONCE // (ours.shape[0] * ours.shape[1])))
    theirs = rendered(given.folder, given.view, each=each)
    print(json.dumps(compared(ours, theirs, np.array(about["white_xyz"]))))


if __name__ == "__main__":
    main()
