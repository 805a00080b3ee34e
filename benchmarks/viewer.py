"""Benchmark of the classroom page: speed against error in this machine's browser with a software renderer.

``python -m benchmarks.viewer [--size small] [--output viewer.csv]`` writes the page of the still life with its true
materials in the true light, and opens it. ``page, first frame`` is the time from opening the page to its first frame,
``page, programs`` the part of it in which the graphics driver links the shader programs, both in a new browser each
time; ``page, frame`` is one frame read back as XYZ. The reference is the interactive renderer's frame of the same view.
The errors are those that the page states: CIEDE2000 to the interactive renderer for two rotations of the light, three
illuminants and two observers. Graphics hardware is faster; its speed and accuracy are shown by the page's own
``#selftest``.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.render import true_light, true_materials
from benchmarks.table import COLUMNS, arguments_of, medians_s, own_peak_mb, report, row_without_figures
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Size
from irodori.core.store import Provenance
from irodori.core.threads import use_threads
from irodori.rendering.interactive.frame_renderer import render_frame
from irodori.rendering.scene_arrays import make_view
from irodori.viewer.browser import browser_command, opened
from irodori.viewer.measured import prepared
from irodori.viewer.page_data import page_data
from irodori.viewer.stage import SceneSources, export_viewer

_ROOT = Path(__file__).resolve().parents[1]
_LEAST_THROUGHPUT = 1e-3
#: Milliseconds until the first frame was drawn, and those for linking the shader programs.
_MILLISECONDS = "[performance.now(), Irodori.renderer.figures().programs_linked_ms]"
SIZES = {"small": (500, Size(width=64, height=48)), "full": (2000, Size(width=320, height=240))}


def make_sources(folder: Path, width: int) -> SceneSources:
    """Write materials and light of the still life, a panorama ``width`` px wide, to a folder."""
    loaded = load_definitions(read_yaml(_ROOT / "config/config.yaml"), _ROOT)
    scene, files = loaded.scenes["still-life"], []
    for number, material in enumerate(true_materials(loaded)):
        files.append(folder / f"material-{number}.h5")
        material.save(files[-1], Provenance("benchmark"))
    true_light(loaded, width).save(folder / "light.h5", Provenance("benchmark"))
    shapes = tuple(loaded.objects[item.object].shape for item in scene.objects)
    return SceneSources("still-life", scene, shapes, tuple(files), (folder / "light.h5",), _LEAST_THROUGHPUT)


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    arguments = arguments_of(__doc__.splitlines()[0]).parse_args()
    use_threads(arguments.threads)
    width, size = SIZES[arguments.size]
    with tempfile.TemporaryDirectory() as folder:
        rows = measured(Path(folder), width, size, arguments.runs)
    report(rows, arguments.threads, arguments.output)


def measured(folder: Path, width: int, size: Size, runs: int) -> list[dict]:
    """Measure the page and return the rows of the table; without a browser, one row with the reason."""
    sources, file = make_sources(folder, width), folder / "viewer.html"
    stated = export_viewer(sources, output=file)
    parts = page_data(sources).parts
    scene, view = prepared(parts), make_view(sources.scene.views["front"], size)
    work, milliseconds = {"interactive, frame": lambda: render_frame(scene, view)}, []
    if browser_command() is None:
        rows = [row_without_figures("viewer", "page", "no Chromium, or no Playwright to drive it")]
        return [*_rows(medians_s(work, runs), size, float("nan")), *rows]
    for _ in range(runs):
        with opened(file, cold=True) as page:
            milliseconds.append(page.page.evaluate(_MILLISECONDS))
    with opened(file) as page:
        state = page.default_state()
        seconds = medians_s(work | {"page, frame": lambda: page.read_xyz(state, size.width, size.height)}, runs)
    seconds["page, first frame"] = float(np.median([frame for frame, _ in milliseconds])) / 1e3
    seconds["page, programs"] = float(np.median([programs for _, programs in milliseconds])) / 1e3
    return _rows(seconds, size, stated["cpu"]["mean"])


def _rows(seconds: dict[str, float], size: Size, error: float) -> list[dict]:
    pixels = size.width * size.height / 1e6
    rows = []
    for name, median in seconds.items():
        is_frame, is_page = name.endswith(", frame"), name.startswith("page")
        work = (f"{pixels:.4g}", "megapixels") if is_frame else ("1", "pages")
        stated = (f"{error:.5f}", "mean CIEDE2000 to the interactive renderer") if is_page and is_frame else ("nan", "")
        values = ("viewer", name, *work, f"{median:.4f}", f"{float(work[0]) / median:.3f}", stated[1], stated[0],
                  f"{own_peak_mb():.0f}", "interactive, frame",
                  f"{median / seconds['interactive, frame']:.3f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


if __name__ == "__main__":
    main()
