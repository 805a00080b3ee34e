"""A session of photographs seen by the example camera's sensor, for tests of ingestion."""

from pathlib import Path

import numpy as np
import yaml

from irodori.config.capture_table import Pose, Shot, write_captures
from irodori.core import store
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.sensor import Sensor

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "raw"
CAMERA = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())
SENSOR = Sensor(**CAMERA["virtual"]["sensor"])
BLACK, WHITE = 600, 16383
PROVENANCE = store.Provenance("test")
SIZE = (160, 240)
BALANCE = np.array([[0.7, 1.0, 0.5], [0.30, 0.45, 0.2]])  # of a perfect diffuser's bands, without and with filter
REFLECTANCE, ANGLE = 0.95, 40.0
SUPERPIXELS = IngestOptions(register=False)


def dng(path, mosaic, black=BLACK, white=WHITE, exposure_s=0.02):
    write_dng(path, mosaic, black_level=black, white_level=white, exposure_s=exposure_s, model="test")
    return path


def random_mosaic(rng, height=64, width=96, top=WHITE) -> np.ndarray:
    return rng.integers(0, top + 1, (height, width), dtype=np.uint16)


def vignetting(height=SIZE[0], width=SIZE[1]) -> np.ndarray:
    y, x = np.ogrid[:height, :width]
    radius2 = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / ((height**2 + width**2) / 4)
    return 1.0 - 0.3 * radius2


def scene(rng) -> np.ndarray:
    """True responses of six bands on superpixels: a gradient and blocks, 0.02..0.9."""
    height, width = SIZE[0] // 2, SIZE[1] // 2
    blocks = np.kron(rng.uniform(0.05, 0.9, (height // 20, width // 20, 6)), np.ones((20, 20, 1)))
    return blocks * np.linspace(0.5, 1.0, width)[None, :, None]


class Studio:
    """A session of photographs with vignetting, seen by the sensor of the example camera.

    ``light`` is the lamp's power, ``curve`` what a camera does to the light before its sensor counts it, ``spoil``
    what it does to the numbers.
    """

    def __init__(self, folder: Path, seed: int, sensor: Sensor = SENSOR) -> None:
        self.folder, self.rng, self.sensor, self.shots = folder, np.random.default_rng(seed), sensor, []
        self.count, self.light, self.curve, self.spoil = 0, 1.0, lambda well: well, lambda mosaic, exposure_s: mosaic

    def shoot(self, role, truth, state="out", exposure_s=0.02, light_deg=ANGLE):
        """Photograph the true responses of six bands, given on superpixels, or on the mosaic of SIZE."""
        index = ("out", "in").index(state)
        bands = truth[..., 3 * index : 3 * index + 3] * BALANCE[index]
        if bands.shape[:2] != SIZE:
            bands = bands.repeat(2, axis=0).repeat(2, axis=1)
        y, x = np.indices(bands.shape[:2])
        mosaic = np.take_along_axis(bands, (y % 2 + x % 2)[..., None], axis=2)[..., 0] * vignetting(*bands.shape[:2])
        self.expose(role, self.light * mosaic, state, exposure_s, light_deg)

    def expose(self, role, mosaic, state="out", exposure_s=0.02, light_deg=ANGLE):
        """Photograph what falls on each mosaic pixel."""
        self.count += 1
        file = f"{self.count:03d}.dng"
        well = self.sensor.response_at_full_well * self.sensor.base_exposure_s / exposure_s
        seen = self.curve(mosaic / well) * well
        numbers = self.spoil(self.sensor.expose(seen, exposure_s, self.rng), exposure_s)
        dng(self.folder / file, numbers, self.sensor.black_level, self.sensor.white_level, exposure_s)
        self.shots.append(Shot(file, role, Pose(light_deg, 0.0), state, exposure_s))

    def table(self) -> Path:
        write_captures(self.folder / "captures.csv", self.shots)
        return self.folder / "captures.csv"

    def references(self, frames=2, darks=4):
        superpixels = (SIZE[0] // 2, SIZE[1] // 2, 6)
        for _ in range(darks):
            self.shoot("dark", np.zeros(superpixels), exposure_s=0.02)
        white = np.full(superpixels, REFLECTANCE * np.cos(np.radians(ANGLE)))
        for state, exposure_s in (("out", 0.02), ("in", 0.05)):
            for _ in range(frames):
                self.shoot("white", white, state, exposure_s)

    def reference(self, options=SUPERPIXELS) -> Path:
        path = self.folder / "reference.h5"
        ingest_reference(self.table(), self.folder, path, PROVENANCE, REFLECTANCE, options)
        return path

    def linear(self, capture: str, options=SUPERPIXELS) -> Path:
        reference, output = self.reference(options), self.folder / "linear.h5"
        ingest_raw(self.table(), self.folder, capture, reference, output, PROVENANCE, options=options)
        return output

    def ingest(self, capture: str, options=SUPERPIXELS):
        with store.open_file(self.linear(capture, options)) as file:
            return file.read("response"), file.read("valid"), file.read("noise_model"), file.attribute("pose_deg")
