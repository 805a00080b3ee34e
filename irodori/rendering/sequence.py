"""Frame sequence stage: renders a turntable, a light sweep or a change of illuminant to PNG frames and an animated PNG.

Finished frames are kept in a folder next to the final one, so that an interrupted sequence continues where it stopped.
"""

import hashlib
import json
import os
import re
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.colour.display import make_display
from irodori.config.definition import as_plain
from irodori.config.models import (
    Frames,
    IlluminantChange,
    LightSweep,
    ObjectShape,
    Render,
    Scene,
    Turntable,
)
from irodori.config.scene_files import keeps_light
from irodori.core.atomic_files import file_sha256, written_whole
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track
from irodori.core.provenance import code_hash
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.light.placed_lights import unit_luminance
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.frame_state import Moment
from irodori.rendering.integrators import InteractiveRenderer, has_light_maps, make_renderer
from irodori.rendering.scene_white import shown_white
from irodori.rendering.stage import write_picture
from irodori.spectra.grid import WAVELENGTH_NM

#: Least power of an illuminant, relative to its peak, that allows division by it.
_LEAST_POWER = 1e-4
_KEY = "key.txt"
#: Step of the pixels at which the loss of a frame is measured; for all pixels, that takes a fifth of a second.
_JUDGED_STEP = 4


def make_moments(frames: Frames) -> list[tuple[dict, Moment]]:
    """Return for each frame of a sequence its settings, as written to the figures, and its moment.

    Parameters
    ----------
    frames : Turntable, LightSweep or IlluminantChange

    Raises
    ------
    InputError
        If the first illuminant, by which the light is divided, has too little power at some wavelength.
    """
    if isinstance(frames, IlluminantChange):
        return list(_illuminants(frames))
    if isinstance(frames, Turntable):
        angles = 360.0 * np.arange(frames.count) / frames.count
        parts, pivot = [f"{frames.turned}_deg"], frames.pivot_mm
    else:
        angles = np.linspace(frames.from_deg, frames.to_deg, frames.count)
        names = ("environment", "lights") if frames.turned == "both" else (frames.turned,)
        parts, pivot = [f"{name}_deg" for name in names], (0.0, 0.0, 0.0)
    shown = [dict.fromkeys(parts, float(angle)) for angle in angles]
    return [(turned, Moment(**turned, pivot_mm=pivot, filter=None)) for turned in shown]


def _illuminants(frames: IlluminantChange) -> Iterator[tuple[dict, Moment]]:
    """Yield the frames of an illuminant change; between two illuminants, their spectra are mixed."""
    name = frames.from_illuminant
    source = unit_luminance(name)
    least = source.argmin()
    if source[least] < _LEAST_POWER * source.max():
        found = f"{source[least] / source.max():.1g} of its peak at {WAVELENGTH_NM[least]:g} nm"
        accepted = f"a spectrum of at least {_LEAST_POWER:g} of its peak everywhere, for light is divided by it"
        raise InputError("scene", f"frames.from_illuminant {name}", found, accepted)
    names = frames.illuminants
    filters = [unit_luminance(target) / source for target in names]
    steps = np.arange(frames.count_between + 1) / (frames.count_between + 1)
    for (one, a), (other, b) in pairwise(zip(names, filters, strict=True)):
        for step in steps:
            shown = {one: 1.0} if step == 0 else {one: float(1.0 - step), other: float(step)}
            yield {"illuminants": shown}, Moment(filter=tuple((1.0 - step) * a + step * b))
    yield {"illuminants": {names[-1]: 1.0}}, Moment(filter=tuple(filters[-1]))


def sequence_key(scene: Scene, view_name: str, shapes: Sequence[ObjectShape], options: Render, inputs: list) -> str:
    """Return a hash of everything on which frames depend: definition, files and this code."""
    seen = replace(scene, views={view_name: scene.views[view_name]})
    text = json.dumps(as_plain([seen, shapes, options]), sort_keys=True)
    digest = hashlib.blake2b(f"{code_hash(__name__)} {text}".encode(), digest_size=16)
    for path in inputs:
        digest.update(file_sha256(Path(path)).encode())
    return digest.hexdigest()


class _Frames:
    """Folder of the finished frames of one sequence, each a PNG and a JSON of figures, which is written last."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder = folder
        note = folder / _KEY
        if folder.is_dir() and not (note.is_file() and note.read_text(encoding="utf-8") == key):
            LOGGER.info("%s holds frames of another sequence: they are removed", folder)
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text(key, encoding="utf-8")

    def picture(self, number: int) -> Path:
        return self.folder / f"{number:05d}.png"

    def figures(self, number: int) -> Path:
        return self.folder / f"{number:05d}.json"

    def finish(self, number: int, figures: dict) -> None:
        """Write a frame's figures, which marks its picture as complete."""
        _write_json(self.figures(number), figures)

    def is_finished(self, number: int) -> bool:
        return self.figures(number).is_file()

    def move_to(self, final: Path) -> None:
        """Remove everything except the pictures and rename the folder to its final name."""
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif not re.fullmatch(r"\d+\.png", path.name):
                path.unlink()
        if final.is_dir():
            shutil.rmtree(final)
        os.replace(self.folder, final)


