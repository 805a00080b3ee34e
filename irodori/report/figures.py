"""Figures of the report as PNG data, drawn with matplotlib."""

import base64
import io
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import imread

from irodori.colour.colorimetry import delta_e_reflectance, xyz_from_reflectance
from irodori.colour.display import rgb_from_xyz, srgb
from irodori.core.atomic_files import written_whole
from irodori.material.material_file import Material, Status
from irodori.reflection.registry import lobe
from irodori.spectra.grid import WAVELENGTH_NM

# Titles have a fixed place: if matplotlib checks for overlap with ticks, it lays out every axis twice.
matplotlib.rcParams["axes.titley"] = 1.0

_UNSEEN_GREY = 208
_STATUS_COLOURS = (
    "#4c9f70",
    "#e0b050",
    "#9b6fb0",
    "#d0d0d0",
    "#c04040",
    "#4a90c4",
    "#f0e442",
    "#303030",
    "#a5d6a7",
    "#8d5524",
    "#e78ac3",
)


class _Margins(NamedTuple):
    """Margins around and between the axes of a figure, inches."""

    left: float
    right: float
    bottom: float
    top: float
    between: float


_OF_PLOTS = _Margins(left=0.8, right=0.15, bottom=0.5, top=0.35, between=0.75)
_OF_MAPS = _Margins(left=0.1, right=0.5, bottom=0.1, top=0.45, between=0.4)


def _subplots(rows: int, columns: int, size_in: tuple[float, float], margins: _Margins):
    """Return a figure and its axes with fixed margins; automatic margins would make matplotlib draw it twice more."""
    width, height = size_in
    across = (width - margins.left - margins.right - (columns - 1) * margins.between) / columns
    down = (height - margins.bottom - margins.top - (rows - 1) * margins.between) / rows
    places = {
        "left": margins.left / width,
        "right": 1.0 - margins.right / width,
        "bottom": margins.bottom / height,
        "top": 1.0 - margins.top / height,
        "wspace": margins.between / across,
        "hspace": margins.between / down,
    }
    figure = Figure(figsize=size_in)
    return figure, figure.subplots(rows, columns, gridspec_kw=places)


