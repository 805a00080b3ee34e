"""Measurements of speed against error, run by hand."""

import irodori  # noqa: F401  before numba: it tells numba where compiled loops of this source are kept
