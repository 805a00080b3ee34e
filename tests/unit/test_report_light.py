"""The report's part on light says what the environment's file says."""

import re

import numpy as np
import pytest
from made import made

from irodori.config.models import IrradianceMap, LightsSource, RgbSource, Size, SpectralSource
from irodori.core import store
from irodori.light.stage import make_environment
from irodori.material.coefficients import write_coefficients
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.report.html_page import fragment
from irodori.report.page import environments

LIGHTS = [{"spectrum": "A", "azimuth_deg": 20.0, "elevation_deg": 50.0, "diameter_deg": 30.0, "irradiance": 1.0}]


def test_a_light_is_told_with_its_source_and_the_rows_of_its_map(tmp_path):
    path = tmp_path / "room.h5"
    make_environment(
        made(RgbSource | SpectralSource | LightsSource, {"kind": "lights", "lights": LIGHTS}),
        made(Size, {"width": 64, "height": 32}),
        path,
        CompressOptions(),
        made(IrradianceMap, {"max_error": 0.01, "max_height": 64}),
        store.Provenance("test"),
    )
    page = fragment("light.html.j2", environments=environments(["room & hall"], [path]))
    assert "room &amp; hall" in page and "Source: lights." in page
    with store.open_file(path) as file:
        errors = file.attribute("errors")
    assert f"map of {errors['irradiance']['height']} rows" in page


def test_the_size_told_is_that_of_the_packed_numbers(tmp_path):
    coefficients = np.random.default_rng(1).normal(size=(64, 128, 4)).astype(np.float32)
    with store.create(tmp_path / "a.h5", store.Provenance("test")) as out:
        write_coefficients(out, "coefficients", coefficients, quantity="coefficients", storage="half", codec="gzip")
        out.attribute("errors", {})
        out.attribute("origin", {})
    sentence = environments(["noise"], [tmp_path / "a.h5"])[0]["stored"]
    megabytes, ratio = map(float, re.findall(r"[\d.]+(?= (?:MB|times))", sentence))
    # Noise hardly packs: 16 bits of each of 4 x 8192 numbers, against 61 x 32 bits a pixel.
    assert 0.04 < megabytes < 0.075 and ratio == pytest.approx(64 * 128 * 61 * 4 / 1e6 / megabytes, rel=0.02)
