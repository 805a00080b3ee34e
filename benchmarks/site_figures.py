"""Figures of the documentation, drawn from the results of a finished run of the default scene.

``python -m benchmarks.site_figures [--results results]`` writes them to ``docs/figures``; the picture of the classroom
page needs Chromium and Python's Playwright. No figure is drawn by hand: all show data measured in that run or computed
by the package.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from benchmarks.published_tables import FIGURES
from benchmarks.written_pictures import spectra_in
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance, xyz_from_reflectance
from irodori.colour.display import rgb_from_xyz, srgb
from irodori.core import store
from irodori.core.atomic_files import written_whole
from irodori.core.errors import PlainError
from irodori.material.coefficients import read_coefficients
from irodori.material.material_file import Material
from irodori.material.observed_angles import read_angles
from irodori.reflection.equation5 import reflect
from irodori.reflection.lobe_arrays import evaluate
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import chart_spectra
from irodori.viewer.browser import browser

PLATE, SPHERE, CAMERA, ROOM, SCENE, VIEW = (
    "tile-plate",
    "vermilion-sphere",
    "d5100-comb",
    "classroom",
    "still-life",
    "front",
)
#: The pose of the plate's photograph that shows its highlight: light 45 degrees, camera 45 degrees.
_HIGHLIGHT = "l0450-c0450-t000-r0000"
_SPHERE_POSES = (
    "l0600-c0600-t000-r0450-a1500", "l0900-c0900-t000-r0000-a2100", "l0900-c0900-t000-r0450-a1500",
    "l0800-c0300-t000-r0000",
)  # fmt: skip
_BANDS = tuple(f"{colour}, {shot} filter" for shot in ("without", "with") for colour in ("red", "green", "blue"))
#: Patches of the ColorChecker that are shown: one of each region of colour.
_PATCHES = (2, 7, 12, 13, 14, 18)
_N = 1.5
_WINDOW = {"width": 1280, "height": 800}
# Text stays text, and two runs give the same bytes.
matplotlib.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "irodori", "font.size": 9}


def _plot(width_in: float = 6.5, height_in: float = 3.4):
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    return figure, figure.subplots()


def _spectrum(axes, what: str) -> None:
    axes.set(xlabel="wavelength [nm]", ylabel=what, xlim=(400.0, 700.0))


def six_bands(results: Path) -> Figure:
    """Return a figure of the six bands of one photograph of the plate, after ingestion."""
    with store.open_file(results / PLATE / "linear" / f"{_HIGHLIGHT}.h5") as file:
        response = file.read("response")
    figure = Figure(figsize=(9.0, 4.9), layout="constrained")
    # Where the lamp's mirror image saturates, a pixel has no response and is black.
    top = float(np.nanpercentile(response, 97.0))
    for axes, band, title in zip(figure.subplots(2, 3).ravel(), np.moveaxis(response, -1, 0), _BANDS, strict=True):
        axes.imshow(band, cmap="gray", vmin=0.0, vmax=top)
        axes.set_title(title, fontsize=9)
        axes.axis("off")
    return figure


def band_response(results: Path) -> Figure:
    """Return a figure of each band's response to a reflectance of 1 at each wavelength, with its standard deviation."""
    with store.open_file(results / "cameras" / CAMERA / "calibration.h5") as file:
        response, covariance = file.read("band_response"), file.read("band_response_covariance")
    figure, axes = _plot()
    for band, spread, title in zip(response, np.einsum("blbl->bl", covariance), _BANDS, strict=True):
        (line,) = axes.plot(WAVELENGTH_NM, band, label=title, lw=1.2)
        error = np.sqrt(np.maximum(spread, 0.0))
        axes.fill_between(WAVELENGTH_NM, band - error, band + error, color=line.get_color(), alpha=0.2, lw=0)
    _spectrum(axes, "response to a reflectance of 1 at one sample")
    axes.legend(fontsize=7)
    return figure


def chart_fit(results: Path) -> Figure:
    """Return a figure of measured and recovered spectra of some patches of the chart that trains the estimator."""
    with store.open_file(results / "cameras" / CAMERA / "calibration.h5") as file:
        basis, matrix, response = (file.read(name) for name in ("basis", "weights_from_response", "chart_response"))
    names, spectra = chart_spectra("BabelColor Average")
    recovered = response @ matrix @ basis.T
    figure, axes = _plot()
    for patch in _PATCHES:
        (line,) = axes.plot(WAVELENGTH_NM, spectra[patch], lw=1.2, label=names[patch])
        axes.plot(WAVELENGTH_NM, recovered[patch], "--", lw=1.2, color=line.get_color())
    _spectrum(axes, "reflectance factor")
    axes.legend(fontsize=7, title="measured (solid), recovered (dashed)", title_fontsize=7)
    return figure


