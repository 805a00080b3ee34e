"""Contact sheet: a page of small photographs, with outlines of objects and patches of charts drawn over them."""

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
from irodori.config.models import Chart, Optics
from irodori.geometry.projected_outline import ProjectedOutlines
from irodori.ingest.mosaic import Mosaic
from irodori.ingest.preview import preview_of
from irodori.rectification.reduced_pictures import GREEN
from irodori.report.html_page import write_page

#: A hundred photographs of this width make a page that a phone can hold.
_WIDTH_PX = 480
#: Side of the square drawn for a patch of unknown size, as a share of the distance between patches.
_PATCH = 0.5
#: Side of the square drawn at a corner of the printed sheet, as a share of the picture's width.
_CORNER = 0.004


@dataclass
class Picture:
    """One photograph of the sheet.

    Parameters
    ----------
    path : path
    caption : str
        Subject, pose, filter and exposure from the table of photographs.
    size : (width, height)
        Superpixels.
    picture, overlay : str
        Data URIs of the small picture, and of a layer that marks overexposed (red) and dark (blue) parts of it.
    outline : str
        SVG path of the object's silhouette, in superpixels with integer coordinates at their edges; empty if the
        photograph shows no object or the camera has no known optics.
    chart : str, optional
        Name of the chart in the photograph, empty for the camera's first chart; None if there is no chart.
    patches : list of str
        SVG polygons of the patches of a chart, or small ones at the corners of the printed sheet, in superpixels.
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
    """Contact sheet, to which a check adds each photograph that it decodes.

    Parameters
    ----------
    loaded : Loaded
    optics : mapping, optional
        Measured optics of cameras, by name; of other cameras the typed ones are used.
    """

    def __init__(self, loaded: Loaded, optics: Mapping[str, Optics] | None = None) -> None:
        self._loaded, self._optics = loaded, {} if optics is None else optics
        self._outlines: dict[str, ProjectedOutlines] = {}
        self.sets: dict[str, list[Picture]] = {}

    def add(self, one: PhotographSet, shot: Shot, path: Path, mosaic: Mosaic) -> None:
        """Add a decoded photograph of a set."""
        small = preview_of(mosaic, _WIDTH_PX)
        limits = self._loaded.rigs[self._loaded.cameras[one.camera].rig].limits
        angles = angles_in_words(shot.pose, limits.light_azimuth_deg is not None)
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
            if self._loaded.objects[one.subject].markers is not None:
                # OpenCV takes a third of a second to load.
                from irodori.rectification.marker_sheet import corners_in

                corners = corners_in(mosaic.superpixels[..., GREEN])[1]
                picture.patches = _squares(corners, _CORNER * mosaic.size[0])
                picture.caption += f" · {len(corners)} corners of the printed sheet"
        elif shot.role == "chart":
            picture.chart = shot.chart
            camera = self._loaded.cameras[one.camera]
            picture.patches = _patches(camera.further_charts[shot.chart] if shot.chart else camera.chart)
        self.sets.setdefault(one.name, []).append(picture)

    def _outline(self, one: PhotographSet, pose: Pose) -> str:
        camera = self._loaded.cameras[one.camera]
        optics = self._optics.get(one.camera, camera.optics)
        if optics is None:
            return ""
        if one.subject not in self._outlines:
            distance_mm = self._loaded.rigs[camera.rig].camera_distance_mm
            shape = self._loaded.objects[one.subject].shape
            self._outlines[one.subject] = ProjectedOutlines(shape, optics, distance_mm)
        return self._outlines[one.subject].of(pose).path

    def write(self, path, findings: list[Finding], located: Mapping[tuple[str, str], Located]) -> None:
        """Write the page, each finding beside its photograph, and findings that concern no photograph at the top.

        ``located`` holds the detected patches of charts, {(name of set, name of chart): patches}. They are drawn in
        place of those of the definition.
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


def angles_in_words(pose: Pose, with_azimuth: bool) -> str:
    """Return the angles of a pose for a caption.

    An azimuth of 0 is left out unless `with_azimuth` says that lamps may stand outside the rig's plane.
    """
    azimuth = f" and azimuth {pose.light_azimuth_deg:g}°" if with_azimuth or pose.light_azimuth_deg else ""
    return (
        f"light at {pose.light_deg:g}°{azimuth}, camera at {pose.camera_deg:g}°, "
        f"table tilted by {pose.tilt_deg:g}° and turned by {pose.turn_deg:g}°"
    )


def _patches(chart: Chart) -> list[str]:
    """Return SVG polygons of a chart's patches at the places of its definition; none if the chart is to be detected."""
    if chart.centres_px is None:
        return []
    centres = patch_centres(chart)
    return _squares(centres, chart.patch_px or _PATCH * float(np.linalg.norm(centres[1] - centres[0])))


def _squares(centres: np.ndarray, side: float) -> list[str]:
    """Return squares around centres as SVG polygons; all lengths in superpixels."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side
    # The centre of a superpixel has integer coordinates, its left edge in the page is that integer.
    return [" ".join(f"{x:.1f},{y:.1f}" for x, y in centre + corners + 0.5) for centre in centres]


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