def _write_json(path, content: dict) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")


class _Pictures:
    """Iterable over picture files that holds one open at a time; Pillow iterates over it twice."""

    def __init__(self, files: list[Path]) -> None:
        self.files = files

    def __iter__(self) -> Iterator:
        from PIL import Image

        for file in self.files:
            with Image.open(file) as image:
                yield image


def write_animation(path, pictures: list[Path], frames_per_second: float) -> None:
    """Write PNG pictures as one endlessly repeating animated PNG, with their pixels and ICC profile unchanged."""
    from PIL import Image

    with written_whole(path) as temporary, Image.open(pictures[0]) as first:
        profile = first.info["icc_profile"]
        options = {"save_all": True, "append_images": _Pictures(pictures[1:]), "loop": 0, "icc_profile": profile}
        first.save(temporary, format="PNG", duration=1000.0 / frames_per_second, **options)


def render_frames(
    scene: Scene,
    view_name: str,
    shapes: Sequence[ObjectShape],
    material_files: list,
    environment_file,
    *,
    inputs: list,
    folder,
    animation,
    figures_file,
    options: Render,
    maps_file=None,
) -> None:
    """Render the frames of a view from files into a folder of PNG files, an animated PNG and a JSON of figures.

    Parameters
    ----------
    scene : Scene
        Scene with ``frames``.
    inputs : list of path
        All files on which frames depend; frames of an interrupted run are used if these files have not changed.
    folder, animation, figures_file : path
        Outputs. The frames in the folder are ``00000.png``, ``00001.png``, ...; until all are finished, they are in
        ``FOLDER.part``.

    Other parameters are those of `irodori.rendering.stage.render_view`.
    """
    frames = scene.frames
    if frames is None:
        raise ValueError("a scene without frames; accepted: a turntable, a light_sweep or an illuminant_change")
    moments = make_moments(frames)
    folder = Path(folder)
    kept = _Frames(folder.with_name(folder.name + ".part"), sequence_key(scene, view_name, shapes, options, inputs))
    missing = [number for number in range(len(moments)) if not kept.is_finished(number)]
    if len(missing) < len(moments):
        LOGGER.info("%d of %d frames are there from an earlier run", len(moments) - len(missing), len(moments))
    environment = Environment.load(environment_file)
    made = [Shape.from_definition(shape) for shape in shapes]
    materials = load_materials(scene, made, material_files)
    white, exposure = shown_white(scene, environment, environment_file)
    if scene.tolerance_ciede2000 is not None:
        LOGGER.info("frames are rendered in full: a plan is made for the scene's own moment")
    renderer = make_renderer(scene, made, materials, environment, options, white, maps_file=maps_file)
    if has_light_maps(scene) and not keeps_light(frames):
        assert isinstance(renderer, InteractiveRenderer)  # which alone has light maps
        # All frames have maps of one kind, also the first, so that the sequence does not flicker.
        renderer.light_turns = True
    matrix_of_white = xyz_from_radiance(white)
    display = make_display(scene.display.device)
    stands = isinstance(frames, LightSweep)
    first_white = isinstance(frames, IlluminantChange) and frames.white == "first"
    for number in track(missing, f"frames of {view_name}"):
        shown, moment = moments[number]
        start = time.perf_counter()
        picture, figures = renderer.picture(view_name, moment, stands, kept.folder / f"{number:05d}.tiles")
        filtered = moments[0 if first_white else number][1].filter
        seen = white if filtered is None else white * np.asarray(filtered)
        matrix = xyz_from_radiance(seen)
        if picture.shape[-1] == 3:  # XYZ for the scene's white: another's differs in the scale
            xyz = picture * np.float32(matrix[1].sum() / matrix_of_white[1].sum())
        else:
            xyz = picture @ matrix.T.astype(np.float32)
        figures |= write_picture(kept.picture(number), xyz, matrix @ seen, display, judged_step=_JUDGED_STEP)
        kept.finish(number, shown | figures | {"seconds_in_all": time.perf_counter() - start})
    numbers = range(len(moments))
    write_animation(animation, [kept.picture(n) for n in numbers], frames.frames_per_second)
    of_each = [json.loads(kept.figures(n).read_text(encoding="utf-8")) for n in numbers]
    rest = {"kind": frames.kind, "frames_from_earlier_runs": len(moments) - len(missing)}
    _write_json(figures_file, rest | {"exposure": exposure, "frames": of_each})
    kept.move_to(folder)
