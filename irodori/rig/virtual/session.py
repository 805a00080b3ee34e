"""Sessions of the virtual rig: each photographs one set of shots and leaves DNG files and ``captures.csv``."""

import math
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irodori.captures import Pose, Shot, expand_poses, write_captures
from irodori.geometry.embree import Tracer
from irodori.geometry.frames import flat_incidence_rad, rig_from_camera, rig_from_object, to_camera, to_light
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.shapes import on_table
from irodori.progress import track
from irodori.provenance import file_sha256
from irodori.rig.virtual.classroom import room_coefficients, source_spectra
from irodori.rig.virtual.dng import write_dng
from irodori.rig.virtual.imaging import expose_object
from irodori.rig.virtual.samples import Sample
from irodori.rig.virtual.sensor import Sensor, band_weights
from irodori.spectra import chart_spectra, spectrum

_FILTER_STATES = ("out", "in")
_PATCH_FILL = 0.42  # half of a patch's side, as a fraction of the pitch between patches
_BORDER_REFLECTANCE = 0.03


@dataclass
class Session:
    """One sitting at the virtual rig: its light drifts, its optics are not perfect.

    Parameters
    ----------
    camera, rig : dict
        Definitions of the camera and the rig.
    name : str
        Seeds the noise together with the rig's seed, so that every session is reproducible and different.
    folder : Path
        Where the files go.
    """

    camera: dict
    rig: dict
    name: str
    folder: Path

    def __post_init__(self) -> None:
        self.folder = Path(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.sensor = Sensor(**self.camera["virtual"]["sensor"])
        self.light = spectrum(self.rig["light"]["spectrum"])
        self.band_weights = band_weights(self.camera, self.light)
        self.rng = np.random.default_rng([self.rig["virtual"]["seed"], zlib.crc32(self.name.encode())])
        self.faults = self.rig["virtual"]["imperfections"]
        self._drift = self._fault("light_drift", "relative_rms") * self.rng.normal()
        self.shots: list[Shot] = []
        self.hashes: dict[str, str] = {}

    def _fault(self, name: str, key: str) -> float:
        return float(self.faults[name][key]) if self.faults[name]["enabled"] else 0.0

    def real_pose(self, pose: Pose) -> Pose:
        """Return the pose that the rig takes when asked for another: off by the pose error."""
        rms = self._fault("pose_error", "rms_deg")
        light, camera = self.rng.normal(scale=rms, size=2) if rms else (0.0, 0.0)
        return replace(pose, light_deg=pose.light_deg + light, camera_deg=pose.camera_deg + camera)

    def _next_light(self) -> float:
        """Return the light's relative power for the next shot: a drift of first order about 1."""
        rms = self._fault("light_drift", "relative_rms")
        if rms == 0.0:
            return 1.0
        memory = math.exp(-1.0 / self.faults["light_drift"]["correlation_shots"])
        self._drift = memory * self._drift + math.sqrt(1.0 - memory**2) * self.rng.normal(scale=rms)
        return 1.0 + self._drift

    def _through_optics(self, response: np.ndarray) -> np.ndarray:
        height, width = response.shape
        loss, stray = self._fault("vignetting", "corner_loss"), self._fault("stray_light", "fraction")
        y, x = np.ogrid[:height, :width]
        radius2 = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / ((width**2 + height**2) / 4)
        return response * (1.0 - loss * radius2) + stray * response.mean()

    def shoot(self, role: str, pose: Pose, state: str, exposure_s: float, response, optics: bool = True) -> None:
        """Photograph one mosaic of responses and note the shot."""
        seen = self._next_light() * (self._through_optics(response) if optics else response)
        mosaic = self.sensor.expose(seen, exposure_s, self.rng)
        subject = pose.name if role == "object" else role
        file = f"{subject}-{state}-{len(self.shots):03d}.dng"
        write_dng(
            self.folder / file,
            mosaic,
            black_level=self.sensor.black_level,
            white_level=self.sensor.white_level,
            exposure_s=exposure_s,
            model=self.name,
        )
        self.shots.append(Shot(file, role, pose, state, exposure_s))
        self.hashes[file] = file_sha256(self.folder / file)

    def mosaic_of(self, bands: np.ndarray, state: str) -> np.ndarray:
        """Return the mosaic of a picture of the six bands, (height, width, 6) to (height, width)."""
        offset = 3 * _FILTER_STATES.index(state)
        y, x = np.indices(bands.shape[:2], sparse=True)
        return np.take_along_axis(bands, (offset + y % 2 + x % 2)[..., None], axis=2)[..., 0]


def capture_object(definition: dict, camera: dict, rig: dict, name: str, table: Path) -> None:
    """Photograph an object in all its poses, without and with the comb filter.

    Parameters
    ----------
    definition, camera, rig : dict
        Validated definitions.
    name : str
    table : Path
        ``captures.csv`` to write; the DNG files go beside it.
    """
    session = Session(camera, rig, name, Path(table).parent)
    sample = Sample.from_definition(definition)
    pinhole = Pinhole.from_optics(camera["optics"])
    for pose in track(expand_poses(definition["poses"]), f"capture {name}"):
        real = session.real_pose(pose)
        rotation = rig_from_object(real)
        position = rig["camera_distance_mm"] * to_camera(real)
        image = expose_object(
            sample,
            Tracer(on_table(sample.shape, rotation, rig["table_radius_mm"])),
            rotation,
            pinhole,
            position,
            rig_from_camera(real),
            to_light(real),
            session.band_weights,
            math.radians(rig["virtual"]["light_angular_radius_deg"]),
        )
        for state, exposures in definition["exposure_s"].items():
            for exposure_s in exposures:
                session.shoot("object", pose, state, exposure_s, image[_FILTER_STATES.index(state)])
    write_captures(table, session.shots, session.hashes)


def capture_camera(camera: dict, rig: dict, name: str, table: Path) -> None:
    """Photograph the chart, the white reference and dark frames that calibrate a camera."""
    session = Session(camera, rig, name, Path(table).parent)
    pinhole = Pinhole.from_optics(camera["optics"])
    height, width = pinhole.height_px, pinhole.width_px
    nowhere = Pose(0.0, 0.0)
    exposures = camera["exposure_s"]
    longest = max(e for group in exposures.values() for e in group)
    for _ in range(camera["dark_frames"]):
        session.shoot("dark", nowhere, "out", longest, np.zeros((height, width)))
    for role in ("white", "chart"):
        pose = Pose(**camera["poses"][role])
        reflectance = _chart_picture(camera, pinhole, rig, session.real_pose(pose), role)
        bands = reflectance @ session.band_weights.T
        for _ in range(camera["white_frames"] if role == "white" else 1):
            for state, group in exposures.items():
                for exposure_s in group:
                    session.shoot(role, pose, state, exposure_s, session.mosaic_of(bands, state))
    write_captures(table, session.shots, session.hashes)


def _chart_picture(camera: dict, pinhole: Pinhole, rig: dict, pose: Pose, role: str) -> np.ndarray:
    """Return reflectance times cosθ_i at each mosaic pixel, (height, width, 61)."""
    cosine = math.cos(flat_incidence_rad(pose))
    size = (pinhole.height_px, pinhole.width_px)
    if role == "white":
        return np.full((*size, 1), camera["white"]["reflectance_factor"] * cosine) * np.ones(61)
    _names, patches = chart_spectra(camera["chart"]["spectra"])
    rows, columns = camera["chart"]["rows"], camera["chart"]["columns"]
    y, x = np.indices(size)
    rotation = rig_from_object(pose)
    view = pinhole.directions(np.stack([x + 0.5, y + 0.5], axis=-1), rig_from_camera(pose)) @ rotation
    eye = rig["camera_distance_mm"] * to_camera(pose) @ rotation
    point = eye - view * (eye[2] / view[..., 2:])
    pitch = camera["virtual"]["chart_width_mm"] / columns
    across, along = point[..., 0] / pitch + columns / 2, rows / 2 - point[..., 1] / pitch
    column, row = np.floor(across).astype(int), np.floor(along).astype(int)
    patch = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    patch &= (np.abs(across - column - 0.5) < _PATCH_FILL) & (np.abs(along - row - 0.5) < _PATCH_FILL)
    index = np.where(patch, row * columns + column, len(patches))
    spectra = np.concatenate([patches, np.full((1, patches.shape[1]), _BORDER_REFLECTANCE)])
    return spectra[index] * cosine


def capture_environment(definition: dict, camera: dict, rig: dict, name: str, table: Path) -> None:
    """Photograph a virtual room with an omnidirectional camera, in brackets, without and with the filter."""
    session = Session(camera, rig, name, Path(table).parent)
    coefficients = room_coefficients(definition["virtual"], definition["image"]["width"], definition["image"]["height"])
    _names, spectra = source_spectra(definition["virtual"], session.light)
    # Band weights are for reflectances under the rig's light; a radiance is that light times a reflectance.
    bands = coefficients @ (spectra / session.light @ session.band_weights.T)
    # A panorama is resampled from many photographs: the four mosaic pixels of a superpixel see the same directions.
    bands = bands.repeat(2, axis=0).repeat(2, axis=1)
    pose = Pose(0.0, 0.0)
    for state, exposures in definition["exposure_s"].items():
        mosaic = session.mosaic_of(bands, state)
        for exposure_s in exposures:
            # An omnidirectional picture is stitched or unwrapped: its own vignetting is corrected there.
            session.shoot("environment", pose, state, exposure_s, mosaic, optics=False)
    write_captures(table, session.shots, session.hashes)
