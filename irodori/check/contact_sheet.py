"""The contact sheet: a page of small photographs, over which the outlines and patches of the definitions are drawn."""

import base64
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
from irodori.geometry.projected_outline import ProjectedOutlines
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
        self._outlines: dict[str, ProjectedOutlines] = {}
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
        camera = self._loaded.cameras[one.camera]
        if camera.optics is None:
            return ""
        if one.subject not in self._outlines:
            distance_mm = self._loaded.rigs[camera.rig].camera_distance_mm
            shape = self._loaded.objects[one.subject].shape
            self._outlines[one.subject] = ProjectedOutlines(shape, camera.optics, distance_mm)
        return self._outlines[one.subject].of(pose).path

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
