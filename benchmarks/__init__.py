"""Benchmarks that measure the speed and the error of every stage and of its alternatives."""

# Imported before numba, because it ties numba's cache of compiled loops to the sources of the package that they call.
import irodori  # noqa: F401
