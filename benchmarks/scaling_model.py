"""Model of the chain's duration on a cluster, from measured costs of tiles, files and job starts.

The chain of an object is three phases of jobs, each waiting for the last of the one before: ingestion, tiles (rectified
and fitted, many to a job), compression. The jobs of all objects stand beside each other. A phase lasts as long as its
jobs need in as many waves as the nodes' cores allow, or as long as the shared storage needs for what they read and
write, whichever is longer; before that come the submissions, one after the other, and after it the wait until Snakemake
asks for the jobs' state. Nodes are taken to keep nothing of what they read in memory, which is the worst case: a tile
reads all captures of its object, and its neighbours in the same job read them again. Rendering, calibration and the
light are left out: they are a few jobs for all objects.
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
        From Snakemake's decision to run a job on its node until the job computes: processes and imports.
    submit_s, latency_s, poll_s : float, s
        One submission; from submission to start on an idle node; until the end of a job is noticed.
    ingest_s : float, s
        One core, a megapixel of mosaic, a pose in two shots.
    rectify_s, fit_s : float, s
        A million texels and a pose: one core; the cores of one fit.
    compress_s : float, s
        One core, a million texels.
    raw_mb, linear_mb : float, MB
        A megapixel of mosaic and a pose.
    observations_mb : float, MB
        A million texels and a pose.
    brdf_mb, material_mb : float, MB
        A million texels.
    hash_mb_per_s : float, MB/s
        One core, of files that are read to be compared with their hash.
    storage_mb_per_s : float, MB/s
        Of the storage that all nodes share, reading and writing together.
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
    """Nodes, and how `profiles/slurm` and the configuration cut the work into jobs."""

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
    """Jobs that need nothing of each other.

    Parameters
    ----------
    name : str
    jobs : int
        Of all objects.
    slots : int
        Jobs that run at the same time.
    job_start_s, job_compute_s : float, s
        Of the longest job.
    moved_mb : float, MB
        What all jobs read and write.
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
        """Return what each of `BINDING` takes of the phase, s; storage works while jobs start and compute."""
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
        """Return how long the phase lasts, s."""
        parts = self.parts_s(constants)
        jobs_s = parts["starting jobs"] + parts["computing"]
        return max(jobs_s, parts["storage"]) + parts["scheduler"]

    def binds(self, constants: Constants) -> str:
        """Return what takes the largest part of the phase."""
        parts = self.parts_s(constants)
        return max(parts, key=parts.get)


def phases(work: Work, cluster: Cluster, constants: Constants) -> list[Phase]:
    """Return the phases of a piece of work on a cluster.

    Raises
    ------
    ValueError
        If a node has fewer cores than a job of tiles asks for.
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
            "tiles",
            work.objects * tile_jobs,
            cluster.nodes * (cluster.cores_per_node // job_cores),
            2 * layers * constants.start_s,
            layers * (linear_mb / constants.hash_mb_per_s + tile_poses * (constants.rectify_s + constants.fit_s)),
            # Each tile reads all captures whole, to know that they are as they were written.
            work.objects
            * (
                tiles * linear_mb
                + 2 * texel_poses * constants.observations_mb
                + work.million_texels * constants.brdf_mb
            ),
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
    """Return how long the phases last one after the other, s."""
    return sum(phase.lasts_s(constants) for phase in found)


def binds_first(found: list[Phase], constants: Constants) -> str:
    """Return what takes the largest part of the longest phase, and which phase that is."""
    longest = max(found, key=lambda phase: phase.lasts_s(constants))
    return f"{longest.binds(constants)} in {longest.name}"
