"""Errors, atomic files, the HDF5 store, provenance, progress and threads."""