def photographs(results: Path) -> Figure:
    """Return a figure of four photographs of a sphere on the virtual rig, in red, green and blue sensor counts."""
    figure = Figure(figsize=(9.0, 1.9), layout="constrained")
    for axes, pose in zip(figure.subplots(1, 4), _SPHERE_POSES, strict=True):
        with store.open_file(results / SPHERE / "linear" / f"{pose}.h5") as file:
            response = file.read("response")[..., :3]
        # The tone curve of a display; the bands of a camera are not yet its colours.
        axes.imshow(np.clip(response / np.percentile(response, 99.8), 0.0, 1.0) ** (1 / 2.2))
        angle = {part[0]: float(part[1:]) / 10.0 for part in pose.split("-")}
        lamp = f"light {angle['l']:g}°" + (f" around {angle['a']:g}°" if "a" in angle else "")
        axes.set_title(f"{lamp},\ncamera {angle['c']:g}°, turn {angle['r']:g}°", fontsize=8)
        axes.axis("off")
    return figure


def rectified(results: Path) -> Figure:
    """Return a figure of the green responses of all texels of the plate in four photographs."""
    with store.open_file(results / PLATE / "observations" / "tile-000.h5") as file:
        response, weight, geometry = file.read("response")[..., 1], file.read("weight"), read_angles(file)
    side = round(len(response) ** 0.5)
    angles = np.degrees(np.median(geometry[..., :2], axis=0))
    # Four cameras under the light that stands at 45 degrees over the untilted plate.
    poses = sorted(np.flatnonzero(np.abs(angles[:, 0] - 45.0) < 3.0), key=lambda pose: angles[pose, 1])
    figure = Figure(figsize=(9.0, 2.5), layout="constrained")
    chosen = [poses[0], poses[len(poses) // 3], poses[2 * len(poses) // 3], poses[-1]]
    for axes, pose in zip(figure.subplots(1, 4), chosen, strict=True):
        seen = np.where(weight[:, pose] > 0.0, response[:, pose], np.nan).reshape(side, side)
        axes.imshow(seen, cmap="gray", vmin=0.0, vmax=0.9)
        axes.set_title(f"camera at {angles[pose, 1]:.0f}°", fontsize=9)
        axes.axis("off")
    return figure


def light_basis(results: Path) -> Figure:
    """Return a figure of the room's light basis, each spectrum times the root mean square of its coefficients."""
    with store.open_file(results / "environments" / f"{ROOM}.h5") as file:
        basis, coefficients = file.read("basis"), read_coefficients(file, "coefficients")
    strength = np.sqrt(np.mean(coefficients.astype(np.float64) ** 2, axis=(0, 1)))
    figure, axes = _plot()
    for number, (spectrum, weight) in enumerate(zip(basis.T, strength, strict=True), 1):
        axes.plot(WAVELENGTH_NM, spectrum * weight / strength[0], lw=1.2, label=f"{number}")
    _spectrum(axes, "basis spectrum times its usual weight")
    axes.legend(fontsize=7, ncols=2)
    return figure


def one_texel(results: Path) -> Figure:
    """Return a figure of one texel's green responses against the camera's angle, with the fitted model."""
    with store.open_file(results / PLATE / "brdf" / "tile-000.h5") as file:
        fitted = {name: file.read(name) for name in ("alpha", "beta", "mu", "status")}
    # The texel nearest to the middle whose lobe is wide enough for several photographs to see it.
    wide = np.flatnonzero((fitted["status"] == 0) & (fitted["mu"] > 0.1) & (fitted["mu"] < 0.15))
    side = int(np.sqrt(fitted["mu"].size))
    row, column = np.divmod(wide, side)
    texel = int(wide[np.argmin(np.hypot(row - side / 2, column - side / 2))])
    alpha, beta, mu = (float(fitted[name][texel]) for name in ("alpha", "beta", "mu"))
    with store.open_file(results / PLATE / "observations" / "tile-000.h5") as file:
        seen = file.read("weight")[texel] > 0.0
        geometry, response = read_angles(file)[texel][seen], file.read("response")[texel, seen, 1]
    light, camera = np.degrees(geometry[:, 0]), np.degrees(geometry[:, 1])
    figure, axes = _plot()
    for low, high in ((20.0, 35.0), (35.0, 55.0), (55.0, 75.0)):
        own = (light > low) & (light <= high)
        if not own.any():
            continue
        incidence = float(np.median(light[own]))
        (line,) = axes.plot(camera[own], response[own], "o", ms=4, label=f"light at {incidence:.0f}°")
        view = np.linspace(0.0, 80.0, 400)
        angles = np.radians(np.stack(
            [np.full_like(view, incidence), view, (view + incidence) / 2, np.abs(view - incidence) / 2], axis=-1
        ))  # fmt: skip
        axes.plot(view, reflect(alpha, 1.0, beta, mu, angles, n=_N), lw=1, color=line.get_color())
    axes.set(xlabel="angle of the camera to the normal [°]", ylabel="response of the green band, 1 = perfect diffuser")
    axes.set_title(f"points: photographs; lines: α = {alpha:.3f}, β = {beta:.2f}, μ = {mu:.3f} rad", fontsize=9)
    axes.legend(fontsize=8)
    return figure


def lobes(_results: Path) -> Figure:
    """Return a figure of both lobes against the half-vector angle, for light and camera close to the normal."""
    figure, axes = _plot()
    angle = np.radians(np.linspace(0.0, 40.0, 300))
    geometry = np.stack([angle, angle, np.zeros_like(angle), angle], axis=-1)
    for name, style in (("gaussian", "-"), ("ggx", "--")):
        for mu, colour in ((0.05, "C0"), (0.1, "C1"), (0.2, "C2")):
            axes.semilogy(np.degrees(angle), evaluate(name, mu, geometry), style, color=colour, lw=1.2,
                          label=f"{name}, roughness {mu:g}")  # fmt: skip
    axes.set(xlabel="angle φ between normal and half vector [°]", ylabel="D G / cos θ_r", ylim=(1e-5, 3.0))
    axes.legend(fontsize=7)
    return figure


def plate_maps(results: Path) -> Figure:
    """Return a figure of the fitted plate's maps of colour, α, β, μ, and of the colour's error against the truth."""
    fitted, truth = (Material.load(results / PLATE / name) for name in ("material.h5", "truth.h5"))
    spectra = np.nan_to_num(fitted.spectra())
    matrix = xyz_from_reflectance("D65")
    colour, _ = srgb().encode(spectra @ (rgb_from_xyz(matrix.sum(axis=1)) @ matrix).T)
    lab = [lab_from_xyz(s @ matrix.T, matrix.sum(axis=1)) for s in (truth.spectra(), spectra)]
    figure = Figure(figsize=(10.0, 2.4), layout="constrained")
    axes = figure.subplots(1, 5)
    axes[0].imshow(colour)
    maps = {"α": fitted.alpha, "β": fitted.beta, "μ [rad]": fitted.mu, "CIEDE2000 to the truth": delta_e(*lab)}
    for one, values in zip(axes[1:], maps.values(), strict=True):
        low, high = np.nanpercentile(values, [1.0, 99.0])
        figure.colorbar(one.imshow(values, vmin=low, vmax=high, cmap="viridis"), ax=one, shrink=0.75)
    for one, title in zip(axes, ("reflectance under D65", *maps), strict=True):
        one.set_title(title, fontsize=9)
        one.axis("off")
    return figure


def _light(path: Path) -> np.ndarray:
    """Return the spectral radiance of an environment's file on every second pixel, (rows, columns, 61)."""
    with store.open_file(path) as file:
        return np.maximum(read_coefficients(file, "coefficients")[::2, ::2] @ file.read("basis").T, 0.0)


def recovered_light(results: Path) -> Figure:
    """Return a figure of the room's panorama, with recovered and true spectra of a bright and of a median pixel."""
    found, truth = _light(results / "environments" / f"{ROOM}.h5"), _light(results / "environments" / ROOM / "truth.h5")
    matrix = xyz_from_radiance(np.ones(len(WAVELENGTH_NM)))
    xyz = found @ matrix.T
    luminance = xyz[..., 1]
    # White is the mean colour of the room; its lamps go beyond what a display shows.
    white = np.mean(xyz, axis=(0, 1))
    linear = xyz * (100.0 / np.percentile(luminance, 97.0)) @ rgb_from_xyz(white * (100.0 / white[1])).T
    picture, _ = srgb().encode(linear)
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    room, axes = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    room.imshow(picture)
    room.set_title("the room as the camera photographed it", fontsize=9)
    room.axis("off")
    for label, share in (("a bright place", 99.9), ("a place of middling light", 50.0)):
        at = np.unravel_index(np.argmin(np.abs(luminance - np.percentile(luminance, share))), luminance.shape)
        exact = truth[at]
        (line,) = axes.plot(WAVELENGTH_NM, exact / exact.mean(), lw=1.2, label=label)
        axes.plot(WAVELENGTH_NM, found[at] / exact.mean(), "--", lw=1.2, color=line.get_color())
    _spectrum(axes, "radiance over the mean of the true one")
    axes.legend(fontsize=7, title="true (solid), recovered (dashed)", title_fontsize=7)
    return figure


def picture_error(results: Path) -> Figure:
    """Return a figure of the rendered picture and of its difference to that of the true materials in the true light."""
    folder = results / SCENE
    pictures = [spectra_in(folder / part / f"{VIEW}.exr")[1] for part in (".", "truth")]
    # The white of the scene only sets the scale of CIELAB: a diffuser as bright as the 99th percentile of the picture.
    matrix = xyz_from_radiance(np.ones(len(WAVELENGTH_NM)))
    xyz = [picture @ matrix.T for picture in pictures]
    white = np.mean(xyz[1], axis=(0, 1)) * (np.percentile(xyz[1][..., 1], 99.0) / np.mean(xyz[1][..., 1]))
    difference = delta_e(*(lab_from_xyz(one, white) for one in xyz))
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(matplotlib.image.imread(folder / f"{VIEW}.png"))
    left.set_title("the rendered picture", fontsize=9)
    figure.colorbar(right.imshow(difference, vmin=0.0, vmax=6.0, cmap="magma"), ax=right, shrink=0.8)
    right.set_title("CIEDE2000 to true materials in true light", fontsize=9)
    for one in (left, right):
        one.axis("off")
    return figure


def error_budget(_results: Path) -> Figure:
    """Return a figure of the measured and predicted mean error of every stage, from the tables in the documents."""
    with (FIGURES / "error_budget.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))[::-1]
    figure, axes = _plot(7.5, 3.6)
    place = np.arange(len(rows))
    for key, shift, label in (("mean", 0.2, "measured"), ("predicted", -0.2, "predicted without the truth")):
        axes.barh(place + shift, [float(row[key] or "nan") for row in rows], height=0.38, label=label)
    axes.set_yticks(place, [row["stage"] for row in rows])
    axes.set_xlabel("mean CIEDE2000 on the objects")
    axes.legend(fontsize=8)
    return figure


#: File in docs/figures -> function that draws it.
DRAWN: dict[str, Callable[[Path], Figure]] = {
    "six-bands.png": six_bands,
    "band-response.svg": band_response,
    "chart-fit.svg": chart_fit,
    "photographs.png": photographs,
    "rectified.png": rectified,
    "light-basis.svg": light_basis,
    "one-texel.svg": one_texel,
    "lobes.svg": lobes,
    "plate-maps.png": plate_maps,
    "recovered-light.png": recovered_light,
    "picture-error.png": picture_error,
    "error-budget.svg": error_budget,
}


def photograph_viewer(results: Path, path: Path) -> None:
    """Write a screenshot of the scene's classroom page in a browser.

    Raises
    ------
    PlainError
        If there is no browser, or the page is not ready within three minutes.
    """
    context = browser().new_context(viewport=_WINDOW, locale="en", reduced_motion="reduce")
    try:
        page = context.new_page()
        page.goto((results / SCENE / "viewer.html").resolve().as_uri())
        page.wait_for_selector("body[data-ready]", timeout=180_000)
        if not page.evaluate("""async (end) => {
            while (!Irodori.pace().atRest && performance.now() < end) await new Promise((go) => setTimeout(go, 50));
            return Irodori.pace().atRest; }""", 180_000):  # fmt: skip
            raise PlainError("The classroom page did not come to rest within three minutes.")
        page.screenshot(path=path)
    finally:
        context.close()


def main(arguments: list[str] | None = None) -> None:
    """Draw all figures, or the named ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.site_figures", description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--only", nargs="+", metavar="FILE", choices=[*DRAWN, "viewer.png"])
    given = parser.parse_args(arguments)
    for name, draw in DRAWN.items():
        if given.only is None or name in given.only:
            metadata = {"Date": None} if name.endswith(".svg") else {"Software": None}
            with written_whole(FIGURES / name) as temporary:
                draw(given.results).savefig(temporary, format=name[-3:], dpi=110, metadata=metadata)
    if given.only is None or "viewer.png" in given.only:
        with written_whole(FIGURES / "viewer.png") as temporary:
            photograph_viewer(given.results, temporary)


if __name__ == "__main__":
    main()
