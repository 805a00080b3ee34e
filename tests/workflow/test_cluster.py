"""Jobs that the Slurm profile makes of a ten-megapixel object, and their resources."""

import re

import pytest
import yaml
from project import ROOT, snakemake

from benchmarks.scaling_model import Cluster, Constants, Work, phases
from benchmarks.ten_megapixels import Size, make_project, poses

PROFILE = yaml.safe_load((ROOT / "profiles/slurm/config.yaml").read_text())
MATERIAL = "results/tile-plate/material.h5"


@pytest.fixture(scope="module")
def dry_run(tmp_path_factory) -> str:
    """Return what a dry run for Slurm says of an object of ten megapixels in 48 poses of two shots."""
    folder = tmp_path_factory.mktemp("cluster") / "project"
    folder.mkdir()
    make_project(folder, Size(10.1, 48, 40_000))
    profile = ("--profile", str(ROOT / "profiles/slurm"))
    run = snakemake(folder, *profile, "--dry-run", MATERIAL, cores=None)
    assert run.returncode == 0, run.stderr[-4000:]
    return run.stdout + run.stderr


def counted(said: str) -> dict[str, int]:
    """Return rule -> jobs of the table at the end of a dry run."""
    return {name: int(number) for name, number in re.findall(r"^(\w+)\s+(\d+)$", said, flags=re.MULTILINE)}


@pytest.mark.heavy
def test_an_object_of_ten_megapixels_and_48_poses_is_at_most_200_jobs_of_the_cluster(dry_run):
    rules = counted(dry_run)
    assert rules["rectify_object"] == rules["fit_brdf"] > 250
    groups = dry_run.count("Group job rectified") + dry_run.count("Group job fitted")
    alone = rules["total"] - rules["rectify_object"] - rules["fit_brdf"]
    assert groups + alone <= 200 and groups + alone == 29


@pytest.mark.heavy
@pytest.mark.parametrize(("name", "folder"), [("rectified", "observations"), ("fitted", "brdf")])
def test_fifty_tiles_share_a_job(dry_run, name, folder):
    counts = []
    for group in re.split("Group job (?:rectified|fitted)", dry_run)[1:]:
        of_group = group.partition("\n\n\n")[0]
        counts.append(
            len(set(re.findall(rf"^    +output: results/tile-plate/{folder}/tile-\d+\.h5", of_group, re.MULTILINE)))
        )
    assert sorted(filter(None, counts), reverse=True)[:5] == [50] * 5 and sum(counts) == counted(dry_run)["fit_brdf"]


@pytest.mark.heavy
def test_what_one_stage_hands_to_the_next_is_removed_where_the_configuration_says_so(dry_run):
    removed = re.findall(r"temporary output results/tile-plate/(\w+)/", dry_run)
    assert set(removed) == {"linear", "observations", "brdf"}


def test_the_workflows_own_profile_takes_no_setting_from_the_clusters():
    # Snakemake loads both and keeps the whole value of the workflow's own where both name a key.
    own = yaml.safe_load((ROOT / "profiles/default/config.yaml").read_text())
    assert not set(own) & set(PROFILE)


@pytest.mark.heavy
def test_no_job_asks_for_more_memory_than_the_profile_lets_one_have(dry_run):
    asked = [int(number) for number in re.findall(r"mem_mb=(\d+)", dry_run)]
    assert asked and 2 * max(asked) <= PROFILE["resources"]["mem_mb"]


@pytest.mark.heavy
def test_the_models_cluster_cuts_the_work_as_the_profile_and_the_configuration_do(dry_run):
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    cluster = Cluster()
    assert PROFILE["group-components"] == [f"{name}={cluster.tiles_per_job}" for name in ("rectified", "fitted")]
    assert cluster.captures_per_job == config["ingest"]["captures_per_job"]
    assert cluster.tiles_abreast == PROFILE["resources"]["mem_mb"] // 2000
    free = Constants(**dict.fromkeys(Constants.__dataclass_fields__, 1.0))
    work = Work(objects=1, megapixels=10.1, million_texels=Size(10.1, 48, 40_000).texels_side ** 2 / 1e6,
                tile_texels=40_000)  # fmt: skip
    ingest, rectify, fit, compress = phases(work, cluster, free)
    rules = counted(dry_run)
    assert ingest.jobs == sum(number for rule, number in rules.items() if rule.startswith("ingest_raw_tile_plate"))
    assert rectify.jobs == dry_run.count("Group job rectified") and fit.jobs == dry_run.count("Group job fitted")
    assert compress.jobs == rules["compress_reflectance"]


@pytest.mark.parametrize("count", [6, 7, 24, 48])
def test_the_poses_of_a_large_project_are_as_many_as_asked_for_and_within_the_rig(count):
    found = [
        (light, camera) for block in poses(count) for light in block["light_deg"] for camera in block["camera_deg"]
    ]
    assert len(set(found)) == count
    assert all(35 <= light <= 125 and 0 <= camera <= 140 and light + camera < 180 for light, camera in found)
