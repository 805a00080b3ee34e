"""The cost of the virtual rig's faults: what is halved, which faults are tried, and what stands in the table."""

from dataclasses import replace

import numpy as np
import pytest
from definitions import ROOT

from irodori.capture.shot_list import object_shots
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.capture_table import expand_poses
from irodori.config.definitions import read_yaml
from irodori.config.models import Camera, Object, Placing, PoseGroup, Rectify, Rig, Size
from irodori.core.provenance import config_hash
from irodori.evaluation import imperfection_costs as module
from irodori.evaluation.imperfection_costs import Settings, SmallChain, measure_imperfections, run_chain
from irodori.evaluation.result_tables import CostRow, read_rows
from irodori.fitting.solvers import FitOptions
from irodori.ingest.ingest_options import IngestOptions
from irodori.material.material_file import Material
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.simulation.virtual_rig.ground_truth import true_material

FAULTS = ["light drift", "vignetting", "stray light", "pose error", "lamp spectrum", "laid off", "focal length",
          "filter plate", "hot pixels"]  # fmt: skip


@pytest.fixture(scope="module")
def chain() -> SmallChain:
    # Read as they stand: to check all definitions takes longer than all of these tests but one.
    files = {Object: "objects/tile-plate", Camera: "cameras/d5100-comb", Rig: "rigs/virtual"}
    found = [kind.of(read_yaml(ROOT / "config" / f"{name}.yaml")) for kind, name in files.items()]
    settings = Settings(IngestOptions(), Placing(), Rectify.of({}), FitOptions(), CompressOptions(), ["D65", "A"])
    return SmallChain("tile-plate", *found, settings)


def test_half_the_resolution_sees_the_same_scene(chain):
    halved = chain.halved()
    own, half = chain.camera.optics, halved.camera.optics
    assert (half.width_px, half.height_px) == (400, 300)
    # The sensor keeps its size, and a point that lay in its middle lies there still.
    assert half.width_px * half.pixel_pitch_um == own.width_px * own.pixel_pitch_um
    assert half.principal_point_px == (200.0, 150.0) and half.focal_length_mm == own.focal_length_mm
    for name, xy in vars(chain.camera.chart.centres_px).items():
        # A superpixel of the smaller picture holds 2 x 2 of the larger: its centre lies between theirs.
        seen = getattr(halved.camera.chart.centres_px, name)
        assert np.multiply(seen, 2.0) + 0.5 == pytest.approx(xy)
    assert halved.camera.chart.patch_px == 10
    plate, half_plate = chain.faults.filter_plate, halved.faults.filter_plate
    assert half_plate.shift_px == (0.8, -0.45) and half_plate.repeat_rms_px == 0.15
    assert half_plate == replace(plate, shift_px=(0.8, -0.45), repeat_rms_px=0.15)
    assert replace(halved.faults, filter_plate=plate) == chain.faults
    odd = replace(chain, camera=replace(chain.camera, optics=replace(own, width_px=806, height_px=602)))
    assert (odd.halved().camera.optics.width_px, odd.halved().camera.optics.height_px) == (402, 300)


def test_a_chart_without_places_or_of_the_smallest_patches_is_halved_as_far_as_it_goes(chain):
    chart = replace(chain.camera.chart, centres_px=None, patch_px=1)
    halved = replace(chain, camera=replace(chain.camera, chart=chart)).halved()
    assert halved.camera.chart.centres_px is None and halved.camera.chart.patch_px == 1
    chart = replace(chart, patch_px=None)
    assert replace(chain, camera=replace(chain.camera, chart=chart)).halved().camera.chart.patch_px is None


