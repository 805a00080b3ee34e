"""The whole chain at 16 x 16 texels: what it makes, and what a change makes it do again."""

import csv
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
import yaml
from accessibility import violations
from project import ROOT, edit, planned, small_project, snakemake
from written_files import KINDS, PAGE, of_page, of_results, tables

from benchmarks.written_pictures import spectra_in
from irodori.calibration.verdict import TOLERANCES
from irodori.config.definitions import load_definitions
from irodori.config.photograph_sets import light_definition, material_definition
from irodori.core.errors import InputError
from irodori.core.made_of import made_of, refuse_changed_definition
from irodori.core.store import open_file
from irodori.core.units import require_unit
from irodori.core.yaml_files import read_yaml
from irodori.evaluation.registration_errors import summarise
from irodori.evaluation.result_tables import RegistrationRow, read_rows
from irodori.material.material_file import Material
from irodori.report.page import typical_gloss_text
from irodori.viewer.browser import browser_command

STAGES_AFTER_FIT = {
    "measure_levels",
    "fit_brdf",
    "share_gloss",
    "compress_reflectance",
    "render_view",
    "encode_viewer",
    "export_viewer",
    "compare_photograph",
    "measure_error_budget",
    "measure_errors",
    "write_report",
    "all",
}


def errors(folder) -> dict[tuple[str, str, str], dict]:
    with (folder / "results/still-life/errors.csv").open(newline="") as stream:
        return {(r["subject"], r["quantity"], r["light"]): r for r in csv.DictReader(stream)}


def test_one_command_leaves_pictures_report_and_errors(finished):
    radiance = spectra_in(finished / "results/still-life/front.exr")[1]
    assert radiance.shape == (36, 48, 61)
    assert np.isfinite(radiance).all() and (radiance >= 0).all() and radiance.max() > 0.1
    assert (finished / "results/still-life/front.png").read_bytes().startswith(b"\x89PNG")
    page = (finished / "results/still-life/report.html").read_text()
    assert page.count("data:image/png;base64") >= 6 and "CIEDE2000" in page
    for name in ("tile-plate", "leaf-sphere"):
        found = summarise(read_rows(finished / f"results/{name}/registration.csv", RegistrationRow))
        assert found.by_capture + found.by_chart > 0 and found.by_none == 0
        assert typical_gloss_text(Material.load(finished / f"results/{name}/material.h5")) in page
        assert f"<td>{name}</td><td>{found.by_capture}</td><td>{found.by_chart}</td>" in page


@pytest.mark.heavy
@pytest.mark.skipif(browser_command() is None, reason="NO BROWSER: pages are not tested; install Debian's chromium")
def test_nothing_in_the_report_bars_anyone(finished):
    assert violations([finished / "results/still-life/report.html"]) == {}


def test_the_report_holds_the_calibration_against_every_guideline_with_the_source_of_each_limit(finished):
    page = (finished / "results/still-life/report.html").read_text()
    for guideline in ("FADGI 2016", "FADGI 2023", "Metamorfoze 1.0", "Metamorfoze 2.0", "ISO 19264-1:2021"):
        assert page.count(f"<td>{guideline}</td>") == len(
            {(t.metric, t.statistic) for t in TOLERANCES if t.guideline == guideline}
        )
    assert "<td>a secondary source, not the document</td>" in page and "<td>the document</td>" in page


@pytest.mark.heavy
def test_reports_and_clusters_name_no_number_of_cores_and_need_none(tmp_path):
    folder = small_project(tmp_path / "still-life")
    run = snakemake(folder, "--summary", cores=None)
    assert run.returncode == 0 and "results/still-life/report.html" in run.stdout, run.stderr[-2000:]


@pytest.mark.heavy
def test_what_measuring_speed_takes_is_not_counted_as_time_of_the_results(tmp_path):
    run = snakemake(small_project(tmp_path / "still-life"), "--dry-run", "benchmark")
    assert run.returncode == 0, run.stderr[-2000:]
    kept = [line.split()[1] for line in run.stdout.splitlines() if line.strip().startswith("benchmark: ")]
    assert len(kept) == 12 and not [path for path in kept if path.startswith("results/benchmarks/")]


