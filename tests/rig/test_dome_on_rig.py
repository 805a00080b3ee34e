"""A ball on the virtual rig, its lamps around it, from pictures as a RAW developer writes them to a material."""

import csv
from pathlib import Path

import numpy as np
import pytest
from linear_files import develop_linearly
from made import made
from sessions import definitions

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import object_shots
from irodori.command_line import main
from irodori.config.capture_table import read_captures
from irodori.config.models import Camera, Object, Rig
from irodori.first_project.light_places import read_lamps
from irodori.first_project.mirror_highlights import write_light_places
from irodori.geometry.rig_frame import to_light
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

LAMPS = [(18, 10), (32, 75), (45, 140), (25, 200), (38, 260), (15, 310), (48, 20), (30, 160)]
SIZE = {"width_px": 400, "height_px": 300, "pixel_pitch_um": 19.2, "principal_point_px": [200.0, 150.0]}


@pytest.mark.heavy
def test_a_ball_of_the_virtual_rig_is_predicted_from_the_other_photographs(tmp_path, monkeypatch, capsys):
    """The rig's poses have errors, its lamp drifts, its lens has vignetting, and the ball has rings of two paints."""
    monkeypatch.chdir(tmp_path)
    # Other tests of this process may have registered lobes of their own, one of them next to the paper's.
    monkeypatch.setattr("irodori.first_project.dome_command.names", lambda: ("gaussian", "ggx"))
    poses = [{"light_deg": [float(a)], "camera_deg": [0.0], "light_azimuth_deg": [float(b)]} for a, b in LAMPS]
    ball, camera, rig = definitions(poses=poses)
    ball |= {"shape": {"kind": "sphere", "radius_mm": 30.0}, "mirror_weight": 0.0, "exposure_s": {"out": [0.02]}}
    ball["virtual"] = {
        "pattern": {"kind": "checks", "columns": 1, "rows": 6},
        "materials": [{"spectrum": s, "beta": 3.0, "mu_rad": 0.25} for s in ("TCS75", "TCS69")],
    }
    camera["optics"] |= SIZE
    eye, stand, subject, bench = made(Camera, camera), made(Rig, rig), made(Object, ball), Bench()
    planned = object_shots(subject, eye, ".dng")
    device = VirtualCamera(eye, stand, bench, "ball", planned, subject)
    journal = Journal(tmp_path / "captures.csv")
    Session(device, AutoOperator(bench.set), journal, None, take_stock(journal, planned)).run(planned, "ball")
    shots = read_captures("captures.csv")
    for shot in shots:
        develop_linearly(shot.file, Path(shot.file).with_suffix(".tif"))
    write_light_places("dome.lp", {Path(shot.file).stem: to_light(shot.pose) for shot in shots})
    files = [str(Path(shot.file).with_suffix(".tif")) for shot in shots]
    assert main(["dome", *files, "--linear", "--lights", "dome.lp", "--error-deg", "0.5"]) == 0
    told = capsys.readouterr().out
    rows = list(csv.DictReader(Path("dome/left-out.csv").read_text(encoding="utf-8").splitlines()))
    errors = np.array([float(row["relative_rms"]) for row in rows])
    assert errors.mean() < 0.025 and errors.max() < 0.04
    positions, levels = read_lamps("dome/lamps.csv")
    assert np.abs(np.array(list(levels.values())) - 1.0).max() < 0.02
    assert "gloss gaussian: beta" in told, told
    for shot in shots:
        # The camera stands 30 radii away and counts as far.
        cosine = np.dot(positions[Path(shot.file).stem.lower()], to_light(shot.pose))
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 2.0, shot.pose
