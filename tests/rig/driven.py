"""A driven rig without hardware: a simulated Grbl board, a person played by the test, a simulated EOS 40D.

The camera's files are those of the virtual camera, so that they decode. They show what stands before the lens as the
session asks for it, the white reference in place of the object; they do not follow the rig.
"""

import shutil
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import yaml
from made import made
from sessions import ROOT, definitions
from simulated_gphoto2 import Bench

from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Camera, Rig
from irodori.core.yaml_files import read_own_yaml
from irodori.simulation.virtual_rig import bench as virtual
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

CAMERA, OBJECT = "eos-40d-comb", "jar"
POSES = [{"light_deg": [45.0, 60.0], "camera_deg": [0.0, 20.0]}]


class Studio:
    """The camera of a driven rig; its pictures follow from its settings and the shot alone."""

    def __init__(self, pause: Callable[[], None] = lambda: None) -> None:
        self.pause = pause
        self.bench = Bench(delivers=[(0.5, "capt{}.cr2", self.picture)])
        self.shot = Shot("", "white", Pose(45.0, 0.0), "out", 1.0)
        self._made: dict[tuple, bytes] = {}

    def following(self, capture: Callable) -> Callable:
        """Return a camera's `capture` that tells here first what stands before the lens."""

        def told(camera, shot: Shot, path: Path) -> None:
            self.shot = shot
            capture(camera, shot, path)

        return told

    def picture(self) -> bytes:
        """Return the RAW file of a photograph with the settings that stand."""
        self.pause()
        values = self.bench.values
        key = (self.shot, *(values[name] for name in ("shutterspeed", "iso", "aperture")))
        if key not in self._made:
            seconds, iso, aperture = (float(Fraction(text)) for text in key[1:])
            subject = self.shot.role if self.shot.role in ("dark", "chart") else "white"
            shot = Shot(self.shot.file, subject, Pose(45.0, 0.0), self.shot.filter, seconds, iso, aperture)
            _, camera, rig = definitions()
            standing = virtual.Bench(by_hand_deg={"light_deg": 45.0}, subject=subject, filter=shot.filter)
            with tempfile.TemporaryDirectory() as folder:
                VirtualCamera(made(Camera, camera), made(Rig, rig), standing, "standin", [shot]).capture(
                    shot, Path(folder) / "a.dng"
                )
                self._made[key] = (Path(folder) / "a.dng").read_bytes()
        return self._made[key]


def edit(path: Path, **changes) -> None:
    """Set keys of a YAML file; ``a__b`` is b in a."""
    content = read_own_yaml(path)
    for dotted, value in changes.items():
        *parents, last = dotted.split("__")
        block = content
        for parent in parents:
            block = block[parent]
        block[last] = value
    path.write_text(yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False))


def project(folder: Path, operator: str = "file", port: str = "simulator") -> Path:
    """Return a working directory with the repository's driven rig, its board simulated, and an object on it."""
    shutil.copytree(ROOT / "config", folder / "config")
    config = folder / "config"
    edit(config / "rigs/gonio-grbl.yaml", operator=operator, operator_deadline_s=600.0, motion__port=port)
    edit(config / "rigs/gonio-grbl.yaml", motion__simulator={"time_scale": 200.0}, motion__timeout_s=20.0)
    edit(config / "rigs/gonio-grbl.yaml", drift_every=0)
    edit(config / f"cameras/{CAMERA}.yaml", dark_frames=1, white_frames=1, linearity_exposure_s=[0.01])
    jar = read_own_yaml(config / "objects/tile-plate.yaml")
    del jar["virtual"]
    jar |= {"camera": CAMERA, "poses": POSES, "captures": {"table": "photos/jar.csv", "folder": "photos/jar"}}
    (config / f"objects/{OBJECT}.yaml").write_text(yaml.safe_dump(jar))
    return folder