def test_the_terminal_shows_what_snakemake_says_and_the_result_and_nothing_of_libraries(finished):
    (log,) = (finished / ".snakemake/log").glob("*.log")
    expected = (
        "Using workflow specific profile ",
        "Assuming unrestricted shared filesystem",
        "Pictures, errors and times",
    )
    other = set((finished / "terminal.txt").read_text().splitlines()) - set(log.read_text().splitlines())
    assert [line for line in other if not line.startswith(expected)] == []


def test_a_photograph_is_compared_with_its_view_and_the_report_shows_it(finished):
    folder = finished / "results/still-life/photographs/front"
    found = json.loads((folder / "comparison.json").read_text())
    assert found["delta_e"]["count"] > 8000 and found["compared_fraction"] > 0.8
    difference, noise = found["delta_e"], found["noise_floor"]
    assert 0 < noise["mean"] < difference["mean"] < difference["p95"] < difference["max"]
    assert len(found["noise_counts"]) == 3 and 0.9 < found["luminance_ratio"] < 1.1
    page = (finished / "results/still-life/report.html").read_text()
    assert "Beside a photograph" in page and "Words of this page" in page and f"{found['delta_e']['mean']:.4g}" in page


def test_recovered_materials_are_near_the_truth(finished):
    table = errors(finished)
    for subject in ("tile-plate", "leaf-sphere"):
        for light in ("D65", "A"):
            assert float(table[subject, "reflectance CIEDE2000 away from seams", light]["mean"]) < 1.5
        assert float(table[subject, "alpha absolute away from seams", ""]["p95"]) < 0.05
    assert float(table["tile-plate", "beta relative away from seams, where known", ""]["mean"]) < 0.1
    assert float(table["tile-plate", "mu relative away from seams, where known", ""]["mean"]) < 0.1
    assert float(table["d5100-comb", "leave-one-patch-out CIEDE2000", "D65"]["mean"]) < 1.0
    assert (
        float(table["still-life/front", "picture CIEDE2000 to true materials, objects only", "classroom"]["mean"]) < 2.0
    )


def test_the_fit_uses_the_errors_of_the_registration_and_material_and_report_say_so(finished):
    page = (finished / "results/still-life/report.html").read_text()
    for subject in ("tile-plate", "leaf-sphere"):
        folder = finished / "results" / subject
        # The two were photographed together, and the sphere in two placements.
        errors = []
        for path in sorted(folder.glob("placement*.h5")):
            with open_file(path) as file:
                errors.append(file.read("angle_error"))
        assert len(errors) == 1 + (subject == "leaf-sphere")
        theta_i, _, _, phi = np.sqrt(np.mean(np.square(errors), axis=0))
        with open_file(folder / "material.h5") as file:
            used = file.attribute("errors", dict)["angle_errors"]
        assert used == {"theta_i_deg": pytest.approx(theta_i), "phi_deg": pytest.approx(phi), "source": "registered"}
        assert 0.03 < phi < 0.3 and f"{phi:.3f} deg to the half vector, by registration" in page
        log = finished / f"results/logs/fit_brdf/{subject}_000.log"
        assert f"{phi:.3f} deg to the half vector, by registration" in log.read_text()


def test_a_material_states_the_definition_that_it_was_made_of(finished):
    loaded = load_definitions(read_yaml(finished / "config/config.yaml"), finished)
    for name, definition in loaded.objects.items():
        now, file = made_of(material_definition(definition), ()), finished / f"results/{name}/material.h5"
        refuse_changed_definition(file, now, Path(name), "snakemake")
        with pytest.raises(InputError, match="made before mirror_weight of"):
            refuse_changed_definition(file, now | {"mirror_weight": 0.9}, Path(name), "snakemake")


def test_a_light_states_the_definition_that_it_was_made_of(finished):
    place = load_definitions(read_yaml(finished / "config/config.yaml"), finished).environments["classroom"]
    now, file = made_of(light_definition(place), ()), finished / "results/environments/classroom.h5"
    refuse_changed_definition(file, now, Path("classroom.yaml"), "snakemake")
    with pytest.raises(InputError, match=r"made before lamps of classroom\.yaml changed"):
        refuse_changed_definition(file, now | {"lamps": ["FL2"]}, Path("classroom.yaml"), "snakemake")


