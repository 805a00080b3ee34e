"""Several gloss components in what is compared with the truth, drawn, shown and exported."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from irodori.core import store
from irodori.evaluation.error_prediction import other_gloss
from irodori.evaluation.truth_errors import comparable_gloss, material_errors
from irodori.export.material_pictures import export_material
from irodori.material.material_file import Material
from irodori.report.figures import material_figure
from irodori.report.page import typical_gloss_text


def of(lobes, *pairs) -> Material:
    (beta, mu), *further = pairs
    return Material.uniform(0.4, beta, mu, lobes=lobes, further_gloss=tuple(further))


def test_a_component_is_compared_with_the_true_one_of_its_lobe():
    own = of(("ggx", "gaussian"), (2.0, 0.4), (5.0, 0.05))
    truth = of(("gaussian", "ggx"), (4.0, 0.1), (1.0, 0.3))
    (beta, mu), (beta_2, mu_2) = comparable_gloss(own, truth)
    assert (beta == 1.0).all() and (mu == 0.3).all() and (beta_2 == 4.0).all() and (mu_2 == 0.1).all()
    rows = {row.quantity: row.mean for row in material_errors("pot", own, truth, ["D65"])}
    assert rows["beta relative away from seams, where known"] == pytest.approx(1.0)
    assert rows["beta_2 relative away from seams, where known"] == pytest.approx(0.25)
    assert rows["mu_2 relative away from seams, where known"] == pytest.approx(0.5)


def test_the_first_of_a_lobe_stands_beside_the_first():
    own, truth = of(("ggx", "ggx"), (2.0, 0.4), (5.0, 0.05)), of(("ggx", "ggx"), (1.0, 0.5), (4.0, 0.1))
    assert [float(mu[0, 0]) for _, mu in comparable_gloss(own, truth)] == [0.5, 0.1]


def test_gloss_that_a_fit_has_no_component_for_leaves_nothing_to_compare():
    truth = of(("gaussian", "ggx"), (4.0, 0.1), (1.0, 0.3))
    for own in (of(("gaussian",), (4.0, 0.1)), of(("ggx",), (4.0, 0.1))):
        assert np.isnan(comparable_gloss(own, truth)).all()
    # Where the other component reflects nothing, there is; and not where the component itself does not.
    (_, beta, mu), (_, beta_2, mu_2) = truth.gloss
    shown = np.array([[True, False], [False, False]])
    partly = truth.with_gloss([(beta, mu), (np.where(shown, beta_2, 0.0), mu_2)])
    (found, _), *_ = comparable_gloss(of(("gaussian",), (4.0, 0.1)), partly)
    assert np.array_equal(np.isnan(found), shown)
    (found, _), *_ = comparable_gloss(of(("ggx",), (4.0, 0.1)), of(("ggx",), (0.0, 0.1)))
    assert np.isnan(found).all()


def test_each_component_has_standard_errors_of_its_own():
    own = of(("ggx", "gaussian"), (2.0, 0.4), (5.0, 0.05))
    known = SimpleNamespace(gloss_error=np.broadcast_to((0.0, 0.0, 0.5, 0.002), (2, 2, 4)))
    drawn = other_gloss(known, own, np.random.default_rng(0))
    assert np.array_equal(drawn.beta, own.beta) and np.array_equal(drawn.mu, own.mu)
    (beta, mu) = drawn.further_gloss[0]
    assert (beta != 5.0).all() and np.abs(beta - 5.0).max() < 2.5 and np.abs(mu - 0.05).max() < 0.01
    assert (mu != 0.05).all()


def test_a_report_says_the_lobe_and_the_unit_of_every_component():
    text = typical_gloss_text(of(("ggx", "gaussian"), (2.0, 0.4), (5.0, 0.05)))
    assert text == "β = 2, μ = 0.4 (GGX facets); β = 5, μ = 0.05 rad (Gaussian facets)"


def test_the_maps_of_every_component_are_in_the_figure(monkeypatch):
    titles = []
    monkeypatch.setattr("irodori.report.figures._map", lambda axes, figure, values, *said: titles.append(said))
    maps = dict.fromkeys(("residual_rms", "reflectance_error", "delta_e_error"), np.zeros((2, 2)))
    maps["status"] = np.zeros((2, 2), dtype=int)
    own = of(("ggx", "gaussian"), (2.0, 0.4), (5.0, 0.05))
    assert material_figure(own, maps, None).startswith("data:image/png")
    assert {("μ of GGX facets", "1"), ("μ of Gaussian facets", "rad"), ("β of GGX facets", "1")} <= set(titles)
    titles.clear()
    material_figure(of(("gaussian",), (2.0, 0.4)), maps, None)
    assert ("μ", "rad") in titles and ("β", "1") in titles


def test_an_exported_material_has_the_maps_of_every_component(tmp_path):
    import OpenImageIO as oiio

    own = of(("ggx", "gaussian"), (2.0, 0.4), (5.0, 0.05))
    replace(own, mirror=0.0).save(tmp_path / "m.h5", store.Provenance("test"))
    export_material(tmp_path / "m.h5", tmp_path / "m.exr")
    picture = oiio.ImageBuf(str(tmp_path / "m.exr"))
    names = list(picture.spec().channelnames)
    values = picture.get_pixels(oiio.FLOAT)
    for name, expected in (("beta", 2.0), ("mu", 0.4), ("beta_2", 5.0), ("mu_2", 0.05)):
        assert values[..., names.index(name)] == pytest.approx(expected)
    assert "mu_2 is in rad" in picture.spec().getattribute("irodori:units")
