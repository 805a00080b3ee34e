"""Gloss of the interactive integrator beside the lobe integrated over the light."""

import numpy as np
import pytest
from scenes import BALL, lobe_integral, material, smooth_light, sphere_hits
from studio import even_light, levels, picture, sky_of, spectrum_of

from irodori.colour.colorimetry import xyz_from_radiance


@pytest.mark.default_cases(3)
@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (0.2, 3.4)], ids=["lacquer", "metal"])
@pytest.mark.parametrize(("mu", "tolerance"), [(0.05, 0.01), (0.12, 0.01), (0.35, 0.03), (0.6, 0.04), (1.2, 0.06)])
def test_gloss_is_the_lobe_integrated_over_the_light(mu, tolerance, n, k):
    """A row of four round lobes: the rougher the surface, the less they follow the horizon's cut."""
    beta = 1 / (4 * mu**2)
    light = sky_of(smooth_light, 128)
    found = levels(picture([BALL], [material(0.0, beta=beta, mu=mu, n=n, k=k)], light), light)
    ray, normal = sphere_hits()
    cosine = -np.sum(ray * normal, axis=-1)
    for y, x in [(20, 20), (14, 20), (20, 27), (28, 12), (10, 14), (25, 33), (33, 24)]:
        assert cosine[y, x] > 0.25
        assert found[y, x] == pytest.approx(lobe_integral(normal[y, x], -ray[y, x], beta, mu, n, k), rel=tolerance)


@pytest.mark.stability(stage="render", case="roughness at both bounds", mu=(0.005, 1.2))
@pytest.mark.stability(stage="render", case="energy")
@pytest.mark.parametrize("mu", [0.005, 0.05, 0.2, 0.6, 1.2])
def test_gloss_creates_no_energy_at_any_roughness(mu):
    light = even_light()
    glossy = material(0.0, beta=1 / (4 * mu**2), mu=mu, n=0.01, k=20.0)
    found = picture([BALL], [glossy], light)
    truth = xyz_from_radiance(light.upward_white()) @ spectrum_of()
    assert found[20, 20, 1] > 0 and found.max() <= 1.01 * truth.max()