def test_a_sphere_that_was_turned_over_is_known_on_both_halves(finished):
    folder = finished / "results/leaf-sphere"
    found, truth = Material.load(folder / "material.h5"), Material.load(folder / "truth.h5")
    rows = len(found.alpha)
    for half in (slice(0, rows // 2 - 2), slice(rows // 2 + 2, rows)):
        assert np.isfinite(found.alpha[half]).mean() > 0.9
        assert np.nanmedian(np.abs(found.alpha[half] / truth.alpha[half] - 1.0)) < 0.03
    captures = {}
    for path in sorted(folder.glob("observations/tile-*.h5")):
        with open_file(path) as file:
            first, last = file.attribute("rows")
            seen = (file.read("weight") > 0.0).any(axis=0)
            for number in (1, 2):
                if seen[file.read("placement") == number].any():
                    captures.setdefault(number, []).append((first, last))
    # The poles, which are opposite: each is seen in one placement, and what lies between in both or in one.
    assert captures[1][0][0] == 0 and captures[2][-1][1] == rows


def test_every_file_says_where_it_came_from(finished):
    files = sorted((finished / "results").rglob("*.h5"))
    assert len(files) > 20
    for path in files:
        with open_file(path) as file:
            for name in ("rule", "config_hash", "code_hash", "created_by"):
                file.attribute(name)
        with h5py.File(path) as file:
            missing = []
            file.visititems(
                lambda name, item, missing=missing: (
                    missing.append(name)
                    if isinstance(item, h5py.Dataset) and not {"units", "dims", "quantity"} <= set(item.attrs)
                    else None
                )
            )
        assert not missing, f"{path}: {missing}"


def test_every_file_is_read_by_xarray_with_named_axes_and_by_any_h5py(finished):
    """No program needs a plugin or this package: axes, units and codes are HDF5's and netCDF's own."""
    of_h5py = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32, h5py.h5z.FILTER_LZF}
    for path in sorted((finished / "results").rglob("*.h5")):
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            variables = [one for group in tree.subtree for one in group.variables.values()]
            assert variables
            for one in variables:
                assert list(one.dims) == [axis for axis in one.attrs["dims"].split(",") if axis], path
                require_unit(one.attrs["units"])
        with h5py.File(path) as file:
            filters = set()
            file.visititems(
                lambda name, item, filters=filters: (
                    filters.update(plist.get_filter(i)[0] for i in range(plist.get_nfilters()))
                    if isinstance(item, h5py.Dataset) and (plist := item.id.get_create_plist())
                    else None
                )
            )
            assert filters <= of_h5py, path
            assert (h5py.h5z.FILTER_LZF in filters) == ("packing" in file.attrs), path


def test_the_page_of_files_lists_every_dataset_as_the_files_say(finished):
    page = of_page(PAGE.read_text(encoding="utf-8")).splitlines()
    found = of_results(finished / "results")
    for line in tables(found).splitlines():
        assert line in page, line
    unlisted = [title for number, (_, _, title) in enumerate(KINDS) if number not in found]
    # No patch is in a frame, and the scene has no light maps.
    patch = "The lamp's level in every photograph, by a patch in the frame"
    baked = "Light that falls on the objects of a scene, baked"
    assert unlisted == [patch, baked]


def test_texels_that_nothing_determines_are_marked_and_not_invented(finished):
    with open_file(finished / "results/leaf-sphere/material.h5") as file:
        status, alpha, mu = file.read("status"), file.read("alpha"), file.read("mu")
    few = status == 3
    assert few.any(), "the underside of a sphere on the table is never seen"
    assert np.isnan(alpha[few]).all() and np.isnan(mu[few]).all()
    assert np.isfinite(alpha[~few]).all()
    figures = json.loads((finished / "results/still-life/front.json").read_text())
    assert np.isclose(figures["filled_fraction"]["leaf-sphere"], few.mean())


def test_stages_after_the_capture_never_read_the_truth():
    text = {p.name: p.read_text() for p in (ROOT / "workflow/scripts").glob("*.py")}
    rooms = ("irodori.capture", "irodori.simulation")
    knowing = {name for name, code in text.items() if any(room in code for room in rooms)}
    allowed = {name for name in text if name.startswith(("capture_", "write_true"))} | {"write_truth.py"}
    assert knowing == allowed


def test_a_second_run_does_nothing(again):
    run = snakemake(again, "--dry-run")
    assert run.returncode == 0 and "Nothing to be done" in run.stdout + run.stderr


def of_neighbour(jobs) -> set[str]:
    """Return the rules of the jobs about the plate, which is photographed together with the sphere."""
    return {rule for rule, wildcards in jobs if wildcards.get("object") == "tile-plate"}


def test_one_objects_file_reruns_that_object_and_the_place_of_those_photographed_with_it(again):
    edit(again / "config/objects/leaf-sphere.yaml", {"refractive_index": {"n": 1.6, "k": 0.0}})
    jobs = planned(snakemake(again, "--dry-run"))
    touched = {wildcards["object"] for _, wildcards in jobs if "object" in wildcards}
    assert touched == {"leaf-sphere", "tile-plate"}
    assert not {"capture_object", "check_captures", "register_object"} & of_neighbour(jobs)
    assert {
        "capture_object",
        "combine_registrations_leaf_sphere",
        "fit_brdf",
        "compress_reflectance",
        "render_view",
    } <= {rule for rule, _ in jobs}
    assert not {"calibrate_camera", "prepare_environment", "capture_camera"} & {rule for rule, _ in jobs}


def test_words_for_people_make_only_the_page_again(again):
    for file in ("objects/leaf-sphere", "cameras/d5100-comb", "rigs/virtual", "environments/classroom"):
        edit(again / f"config/{file}.yaml", {"description": "other words"})
    assert not planned(snakemake(again, "--dry-run"))
    edit(again / "config/scenes/still-life.yaml", {"description": "another title"})
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    assert rules == {"encode_viewer", "export_viewer", "write_report", "all"}


def test_what_no_photograph_depends_on_takes_none_again(again):
    edit(again / "config/objects/leaf-sphere.yaml", {"lobes": ["gaussian"], "plan": {"count": 9}})
    edit(again / "config/cameras/d5100-comb.yaml", {"calibration.texel_photographs": 8})
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    assert {"calibrate_camera", "fit_brdf"} <= rules
    assert not [rule for rule in rules if rule.startswith(("capture", "ingest", "write_true", "write_truth"))]


def test_a_camera_s_edited_chart_takes_no_other_photograph_again(again):
    edit(again / "config/cameras/d5100-comb.yaml", {"chart.patch_px": 18})
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    assert {"capture_camera", "calibrate_camera"} <= rules
    others = {"capture_object", "capture_environment", "capture_photograph", "write_truth"}
    assert not others & rules


def test_a_patch_in_the_frame_takes_the_place_of_the_estimate(again):
    edit(
        again / "config/objects/leaf-sphere.yaml", {"level_patch": {"centre_mm": [0.0, -40.0, -30.0], "side_mm": 10.0}}
    )
    levels = {(rule, named["object"]) for rule, named in planned(snakemake(again, "--dry-run")) if "measure" in rule
              and "object" in named}  # fmt: skip
    assert ("measure_patch", "leaf-sphere") in levels and ("measure_levels", "leaf-sphere") not in levels


@pytest.mark.heavy
def test_a_finer_texture_does_not_photograph_again(again):
    edit(again / "config/objects/tile-plate.yaml", {"texels": {"width": 32, "height": 32}})
    jobs = planned(snakemake(again, "--dry-run"))
    rules = {rule for rule, _ in jobs}
    assert "rectify_object" in rules and "capture_object" not in rules
    # The photograph of the whole scene shows the true texture, at its own size.
    assert [rule for rule in rules if rule.startswith("ingest")] == ["ingest_photograph"]
    assert {wildcards["object"] for _, wildcards in jobs if "object" in wildcards} == {"leaf-sphere", "tile-plate"}
    assert ("register_object", {"object": "leaf-sphere"}) not in jobs


def test_objects_that_are_no_longer_combined_are_placed_by_their_own_photographs(again):
    edit(again / "config/config.yaml", {"photographed_together": []})
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    rules -= {"combine_registrations_leaf_sphere"}  # the sphere's own two placements
    assert "rectify_object" in rules and not any(rule.startswith(("register", "combine", "ingest")) for rule in rules)


def test_a_combination_that_was_broken_off_is_made_again(again):
    """Killed between its two files: one is there and the other is not."""
    (again / "results/tile-plate/placement.h5").unlink()
    run = snakemake(again, "results/leaf-sphere/placement.h5", "results/tile-plate/placement.h5")
    assert run.returncode == 0, run.stderr[-3000:]
    assert (again / "results/tile-plate/placement.h5").is_file()
    assert "combine_registrations" in run.stdout + run.stderr and "rule register_object" not in run.stdout + run.stderr


def test_a_scene_edit_renders_and_nothing_more(again):
    edit(again / "config/scenes/still-life.yaml", {"max_bounces": 3})
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run"))}
    pictures = {"render_view", "render_truth", "encode_viewer", "export_viewer"}
    assert rules == {*pictures, "measure_error_budget", "measure_errors", "write_report", "all"}


@pytest.mark.heavy
def test_a_scene_with_light_maps_bakes_them_once_for_all_its_views_and_again_when_an_object_moves(again):
    scene = again / "config/scenes/still-life.yaml"
    edit(scene, {"integrator": {"kind": "interactive"}})
    picture = "results/still-life/front.png"
    rules = [rule for rule, _ in planned(snakemake(again, "--dry-run", picture))]
    assert rules == ["bake_light", "render_view"]
    run = snakemake(again, picture)
    assert run.returncode == 0, run.stderr[-3000:]
    figures = json.loads((again / "results/still-life/front.json").read_text())
    assert figures["light_maps"] and figures["delta_e_to_reference"]["mean"] < 2.0
    with open_file(again / "results/still-life/light-maps.h5") as file:
        bakes = file.attribute("bakes", list)
        shown = yaml.safe_load(scene.read_text())
        assert len(bakes) == len(shown["objects"]) + len(shown["bodies"])
        assert all(bake["texels"] > 0 and bake["error"] < 0.1 for bake in bakes)
    edit(scene, {"display.exposure": 1.0})
    assert "bake_light" not in {rule for rule, _ in planned(snakemake(again, "--dry-run", picture))}
    document = yaml.safe_load(scene.read_text())
    document["objects"][1]["position_mm"][0] += 1.0
    scene.write_text(yaml.safe_dump(document, sort_keys=False))
    assert "bake_light" in {rule for rule, _ in planned(snakemake(again, "--dry-run", picture))}


@pytest.mark.heavy
def test_a_library_edit_reruns_the_stages_that_use_it(again, tmp_path):
    code = tmp_path / "code"
    code.mkdir()
    for name in ("Snakefile", "workflow", "irodori", "benchmarks", "profiles", "envs"):
        source = ROOT / name
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source, code / name, ignore=ignored) if source.is_dir() else shutil.copy2(source, code)
    module = code / "irodori/fitting/solvers.py"
    module.write_text(module.read_text() + "\n# a changed line\n")
    rules = {rule for rule, _ in planned(snakemake(again, "--dry-run", snakefile=code / "Snakefile"))}
    # The page draws the fit's outcomes with the fit's own names, so it uses the module too; registration fits texels to
    # find the light, and lobes are compared by fitting them.
    placing = {"register_object", "register_placement", "combine_registrations_leaf_sphere", "rectify_object"}
    assert rules == STAGES_AFTER_FIT | placing | {"choose_lobes"}


def test_a_job_for_every_capture_but_none_for_a_tiny_tile():
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    run = planned(snakemake(ROOT, "--dry-run", "--forceall"))
    names = {wildcards["object"] for _, wildcards in run if "object" in wildcards}
    assert config["make"]["scenes"] and names
    for name in names:
        assert sum(wildcards.get("object") == name for _, wildcards in run) <= 200
