"""Colour differences between a view rendered by Mitsuba 3 from an export, and Irodori's picture of the same view.

``python -m irodori.export.mitsuba_loss FOLDER PICTURE VIEW`` prints them as JSON. It runs in a separate process,
because Mitsuba ends the process if it finds an unsuitable version of LLVM. Both pictures have noise, so pixels are
averaged over squares before they are compared. The part of the difference that Mitsuba's noise alone causes is printed
too.
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

#: Side in pixels of the squares that are averaged, number of passes, and paths per pixel of each pass.
_SIDE, _PASSES, _EACH = 8, 8, 8
_MOST_AT_ONCE = 3_000_000  # paths per pass, because Mitsuba holds all of a pass in memory
_VARIANT = "llvm_ad_spectral"
_LONGEST_S = 3600.0


def _blocks(picture: np.ndarray) -> np.ndarray:
    height, width = (size // _SIDE for size in picture.shape[:2])
    whole = picture[: height * _SIDE, : width * _SIDE].reshape(height, _SIDE, width, _SIDE, 3)
    return whole.mean(axis=(1, 3))


def rendered(folder: Path, view: str, passes: int = _PASSES, each: int = _EACH) -> np.ndarray:
    """Render a view with Mitsuba in independent passes, (passes, height, width, 3) XYZ with Y = 100 for white.

    Parameters
    ----------
    folder : path
        Folder of the export.
    view : str
    passes : int
        Number of pictures.
    each : int
        Paths per pixel of each picture.
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
    """Return the loss of Mitsuba's pictures against ours, and the loss that their noise alone would cause, as JSON.

    Parameters
    ----------
    ours : (height, width, 3) float
        XYZ of our picture.
    theirs : (passes, height, width, 3) float
        XYZ of Mitsuba's pictures.
    white_xyz : (3,) float
    """

    def labs(xyz: np.ndarray) -> np.ndarray:
        return lab_from_xyz(_blocks(xyz), white_xyz)

    loss = Loss.of(delta_e(labs(ours), labs(theirs.mean(axis=0))))
    # The difference between the means of two halves is, in RMS, twice the error of the mean of all passes.
    noise = Loss.of(0.5 * delta_e(labs(theirs[::2].mean(axis=0)), labs(theirs[1::2].mean(axis=0))))
    return {"pixels_averaged": _SIDE**2, **loss.figures(), "of_mitsubas_noise_alone": noise.figures()}


def measure(folder: Path, picture: Path, view: str) -> dict:
    """Compare an export, rendered by Mitsuba in another process, with our picture.

    Returns
    -------
    dict
        The result of `compared`, or ``{"not_measured": reason}`` if Mitsuba fails or takes more than an hour.
    """
    command = [sys.executable, "-m", __name__, str(folder), str(picture), view]
    # The package need not be installed: the new process imports it from where this process found it.
    paths = [str(Path(irodori.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_LONGEST_S, env=environment
        )
    except subprocess.TimeoutExpired:
        return {"not_measured": f"no picture in {_LONGEST_S:.0f} s"}
    if done.returncode < 0:  # the library prints its error message before the state of the process
        said = [line for line in done.stderr.splitlines() if "error" in line.lower()] or ["nothing said"]
        return {"not_measured": f"Mitsuba ended by {signal.Signals(-done.returncode).name}: {said[0].strip()}"}
    if done.returncode:
        return {"not_measured": (done.stderr.strip().splitlines() or ["nothing said"])[-1].strip()}
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Run the command: render, compare and print the losses as JSON."""
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