def test_an_object_keeps_six_poses_at_most_and_64_texels(chain):
    poses = expand_poses(chain.definition.poses)
    kept = expand_poses(chain.halved().definition.poses)
    # Evenly from the first on.
    assert len(poses) > 6 and len(kept) <= 6
    step = -(-len(poses) // 6)
    assert kept == poses[::step]
    few = replace(chain.definition, poses=chain.definition.poses[:1], texels=Size(width=90, height=20))
    few = replace(few, poses=tuple(PoseGroup(**{n: (a,) for n, a in vars(p).items()}) for p in poses[:6]))
    halved = replace(chain, definition=few).halved().definition
    assert expand_poses(halved.poses) == poses[:6] and halved.texels == Size(width=64, height=20)


def test_each_fault_is_tried_alone_and_all_together(chain):
    variants = dict(chain.variants())
    names = [f"{name} alone" for name in FAULTS]
    assert list(variants) == ["none", *names, "all", "all, and GGX in place of equation (5)"]
    for label, variant in variants.items():
        enabled = [name.replace("_", " ") for name, fault in vars(variant.faults).items() if fault.enabled]
        wanted = {"none": []} | {f"{name} alone": [name] for name in FAULTS}
        assert enabled == wanted.get(label, FAULTS), label
        assert (variant.definition == chain.definition) == (not label.endswith("(5)"))
    others = variants["all, and GGX in place of equation (5)"].definition.virtual.materials
    for own, other in zip(chain.definition.virtual.materials, others, strict=True):
        assert (own.lobe, other.lobe) == ("gaussian", "ggx")
        assert (other.spectrum, other.beta, other.mu_rad) == (own.spectrum, own.beta, own.mu_rad)
    # A material whose gloss is not that of the equation keeps it beside one whose gloss is replaced.
    mixed = (replace(others[0], lobe="ggx", mu_rad=0.33), *chain.definition.virtual.materials[1:])
    virtual = replace(chain.definition.virtual, materials=mixed)
    *_, (_, last) = replace(chain, definition=replace(chain.definition, virtual=virtual)).variants()
    assert last.definition.virtual.materials[0] == mixed[0]
    # What is switched off in the rig's file is not tried, and an object of another model has no further one.
    quiet = chain.with_faults(replace(chain.faults, vignetting=replace(chain.faults.vignetting, enabled=False)))
    quiet = replace(quiet, definition=variants["all, and GGX in place of equation (5)"].definition)
    labels = [label for label, _ in quiet.variants()]
    assert labels == ["none", *(name for name in names if name != "vignetting alone"), "all"]


def two_paints(side=12) -> Material:
    """Return a truth of two paints side by side."""
    spectra = np.linspace([0.2, 0.6], [0.5, 0.3], 61)
    index = np.broadcast_to(np.arange(side) * 2 // side, (side, side))
    green = spectra[30][index]
    return Material(alpha=green, beta=np.full((side, side), 2.0), mu=np.full((side, side), 0.1), green_response=green,
                    coefficients=np.eye(2, dtype=np.float32)[index], basis=spectra, n=np.full(61, 1.5),
                    k=np.zeros(61), mirror=0.0, typical_gloss=(2.0, 0.1))  # fmt: skip


def test_pictures_that_runs_share_change_no_photograph(chain, tmp_path):
    small, seen = chain.halved(), {}
    shots = object_shots(small.definition, small.camera, ".dng")[:1]
    for label, variant in small.variants():
        taken = []
        for kept in ({}, seen.setdefault(config_hash(variant.sight), {})):
            folder = tmp_path / f"{label} {len(taken)}"
            module._photograph(shots, variant, "plate", variant.definition, folder, kept)
            taken.append((folder / shots[0].file).read_bytes())
        assert taken[0] == taken[1], label
    assert 1 < len(seen) < len(FAULTS)


def test_a_row_says_how_far_the_chain_is_off_away_from_seams_and_holes(chain, monkeypatch, tmp_path):
    truth = two_paints()
    side = np.broadcast_to(np.arange(12), (12, 12))
    inside = (side < 4) | (side > 7)
    beta, mu = np.full((12, 12), 2.2), np.full((12, 12), 0.13)
    beta[:, :4], mu[:, :2] = 1.9, np.nan
    beta[:, 4:8] = 100.0  # at the seam, where nothing counts
    hole = np.where((side == 11), np.nan, truth.alpha)
    wide = truth.basis * np.linspace(0.9, 1.1, 61)[:, None]
    found = replace(truth, basis=wide, beta=beta, mu=mu, alpha=hole, green_response=hole)
    folders = []

    def run(variant, folder, seen, calibrated):
        """Take an empty folder of its own for every run, and what was seen of the same definition before."""
        assert isinstance(variant, SmallChain) and folder.is_dir() and not list(folder.iterdir())
        assert seen.setdefault("definition", variant.definition) == variant.definition
        folders.append(folder)
        return found

    monkeypatch.setattr(module, "run_chain", run)
    monkeypatch.setattr(module, "true_material", lambda *_: truth)
    measure_imperfections(chain, tmp_path / "costs.csv")
    rows = read_rows(tmp_path / "costs.csv", CostRow)
    assert len(set(folders)) == 12 and not any(folder.exists() for folder in folders)
    assert len(rows) == 2 * 12 and [row.light for row in rows[:2]] == ["D65", "A"]
    assert rows[0].faults == "none" and rows[-1].faults.startswith("all, and GGX")
    chosen = inside & (side < 11)
    for row in rows:
        exact, own = (m.coefficients[chosen] @ m.basis.T for m in (truth, found))
        off = delta_e_reflectance(exact, own, row.light)
        assert row.count == chosen.sum() == 12 * 7
        assert row.mean == pytest.approx(off.mean(), rel=1e-4) and row.max == pytest.approx(off.max(), rel=1e-4)
        assert row.p95 == pytest.approx(np.percentile(off, 95), rel=1e-4)
        # Four columns are 5 % off in beta, three 10 %; mu is stated in five of seven.
        assert row.beta == pytest.approx(0.05) and row.mu == pytest.approx(0.3) and row.known == pytest.approx(5 / 7)


def test_gloss_that_nobody_states_and_a_plate_that_nobody_saw_have_no_error(chain, monkeypatch):
    truth = two_paints()
    nothing = np.full((12, 12), np.nan)
    monkeypatch.setattr(module, "true_material", lambda *_: truth)
    monkeypatch.setattr(module, "run_chain", lambda *_: replace(truth, beta=nothing, mu=nothing))
    row = module.cost_rows("x", chain)[0]
    assert np.isnan(row.beta) and np.isnan(row.mu) and row.known == 0.0 and row.mean == 0.0


def test_a_small_chain_finds_the_object_on_a_rig_without_faults(chain, tmp_path):
    """A quarter of the camera's sides, its six poses and 12 x 12 texels: colours are there, within its few samples."""
    small = chain.halved().halved()
    definition = replace(small.definition, texels=Size(width=12, height=12))
    small = dict(replace(small, definition=definition).variants())["none"]
    seen: dict = {}
    calibrated: dict = {}
    found = run_chain(small, tmp_path, seen, calibrated)
    assert found.alpha.shape == (12, 12) and found.observed.mean() > 0.8 and seen
    truth = true_material(definition, small.camera, small.rig)
    exact, own = (m.coefficients[found.observed] @ m.basis.T for m in (truth, found))
    off = delta_e_reflectance(exact, own)
    assert np.median(off) < 4.0
    assert {path.name for path in tmp_path.iterdir()} >= {"reference.h5", "chart.h5", "calibration.h5", "tile.h5",
                                                          "brdf.h5", "material.h5", "camera", "object"}  # fmt: skip


def test_a_ball_under_a_dome_of_lamps_is_found_by_a_camera_that_stays_where_it_is(chain, tmp_path):
    """Ten lamps above the table, of which eight stand beside the plane that all others are in."""
    ball = Object.of(read_yaml(ROOT / "config/objects/vermilion-sphere.yaml"))
    small = replace(chain, definition=ball).halved().halved()
    lamps = PoseGroup(light_deg=(30.0, 55.0), camera_deg=(0.0,), light_azimuth_deg=(0.0, 72.0, 144.0, -144.0, -72.0))
    definition = replace(ball, texels=Size(width=24, height=12), poses=(lamps,))
    small = dict(replace(small, definition=definition).variants())["none"]
    found = run_chain(small, tmp_path)
    truth = true_material(definition, small.camera, small.rig)
    seen = found.observed & (np.arange(12) < 5)[:, None]  # well above the equator
    exact, own = (m.coefficients[seen] @ m.basis.T for m in (truth, found))
    colour = np.median(delta_e_reflectance(exact, own))
    assert seen[:5].mean() > 0.8 and colour < 2.0
    off = (found.alpha / truth.alpha - 1.0)[seen]
    assert np.median(np.abs(off)) < 0.02
