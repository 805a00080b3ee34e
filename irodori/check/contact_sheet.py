"""The contact sheet: every photograph small, with what the definitions say of it drawn over it, as one HTML page."""

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from irodori.calibration.chart import Located, patch_centres
from irodori.check.findings import Finding
from irodori.check.photographs import PhotographSet
from irodori.config.capture_table import Pose, Shot
from irodori.config.loaded import Loaded
from irodori.config.models import Chart
from irodori.geometry.embree import Tracer
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_camera, rig_from_object, to_camera
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.preview import preview_of
from irodori.report.html_page import write_page

#: A hundred photographs of this width make a page that a phone can hold.
_WIDTH_PX = 480
#: Side of the square that stands for a chart's patch where the definition does not say, of the patches' distance.
_PATCH = 0.5


@dataclass
class Picture:
    """One photograph of the sheet.

    Parameters
    ----------
    path : path
    caption : str
        Role, pose, filter and exposure as its table says.
    size : (width, height)
        Superpixels.
    picture, overlay : str
        Data URIs of the small picture, and of what is blown (red) and dark (blue) in it.
    outline : str
        Path of SVG in superpixels, pixels' edges of the object's silhouette; empty where no object is on the table.
    chart : str, optional
        Name of the chart that it shows, empty for the camera's first; None where it shows none.
    patches : list of str
        Corners of each patch of a chart, polygons of SVG in superpixels.
    findings : list of Finding
    """

    path: Path
    caption: str
    size: tuple[int, int]
    picture: str
    overlay: str
    outline: str = ""
    chart: str | None = None
    patches: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)


class ContactSheet:
    """Collects photographs as a check decodes them.

    Parameters
    ----------
    loaded : Loaded
    """

    def __init__(self, loaded: Loaded) -> None:
        self._loaded = loaded
        self._shapes: dict[str, Shape] = {}
        self._outlines: dict[tuple[str, str], str] = {}
        self.sets: dict[str, list[Picture]] = {}

    def add(self, one: PhotographSet, shot: Shot, path: Path, mosaic: Mosaic) -> None:
        """Take a photograph of a set."""
        small = preview_of(mosaic, _WIDTH_PX)
        angles = ", ".join(f"{name.removesuffix('_deg')} {angle:g}°" for name, angle in vars(shot.pose).items())
        pose = f" · {angles}" if shot.role == "object" else ""
        picture = Picture(
            path,
            f"{shot.subject}{pose} · filter {shot.filter} · {shot.exposure_s:g} s",
            (mosaic.size[0] // 2, mosaic.size[1] // 2),
            _data_uri(small.jpeg, "jpeg"),
            _data_uri(small.overlay, "png"),
        )
        if one.kind == "objects" and shot.subject == "object":
            picture.outline = self._outline(one, shot.pose)
        elif shot.role == "chart":
            picture.chart = shot.chart
            camera = self._loaded.cameras[one.camera]
            picture.patches = _patches(camera.further_charts[shot.chart] if shot.chart else camera.chart)
        self.sets.setdefault(one.name, []).append(picture)

    def _outline(self, one: PhotographSet, pose: Pose) -> str:
        key = one.subject, pose.name
        if key not in self._outlines:
            camera = self._loaded.cameras[one.camera]
            if camera.optics is None:
                return ""
            definition = self._loaded.objects[one.subject]
            shape = self._shapes.setdefault(one.subject, Shape.from_definition(definition.shape))
            distance_mm = self._loaded.rigs[camera.rig].camera_distance_mm
            self._outlines[key] = svg_path(silhouette(shape, Pinhole.from_optics(camera.optics), distance_mm, pose))
        return self._outlines[key]

    def write(self, path, findings: list[Finding], located: Mapping[tuple[str, str], Located]) -> None:
        """Write the page; each finding stands beside its photograph, those of no photograph on top.

        ``located`` says where the patches of charts were found, by names of set and chart.
        """
        for (name, chart), found in located.items():
            for picture in self.sets.get(name, ()):
                if picture.chart == chart:
                    picture.patches = _squares(found.centres_px, found.side_px)
        pictures = {picture.path: picture for group in self.sets.values() for picture in group}
        general = []
        for finding in findings:
            if finding.photograph in pictures:
                pictures[finding.photograph].findings.append(finding)
            else:
                general.append(finding)
        write_page(path, "contact_sheet.html.j2", sets=self.sets, general=general)


def silhouette(shape: Shape, pinhole: Pinhole, distance_mm: float, pose: Pose) -> np.ndarray:
    """Return which superpixels' centres an object in a pose covers, (height / 2, width / 2) bool.

    Parameters
    ----------
    shape : Shape
    pinhole : Pinhole
    distance_mm : float
        From the origin of the rig to the centre of projection.
    pose : Pose
    """
    rows, columns = pinhole.height_px // 2, pinhole.width_px // 2
    mask = np.zeros((rows, columns), dtype=bool)
    axes, eye = rig_from_camera(pose), distance_mm * to_camera(pose)
    rotation = rig_from_object(pose)
    # Rays are sent where the ball about the object may be seen.
    reach = shape.reach_mm * 1.05
    across = np.stack(np.meshgrid(*[(-reach, 0.0, reach)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    seen = pinhole.project(across, eye, axes)
    if not np.isfinite(seen).all() or distance_mm <= math.sqrt(3.0) * reach:
        low, high = np.zeros(2, dtype=int), np.array([columns, rows])
    else:
        low = np.clip(np.floor(seen.min(axis=0)).astype(int), 0, [columns, rows])
        high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 1, 0, [columns, rows])
    if not (low < high).all():
        return mask
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    directions = pinhole.directions(np.stack([2.0 * x + 1.0, 2.0 * y + 1.0], axis=-1).reshape(-1, 2), axes)
    known = np.isfinite(directions[:, 0])
    hit = np.zeros(len(directions), dtype=bool)
    tracer = Tracer([Placement(shape, rotation)])
    origins = np.broadcast_to(eye, directions[known].shape).copy()
    hit[known] = tracer.occluded(origins, np.ascontiguousarray(directions[known]))
    mask[low[1] : high[1], low[0] : high[0]] = hit.reshape(x.shape)
    return mask


def svg_path(mask: np.ndarray) -> str:
    """Return the edges between covered and other superpixels as a path of SVG, superpixel (0, 0) from 0 to 1."""
    padded = np.pad(mask, 1)
    parts = []
    for row, column, length in _runs(padded[1:, 1:-1] != padded[:-1, 1:-1]):
        parts.append(f"M{column} {row}h{length}")
    for column, row, length in _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T):
        parts.append(f"M{column} {row}v{length}")
    return "".join(parts)


def _runs(edges: np.ndarray):
    """Yield (line, start, length) of the runs of true values along the lines of an array."""
    steps = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, ends = np.argwhere(steps == 1), np.argwhere(steps == -1)
    for (line, first), (_, last) in zip(starts.tolist(), ends.tolist(), strict=True):
        yield line, first, last - first


def _patches(chart: Chart) -> list[str]:
    """Return the squares of a chart where its definition has them; none of a chart that is looked for."""
    if chart.centres_px is None:
        return []
    centres = patch_centres(chart)
    return _squares(centres, chart.patch_px or _PATCH * float(np.linalg.norm(centres[1] - centres[0])))


def _squares(centres: np.ndarray, side: float) -> list[str]:
    """Return squares about centres in superpixels as polygons of SVG."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side
    # The centre of a superpixel has integer coordinates, its left edge in the page is that integer.
    return [" ".join(f"{x:.1f},{y:.1f}" for x, y in centre + corners + 0.5) for centre in centres]


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