def png_uri(figure) -> str:
    """Return a figure as the data URI of a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _map(axes, figure, values, title: str, unit: str) -> None:
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, [1, 99]) if finite.size else (0.0, 1.0)
    picture = axes.imshow(values, vmin=low, vmax=max(high, low + 1e-9), cmap="viridis")
    axes.set_title(f"{title} [{unit}]" if unit != "1" else title, fontsize=9)
    axes.axis("off")
    figure.colorbar(picture, ax=axes, shrink=0.8)


def material_figure(material: Material, maps: dict[str, np.ndarray], truth: Material | None) -> str:
    """Return a figure of an object's maps: colour, parameters, status of the fit, errors, and ΔE if the truth is known.

    ``maps`` holds ``status``, ``residual_rms``, ``reflectance_error`` and ``delta_e_error``, (height, width) each.
    """
    rows = 1 + len(material.lobes)
    figure, axes = _subplots(rows, 5, (15, 2.8 * rows), _OF_MAPS)
    status = maps["status"]
    axes = axes.ravel()
    for spare in axes[10:]:
        spare.axis("off")
    matrix = xyz_from_reflectance("D65")
    spectra = np.nan_to_num(material.spectra())
    linear = spectra @ (rgb_from_xyz(matrix.sum(axis=1)) @ matrix).T
    picture, _ = srgb().encode(linear)
    picture[~material.observed] = _UNSEEN_GREY
    axes[0].imshow(picture)
    axes[0].set_title("reflectance under D65", fontsize=9)
    axes[0].axis("off")
    _map(axes[1], figure, material.alpha, "α", "1")
    for component, (name, beta, mu) in enumerate(material.gloss):
        kind, at = lobe(name), 2 if component == 0 else 10 + 2 * (component - 1)
        which = "" if len(material.lobes) == 1 else f" of {kind.title}"
        _map(axes[at], figure, beta, f"β{which}", "1")
        _map(axes[at + 1], figure, mu, f"{kind.roughness.symbol}{which}", kind.roughness.unit)
    _map(axes[4], figure, maps["residual_rms"], "residual", "1")
    norm = BoundaryNorm(np.arange(len(Status) + 1) - 0.5, len(Status))
    axes[5].imshow(status, cmap=ListedColormap(_STATUS_COLOURS), norm=norm)
    axes[5].set_title("outcome of the fit", fontsize=9)
    axes[5].axis("off")
    if truth is None:
        axes[6].axis("off")
    else:
        difference = np.where(material.observed, delta_e_reflectance(truth.spectra(), spectra, "D65"), np.nan)
        _map(axes[6], figure, difference, "CIEDE2000 under D65", "1")
    unseen = np.where(material.observed, 0.0, np.nan)
    _map(axes[7], figure, maps["reflectance_error"] + unseen, "standard deviation of S", "1")
    _map(axes[8], figure, maps["delta_e_error"] + unseen, "standard error in CIEDE2000", "1")
    shares = [f"{(status == s.value).mean():6.1%}  {s.name.lower().replace('_', ' ')}" for s in Status]
    axes[9].axis("off")
    for line, (text, colour) in enumerate(zip(shares, _STATUS_COLOURS, strict=True)):
        axes[9].text(0.0, 0.92 - 0.09 * line, "■", color=colour, fontsize=12, transform=axes[9].transAxes)
        axes[9].text(0.08, 0.92 - 0.09 * line, text, fontsize=9, family="monospace", transform=axes[9].transAxes)
    return png_uri(figure)


def spectra_figure(material: Material, truth: Material) -> str:
    """Return a figure of true spectra and recovered ones, the medians over the texels of each true spectrum."""
    figure, axes = _subplots(1, 1, (6.5, 3.6), _OF_PLOTS)
    index = truth.coefficients.argmax(axis=-1)
    for m, exact in enumerate(truth.basis.T):
        chosen = (index == m) & material.observed
        if not chosen.any():
            continue
        (line,) = axes.plot(WAVELENGTH_NM, exact, lw=1)
        recovered = np.median(material.coefficients[chosen] @ material.basis.T, axis=0)
        axes.plot(WAVELENGTH_NM, recovered, "--", lw=1, color=line.get_color())
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel("reflectance factor")
    axes.set_title("true (solid) and recovered (dashed)", fontsize=9)
    return png_uri(figure)


def selection_figure(header: list[str], rows: list[list[str]]) -> str:
    """Return a figure of the estimators' errors against computing time per pixel; a ring marks the one in use.

    Parameters
    ----------
    header, rows : list
        Header and rows of a camera's ``calibration_selection.csv``.
    """
    columns = {name: [row[i] for row in rows] for i, name in enumerate(header)}
    time_ns = np.array(columns["evaluation_ns_per_pixel"], dtype=float)
    chosen = np.array(columns["chosen"]) == "1"
    colour_errors = [name for name in header if name.startswith("delta_e") and name.endswith("mean")]
    figure, axes = _subplots(1, 2, (11, 3.8), _OF_PLOTS)
    for ax, name, label in zip(
        axes,
        (colour_errors[0], "rmse_mean"),
        (f"mean CIEDE2000 under {colour_errors[0].split('_')[2].upper()}", "mean spectral RMSE"),
        strict=True,
    ):
        values = np.array(columns[name], dtype=float)
        for number, estimator in enumerate(dict.fromkeys(columns["estimator"])):
            own = np.array(columns["estimator"]) == estimator
            ax.plot(time_ns[own], values[own], "o", ms=4, color=f"C{number}", label=estimator)
            for x, y, bases in zip(time_ns[own], values[own], np.array(columns["bases"])[own], strict=True):
                ax.annotate(bases, (x, y), fontsize=6, xytext=(3, 2), textcoords="offset points")
        ax.plot(time_ns[chosen], values[chosen], "o", ms=11, mfc="none", color="black")
        ax.set(xscale="log", yscale="log", xlabel="time of a pixel, one thread [ns]")
        ax.set_title(f"{label}, patches left out; numbers of bases beside the points", fontsize=8)
    axes[0].legend(fontsize=7)
    return png_uri(figure)


def comparison_figure(output, photograph, rendering, difference: np.ndarray, figures: dict) -> None:
    """Write a photograph, the rendering of its view and a map of their CIEDE2000 side by side to a PNG.

    Parameters
    ----------
    output, photograph, rendering : path
        PNG files.
    difference : (height, width) float
        CIEDE2000, NaN where not compared; the scale ends at its 99th percentile.
    figures : dict
        ``delta_e`` and ``noise_floor``: summaries of CIEDE2000, the second of the camera's noise alone.
    """
    figure, axes = _subplots(1, 3, (15, 4.2), _OF_MAPS)
    titles = ("photograph", "rendered from the fitted materials")
    for ax, path, title in zip(axes, (photograph, rendering), titles, strict=False):
        ax.imshow(imread(path))
        ax.set_title(title, fontsize=9)
        ax.axis("off")
    _map(axes[2], figure, difference, "CIEDE2000", "1")
    found, noise = figures["delta_e"], figures["noise_floor"]
    text = "CIEDE2000: mean {mean:.2f}, 95 % {p95:.2f}, 99 % {p99:.2f}, largest {max:.1f}".format(**found)
    axes[2].set_title(f"{text}\nnoise alone: mean {noise['mean']:.2f}, 95 % {noise['p95']:.2f}", fontsize=9)
    with written_whole(output) as temporary:
        figure.savefig(temporary, dpi=90, metadata={"Software": None})
