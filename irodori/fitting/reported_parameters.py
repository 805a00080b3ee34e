"""Parameters stored for each texel: those that its data determine; NaN and a status for the others."""

import math

import numpy as np

from irodori.fitting import judge
from irodori.fitting.texels import Output
from irodori.jit.chunks import run_chunks
from irodori.jit.compilation import njit

_ALPHA, _BETA, _MU, _ALPHA_ERROR, _BETA_ERROR, _MU_ERROR, _RMS, _RELATIVE = range(8)
_NAMES = (
    "alpha", "beta", "mu", "alpha_error", "beta_error", "mu_error", "residual_rms", "relative_residual",
)  # fmt: skip
_CHUNK = 16384  # texels that a thread takes at a time
_IS_OK, _AT_BOUND = int(judge.Status.OK), int(judge.Status.AT_BOUND)
_CONTRADICTED = int(judge.Status.CONTRADICTED)


@njit(cache=True, nogil=True, error_model="numpy")
def _report_some(out, stated, gloss, first, last):
    """Fill the reported parameters of a range of texels: NaN where a parameter is not determined."""
    for t in range(first, last):
        status, model, nan = out.status[t], out.model[t], np.nan
        known = status == _IS_OK or (status == _CONTRADICTED and model >= judge.GLOSS_ALONE)
        alpha_error, mu = out.table[t, judge.ALPHA_ERROR], math.exp(out.table[t, judge.LOG_MU])
        sure = math.isfinite(alpha_error)
        # Without an error, α is 0 if the model is gloss alone; otherwise it cannot be separated from the gloss.
        stated[_ALPHA, t] = out.table[t, judge.ALPHA] if sure or model == judge.GLOSS_ALONE else nan
        stated[_BETA, t], stated[_MU, t] = out.table[t, judge.BETA] if known else nan, mu if known else nan
        # At a bound of the gloss, the error of α would not include the effect of the bound.
        stated[_ALPHA_ERROR, t] = alpha_error if sure and status != _AT_BOUND else nan
        stated[_BETA_ERROR, t] = out.table[t, judge.BETA_ERROR] if known else nan
        stated[_MU_ERROR, t] = out.table[t, judge.LOG_MU_ERROR] * mu if known else nan
        squares, power = out.table[t, judge.SQUARES], out.table[t, judge.POWER]
        stated[_RMS, t] = math.sqrt(squares)
        stated[_RELATIVE, t] = math.sqrt(squares / power) if power > 0.0 else nan
        glossy = math.isfinite(squares) and model >= judge.GLOSS_ALONE
        gloss[t, 0], gloss[t, 1] = out.table[t, judge.BETA] if glossy else 0.0, mu if glossy else 1.0


def report_parameters(out: Output) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return parameters, errors and residuals by name, (texels,) each, and the best β and μ, (texels, 2).

    Names and meaning are those of `irodori.fitting.solvers.FitResult`.
    """
    count = len(out.status)
    stated, gloss = np.empty((len(_NAMES), count)), np.empty((count, 2))
    run_chunks(_report_some, count, _CHUNK, out, stated, gloss)
    return dict(zip(_NAMES, stated, strict=True)), gloss
