"""Summary of Snakemake's benchmark files for the ten-megapixel run, and the project that it writes."""

import subprocess
import sys

import pytest
import yaml

from benchmarks.ten_megapixels import Largest, Size, costs, disk_mb, is_of_the_rig, make_project

_HEADER = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time"


def benchmark(folder, name, seconds, peak_mb, cpu_s):
    path = folder / "results/benchmarks" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{_HEADER}\n{seconds}\t0:00:01\t{peak_mb}\t1\t1\t1\t1\t1\t1\t{cpu_s}\n")


def test_jobs_of_a_rule_are_added_their_memory_is_the_largest_and_the_costliest_rule_comes_first(tmp_path):
    benchmark(tmp_path, "fit_brdf/jar_000.tsv", 2.0, 500, 3.5)
    benchmark(tmp_path, "fit_brdf/jar_001.tsv", 4.0, 700, 6.5)
    benchmark(tmp_path, "rectify_object/jar_000.tsv", 9.0, "NA", "NA")
    rectify, fit = costs(tmp_path)
    assert (rectify.rule, rectify.seconds, rectify.peak_mb) == ("rectify_object", 9.0, 0.0)
    assert (fit.rule, fit.jobs, fit.seconds, fit.cpu_seconds, fit.peak_mb) == ("fit_brdf", 2, 6.0, 10.0, 700.0)
    assert costs(tmp_path, {"rectify_object": 60.0, "fit_brdf": 600.0})[0].peak_mb == 60.0
    assert costs(tmp_path, {"fit_brdf": 900.0})[1].peak_mb == 900.0


def test_the_largest_memory_of_a_job_is_seen_though_it_is_free_again(tmp_path):
    script = tmp_path / "tmp1.render_view.py"
    script.write_text("import sys\nlarge = b'1' * 200_000_000\ndel large\nprint(flush=True)\nsys.stdin.read()\n")
    job = subprocess.Popen([sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    job.stdout.readline()
    (tmp_path / "results").mkdir()
    largest = Largest()
    largest.look(tmp_path)
    job.communicate(b"")
    assert set(largest.memory_mb) == {"render_view"} and 200.0 < largest.memory_mb["render_view"] < 250.0


def test_a_project_that_did_not_run_or_was_broken_off_has_no_figures(tmp_path):
    with pytest.raises(ValueError, match="no benchmark files"):
        costs(tmp_path)
    benchmark(tmp_path, "fit_brdf/jar_000.tsv", 2.0, 500, 3.5)
    (tmp_path / "results/benchmarks/fit_brdf/jar_001.tsv").write_text("")
    with pytest.raises(ValueError, match="jar_001"):
        costs(tmp_path)


def test_photographs_are_not_the_chains_work():
    assert is_of_the_rig("capture_object") and not is_of_the_rig("check_captures")


def test_disk_is_counted_by_kind_of_file(tmp_path):
    for name, size in (("jar/linear/a.h5", 3000), ("jar/linear/b.h5", 2000), ("jar/material.h5", 1000)):
        path = tmp_path / "results" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))
    assert disk_mb(tmp_path) == pytest.approx({"linear": 0.005, "material.h5": 0.001})


@pytest.mark.parametrize("megapixels", [0.5, 10.1, 24.0])
def test_a_larger_camera_sees_the_same_field_with_more_pixels(tmp_path, megapixels):
    folder = tmp_path / "project"
    folder.mkdir()
    make_project(folder, Size(megapixels, 24, 400_000))
    camera = yaml.safe_load((folder / "config/cameras/d5100-comb.yaml").read_text())
    optics, chart = camera["optics"], camera["chart"]
    assert optics["width_px"] * optics["height_px"] == pytest.approx(megapixels * 1e6, rel=0.01)
    assert optics["width_px"] % 2 == optics["height_px"] % 2 == 0
    assert optics["width_px"] * optics["pixel_pitch_um"] == pytest.approx(8000.0, rel=0.01)
    first, last = chart["centres_px"]["first"], chart["centres_px"]["last"]
    # The default camera's chart begins at 95 of 400 superpixels and ends at 304.
    assert first[0] / (optics["width_px"] / 2) == pytest.approx(95.33 / 400, rel=0.01)
    assert last[1] / (optics["height_px"] / 2) == pytest.approx(212.0 / 300, rel=0.01)
