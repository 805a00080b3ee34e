"""Per-texel fit of equation (5) to a texel's observations: equation (7) and what follows from it."""

from irodori.fitting.solvers import MODEL_PARAMETERS, FitOptions, FitResult, fit
from irodori.fitting.stage import fit_brdf
from irodori.material import Status

__all__ = ["MODEL_PARAMETERS", "FitOptions", "FitResult", "Status", "fit", "fit_brdf"]
