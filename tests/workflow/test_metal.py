"""A metal goes through the whole chain: its index varies with the wavelength, so its gloss has a colour to subtract."""

import numpy as np
import pytest
from project import edit, snakemake

from irodori.colour.colorimetry import delta_e_reflectance
from irodori.evaluation.truth_errors import interior
from irodori.material.material_file import Material

#: Like gold's: nm, n, k.
INDEX = (
    (400, 1.47, 1.95),
    (450, 1.38, 1.91),
    (500, 0.97, 1.87),
    (550, 0.43, 2.46),
    (600, 0.25, 2.99),
    (700, 0.16, 3.95),
)


@pytest.mark.heavy
def test_a_golden_plate_keeps_the_colour_of_its_ground_and_the_height_of_its_gloss(again):
    folder = again  # whose camera is calibrated
    wavelength_nm = np.arange(400, 701, 10)
    n, k = (np.interp(wavelength_nm, *np.array(INDEX).T[[0, i]]) for i in (1, 2))
    rows = [f"{w},{a:.4f},{b:.4f}" for w, a, b in zip(wavelength_nm, n, k, strict=True)]
    (folder / "config/gold.csv").write_text("\n".join(["wavelength_nm,n,k", *rows]) + "\n")
    paints = [("TCS20", 0.15, 0.12), ("TCS81", 0.1, 0.2), ("TCS31", 0.2, 0.16), ("TCS56", 0.12, 0.14)]
    edit(
        folder / "config/objects/tile-plate.yaml",
        {
            "refractive_index": {"file": "config/gold.csv"},
            "mirror_weight": 0.0,
            "virtual.materials": [{"spectrum": s, "beta": b, "mu_rad": m} for s, b, m in paints],
        },
    )
    run = snakemake(folder, "results/tile-plate/material.h5", "results/tile-plate/truth.h5")
    assert run.returncode == 0, run.stderr[-4000:]
    found, truth = (Material.load(folder / f"results/tile-plate/{name}.h5") for name in ("material", "truth"))
    np.testing.assert_allclose(found.n[::10], np.interp(np.arange(400, 701, 50), wavelength_nm, n), rtol=1e-3)
    chosen = found.observed & interior(truth)
    assert chosen.mean() > 0.3
    difference = delta_e_reflectance(truth.spectra()[chosen], found.spectra()[chosen], "D65")
    assert np.median(difference) < 2.0
    known = chosen & np.isfinite(found.beta) & np.isfinite(found.mu)
    assert known.sum() > 0.5 * chosen.sum()
    for name, limit in (("beta", 0.12), ("mu", 0.08)):
        assert np.median(np.abs(getattr(found, name) / getattr(truth, name) - 1.0)[known]) < limit, name
