"""Model of the workflow's duration on a cluster, from measured costs of tiles, files and job starts.

The workflow of an object has four phases of jobs: ingestion, rectification and fit of tiles (many in one job), and
compression. Each phase waits for the last job of the one before; the jobs of all objects run in parallel. A phase lasts
as long as its jobs need, in waves that fill the nodes' cores, or as long as the shared storage needs to read and write
their files, whichever is longer. Before that, jobs are submitted one after the other; after it, there is the wait until
Snakemake checks the states of the jobs. As a worst case, nodes are assumed not to cache what they read: each tile reads
all captures of its object, and the next tile in the same job reads them again. Rendering, calibration and light are
left out, because they are a few jobs for all objects.
"""

import math
from dataclasses import dataclass

#: What can bind a phase.
BINDING = ("starting jobs", "computing", "storage", "scheduler")


@dataclass(frozen=True)
class Constants:
    """Measured costs on one machine.

    Parameters
    ----------
    start_s : float, s
        Time from Snakemake's decision to run a job on its node until the job computes: processes and imports.
    submit_s, latency_s, poll_s : float, s
        Time of one submission; from submission to start on an idle node; until the end of a job is noticed.
    ingest_s : float, s
        Time on one core per megapixel of mosaic and pose of two shots.
    rectify_s, fit_s : float, s
        Times per million texels and pose, on one core and on the cores of one fit.
    compress_s : float, s
        Time on one core per million texels.
    raw_mb, linear_mb : float, MB
        Sizes per megapixel of mosaic and pose.
    observations_mb : float, MB
        Size per million texels and pose.
    brdf_mb, material_mb : float, MB
        Sizes per million texels.
    hash_mb_per_s : float, MB/s
        Speed of one core for reading files to compare their hashes.
    storage_mb_per_s : float, MB/s
        Speed of the storage that all nodes share, for reading and writing together.
    """

    start_s: float
    submit_s: float
    latency_s: float
    poll_s: float
    ingest_s: float
    rectify_s: float
    fit_s: float
    compress_s: float
    raw_mb: float
    linear_mb: float
    observations_mb: float
    brdf_mb: float
    material_mb: float
    hash_mb_per_s: float
    storage_mb_per_s: float


@dataclass(frozen=True)
class Cluster:
    """Nodes of a cluster, and how `profiles/slurm` and the configuration divide the work into jobs."""

    nodes: int = 100
    cores_per_node: int = 16
    tiles_per_job: int = 50
    tiles_abreast: int = 3
    captures_per_job: int = 8
    fit_cores: int = 1


@dataclass(frozen=True)
class Work:
    """Objects of equal size: megapixels of a mosaic and millions of texels, poses of two shots, texels of a tile."""

    objects: int = 10
    megapixels: float = 10.0
    million_texels: float = 10.0
    poses: int = 48
    tile_texels: int = 200_000


@dataclass(frozen=True)
class Phase:
    """A phase of independent jobs.

    Parameters
    ----------
    name : str
    jobs : int
        Number of jobs for all objects.
    slots : int
        Number of jobs that run at the same time.
    job_start_s, job_compute_s : float, s
        Times of the longest job.
    moved_mb : float, MB
        Amount that all jobs read and write.
    """

    name: str
    jobs: int
    slots: int
    job_start_s: float
    job_compute_s: float
    moved_mb: float

    @property
    def waves(self) -> int:
        """Number of times the slots are filled."""
        return math.ceil(self.jobs / self.slots)

    def parts_s(self, constants: Constants) -> dict[str, float]:
        """Return the time of each part in `BINDING`, s; storage works in parallel with starting and computing."""
        scheduler_s = self.jobs * constants.submit_s + constants.latency_s + constants.poll_s
        return dict(
            zip(
                BINDING,
                (
                    self.waves * self.job_start_s,
                    self.waves * self.job_compute_s,
                    self.moved_mb / constants.storage_mb_per_s,
                    scheduler_s,
                ),
                strict=True,
            )
        )

    def lasts_s(self, constants: Constants) -> float:
        """Return the duration of the phase, s."""
        parts = self.parts_s(constants)
        jobs_s = parts["starting jobs"] + parts["computing"]
        return max(jobs_s, parts["storage"]) + parts["scheduler"]

    def binds(self, constants: Constants) -> str:
        """Return the bottleneck of the phase: the part with the longest time."""
        parts = self.parts_s(constants)
        return max(parts, key=parts.get)


def phases(work: Work, cluster: Cluster, constants: Constants) -> list[Phase]:
    """Return the phases of a piece of work on a cluster.

    Raises
    ------
    ValueError
        If a node has fewer cores than a job of tiles needs.
    """
    tiles = math.ceil(work.million_texels * 1e6 / work.tile_texels)
    in_job = min(tiles, cluster.tiles_per_job)
    tile_jobs = math.ceil(tiles / cluster.tiles_per_job)
    abreast = min(cluster.tiles_abreast, in_job)
    job_cores = abreast * cluster.fit_cores
    if job_cores > cluster.cores_per_node:
        raise ValueError(f"a node of {cluster.cores_per_node} cores; accepted: {job_cores} or more, for one job")
    layers = math.ceil(in_job / abreast)
    tile_poses = work.tile_texels / 1e6 * work.poses
    texel_poses = work.million_texels * work.poses
    captures = min(cluster.captures_per_job, work.poses)
    raw_mb, linear_mb = (work.megapixels * work.poses * each for each in (constants.raw_mb, constants.linear_mb))
    slots = cluster.nodes * cluster.cores_per_node
    return [
        Phase(
            "ingest",
            work.objects * math.ceil(work.poses / cluster.captures_per_job),
            slots,
            constants.start_s,
            captures * work.megapixels * constants.ingest_s,
            work.objects * (raw_mb + linear_mb),
        ),
        Phase(
            "rectify",
            work.objects * tile_jobs,
            cluster.nodes * (cluster.cores_per_node // job_cores),
            layers * constants.start_s,
            # Each tile reads all captures completely to verify their hashes.
            layers * (linear_mb / constants.hash_mb_per_s + tile_poses * constants.rectify_s),
            work.objects * (tiles * linear_mb + texel_poses * constants.observations_mb),
        ),
        Phase(
            "fit",
            work.objects * tile_jobs,
            cluster.nodes * (cluster.cores_per_node // job_cores),
            layers * constants.start_s,
            layers * tile_poses * constants.fit_s,
            work.objects * (texel_poses * constants.observations_mb + work.million_texels * constants.brdf_mb),
        ),
        Phase(
            "compress",
            work.objects,
            slots,
            constants.start_s,
            work.million_texels * constants.compress_s,
            work.objects * work.million_texels * (constants.brdf_mb + constants.material_mb),
        ),
    ]


def total_s(found: list[Phase], constants: Constants) -> float:
    """Return the total duration of the phases, s."""
    return sum(phase.lasts_s(constants) for phase in found)


def binds_first(found: list[Phase], constants: Constants) -> str:
    """Return a text with the bottleneck of the longest phase and the name of that phase."""
    longest = max(found, key=lambda phase: phase.lasts_s(constants))
    return f"{longest.binds(constants)} in {longest.name}"
