"""The scaling model and its constants, against hand-made cases and what must hold of any cluster."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scaling import Project, chain_constants
from benchmarks.scaling_model import Cluster, Constants, Phase, Work, binds_first, phases, total_s
from benchmarks.ten_megapixels import Cost, Size

FREE = Constants(
    start_s=0.0, submit_s=0.0, latency_s=0.0, poll_s=0.0, ingest_s=0.0, rectify_s=0.0, fit_s=0.0, compress_s=0.0,
    raw_mb=0.0, linear_mb=0.0, observations_mb=0.0, brdf_mb=0.0, material_mb=0.0, hash_mb_per_s=1e9,
    storage_mb_per_s=1.0,
)  # fmt: skip
COSTS = Constants(
    start_s=3.0, submit_s=0.1, latency_s=1.0, poll_s=10.0, ingest_s=0.05, rectify_s=0.2, fit_s=0.02, compress_s=1.0,
    raw_mb=4.0, linear_mb=6.0, observations_mb=20.0, brdf_mb=60.0, material_mb=40.0, hash_mb_per_s=1000.0,
    storage_mb_per_s=1000.0,
)  # fmt: skip


def of(name, work, cluster, constants):
    return next(phase for phase in phases(work, cluster, constants) if phase.name == name)


def test_a_phase_of_one_job_is_the_sum_of_its_start_its_work_and_the_scheduler():
    phase = Phase("ingest", jobs=1, slots=1, job_start_s=2.0, job_compute_s=5.0, moved_mb=0.0)
    constants = replace(FREE, submit_s=0.5, latency_s=1.0, poll_s=4.0)
    assert phase.lasts_s(constants) == pytest.approx(2.0 + 5.0 + 0.5 + 1.0 + 4.0)


def test_one_job_more_than_there_are_slots_is_a_second_wave():
    phase = Phase("ingest", jobs=8, slots=8, job_start_s=1.0, job_compute_s=2.0, moved_mb=0.0)
    assert phase.lasts_s(FREE) == 3.0 and replace(phase, jobs=9).lasts_s(FREE) == 6.0


def test_storage_bounds_a_phase_only_where_it_is_slower_than_the_jobs():
    phase = Phase("fit", jobs=1, slots=1, job_start_s=0.0, job_compute_s=10.0, moved_mb=400.0)
    assert phase.lasts_s(replace(FREE, storage_mb_per_s=50.0)) == 10.0
    slow = replace(FREE, storage_mb_per_s=20.0)
    assert phase.lasts_s(slow) == 20.0 and phase.binds(slow) == "storage"


def test_the_work_of_one_object_is_cut_as_the_profile_cuts_it():
    work = Work(objects=1, megapixels=10.0, million_texels=10.0, poses=48, tile_texels=40_000)
    cluster = Cluster(nodes=1, cores_per_node=6)
    ingest, rectify, fit, compress = phases(work, cluster, COSTS)
    assert (ingest.jobs, rectify.jobs, fit.jobs, compress.jobs) == (6, 5, 5, 1)
    assert rectify.slots == fit.slots == 2 and ingest.slots == 6
    # 50 tiles, three abreast: 17 layers.
    assert rectify.job_start_s == fit.job_start_s == pytest.approx(17 * 3.0)
    # Each reads 48 captures of 60 MB to compare them with their hashes.
    assert rectify.job_compute_s == pytest.approx(17 * (48 * 60.0 / 1000.0 + 0.04 * 48 * 0.2))
    assert fit.job_compute_s == pytest.approx(17 * 0.04 * 48 * 0.02)
    assert ingest.job_compute_s == pytest.approx(8 * 10 * 0.05)
    # Every one of 250 tiles reads the 48 captures.
    assert rectify.moved_mb == pytest.approx(250 * 10 * 48 * 6.0 + 480 * 20.0)
    assert fit.moved_mb == pytest.approx(480 * 20.0 + 10 * 60.0)


def test_larger_tiles_read_the_captures_less_often():
    small, large = (of("rectify", Work(tile_texels=t), Cluster(), COSTS) for t in (40_000, 400_000))
    assert small.moved_mb > 5 * large.moved_mb


def test_what_costs_everything_is_what_binds():
    work, cluster = Work(), Cluster()
    for change, wanted in (
        ({"start_s": 1e4}, "starting jobs in rectify"),
        ({"compress_s": 1e5}, "computing in compress"),
        ({"storage_mb_per_s": 1e-3}, "storage in rectify"),
        ({"submit_s": 1e5}, "scheduler in ingest"),
    ):
        constants = replace(COSTS, **change)
        assert binds_first(phases(work, cluster, constants), constants) == wanted


def test_a_node_too_small_for_a_job_of_tiles_is_refused():
    with pytest.raises(ValueError, match="a node of 2 cores; accepted: 3 or more"):
        phases(Work(), Cluster(cores_per_node=2), COSTS)


@given(st.integers(1, 300), st.integers(6, 64), st.integers(1, 40), st.floats(0.5, 40.0))
def test_more_nodes_never_take_longer_and_more_objects_never_less(nodes, cores, objects, size):
    work = Work(objects=objects, megapixels=size, million_texels=size)
    cluster = Cluster(nodes=nodes, cores_per_node=cores)
    time_s = total_s(phases(work, cluster, COSTS), COSTS)
    assert total_s(phases(work, replace(cluster, nodes=2 * nodes), COSTS), COSTS) <= time_s
    assert total_s(phases(replace(work, objects=2 * objects), cluster, COSTS), COSTS) >= time_s


def project(size, start_s=3.0, ingest_s=0.05, *, rectify_s=0.2, fit_s=0.02, compress_s=1.0, hashed_mb_per_s=1000.0):
    """Return a project whose jobs took what the constants say, and nothing else."""
    megatexels, pixels = size.texels_side**2 / 1e6, size.megapixels * size.poses
    tiles, linear_mb = -(-(size.texels_side**2) // size.tile_texels), 6.0 * pixels
    work_s = {
        "ingest_raw": (2, ingest_s * pixels),
        "rectify_object": (tiles, rectify_s * megatexels * size.poses + tiles * linear_mb / hashed_mb_per_s),
        "fit_brdf": (tiles, fit_s * megatexels * size.poses),
        "compress_reflectance": (1, compress_s * megatexels),
    }
    found = {rule: Cost(rule, jobs, jobs * start_s + s, s, 500.0) for rule, (jobs, s) in work_s.items()}
    sizes = (4.0 * pixels, linear_mb, 20.0 * megatexels * size.poses, 60.0 * megatexels, 40.0 * megatexels)
    return Project(size, found, *sizes)


def test_the_constants_of_two_projects_are_those_they_were_made_with_whatever_starting_takes():
    measured = {key: getattr(COSTS, key) for key in ("start_s", "submit_s", "latency_s", "poll_s", "hash_mb_per_s",
                                                     "storage_mb_per_s")}  # fmt: skip
    sizes = (Size(0.48, 6, 200_000), Size(2.0, 12, 200_000))
    for start_s in (0.5, 30.0):
        found = chain_constants(*(project(size, start_s) for size in sizes), measured)
        for name, value in vars(COSTS).items():
            assert getattr(found, name) == pytest.approx(value, rel=1e-6), name


def test_a_machine_too_busy_to_tell_work_from_waiting_is_not_measured():
    measured = {"hash_mb_per_s": 1000.0}
    small, large = project(Size(0.48, 6, 200_000), start_s=90.0), project(Size(2.0, 12, 200_000), start_s=3.0)
    with pytest.raises(ValueError, match="accepted: longer for more work"):
        chain_constants(small, large, measured)
