"""Compression error of light after repeated reflection: products of spectra do not lie in the span of the basis."""

import numpy as np

from irodori.colour.colorimetry import delta_e_of_light, spectral_rmse, summary

REFLECTIONS = 5
_CHAINS = 20_000


def drift(
    truth: np.ndarray,
    decoded: np.ndarray,
    basis: np.ndarray,
    observers: dict,
) -> list[dict]:
    """Return the colour and spectral errors that compression causes in light reflected several times.

    Chains of reflections are simulated as products of the spectra of pixels drawn at random. After each reflection all
    chains are scaled by one exposure, so that the true ones are as bright on average as the picture: errors do not look
    small because little light is left.

    Parameters
    ----------
    truth, decoded : (n, 61) float
        Reflectances before compression and after.
    basis : (61, k) float, orthonormal columns
    observers : dict
        light -> ((3, 61) matrix to XYZ, (3,) XYZ of white).

    Returns
    -------
    list of dict
        One for each number of reflections: ``reflections``; ``delta_e``, light -> summary of CIEDE2000; ``rmse``, mean
        over the chains; and both again as ``projected_delta_e`` and ``projected_rmse`` if every product is projected on
        the basis, as in a renderer that keeps coefficients instead of spectra.
    """
    rng = np.random.default_rng(0)
    count = len(truth) if len(truth) < 2 else min(_CHAINS, 4 * len(truth))
    exact, product, projected = (np.ones((count, truth.shape[1])) for _ in range(3))
    brightness = np.maximum(truth, 0).mean()
    rows = []
    for number in range(1, REFLECTIONS + 1):
        chosen = rng.integers(len(truth), size=count)
        exact *= truth[chosen]
        product *= decoded[chosen]
        projected = (projected * decoded[chosen]) @ basis @ basis.T
        level = np.abs(exact).mean()
        exposure = brightness / level if level > 0 else 1.0
        # The exposure is applied to the matrices: less work than on the 61 samples of every chain.
        matrices = {light: (exposure * matrix.T, white) for light, (matrix, white) in observers.items()}
        wanted = {light: exact @ matrix for light, (matrix, _) in matrices.items()}
        row: dict[str, object] = {"reflections": number}
        for prefix, values in {"": product, "projected_": projected}.items():
            row[f"{prefix}delta_e"] = {
                light: summary(delta_e_of_light(wanted[light], values @ matrix, white))
                for light, (matrix, white) in matrices.items()
            }
            row[f"{prefix}rmse"] = float(exposure * spectral_rmse(exact, values).mean())
        rows.append(row)
    return rows
