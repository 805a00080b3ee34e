"""Benchmarks that measure the speed and the error of every stage and of its alternatives."""

# Before numba, whose cache of compiled loops it ties to the package's source: loops here call the package's.
import irodori  # noqa: F401
