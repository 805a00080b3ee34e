"""The payload of a page: what is read is what was written, within its steps, and damage is named in one sentence."""

import base64
import json
import struct
import zlib

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pages import room, sources

from irodori.core.errors import InputError
from irodori.light.environment_file import Environment
from irodori.viewer.page_data import page_data
from irodori.viewer.payload import LOG_STEP, RATIO_STEP, StoredPlanes, read_payload, with_stated_errors, write_payload
from irodori.viewer.scene_data import add_light, decoded_light, light_maps


def planes() -> tuple[StoredPlanes, dict]:
    rng = np.random.default_rng(3)
    basis = np.linalg.qr(rng.normal(size=(61, 3)))[0].T
    level = np.exp(rng.normal(size=(6, 4, 4)) * 3)
    light = np.stack([level, 0.3 * level * rng.normal(size=level.shape), 0.1 * level])
    given = {"map": rng.normal(size=(2, 5, 7)), "gloss": rng.random((1, 5, 7)) ** 6, "light": light}
    found = StoredPlanes()
    found.add_linear("map", given["map"])
    found.add_log("gloss", given["gloss"])
    found.add_light("light", light, basis)
    found.add_floats("table", given["map"])
    found.add_integers("faces", np.arange(70_000).reshape(1, -1)[:, ::-1])
    return found, given


def test_planes_come_back_within_half_a_step():
    written, given = planes()
    header, found = read_payload(write_payload({"scene": "é"}, written))
    assert header["scene"] == "é"
    for channel, values in enumerate(given["map"]):
        np.testing.assert_allclose(found["map"][channel], values, atol=0.5001 * np.ptp(values) / 1023)
    np.testing.assert_array_equal(found["table"], given["map"].astype(np.float32))
    np.testing.assert_array_equal(found["faces"][0], np.arange(70_000)[::-1])
    level, light = given["light"][0], found["light"]
    floor = 1e-4 * level.mean()
    np.testing.assert_allclose(np.log2(light[0] / floor + 1), np.log2(level / floor + 1), atol=0.51 * LOG_STEP)
    for channel in (1, 2):
        error = light[channel] - given["light"][channel]
        assert np.max(np.abs(error) / (level + floor)) < 0.6 * RATIO_STEP


def test_small_numbers_of_gloss_keep_their_relative_size():
    written, given = planes()
    found = read_payload(write_payload({}, written))[1]["gloss"]
    bright = given["gloss"] > 1e-3 * given["gloss"].max()
    np.testing.assert_allclose(found[bright], given["gloss"][bright], rtol=0.01)


def damaged(change) -> str:
    written, _ = planes()
    stream = zlib.decompress(base64.b64decode(write_payload({}, written)), wbits=31)
    length = struct.unpack("<I", stream[:4])[0]
    header = json.loads(stream[4 : 4 + length])
    body = change(header) or b""
    text = json.dumps(header).encode()
    whole = struct.pack("<I", len(text)) + text + stream[4 + length :] + body
    return base64.b64encode(zlib.compress(whole, wbits=31)).decode()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda h: h.update(schema_version=99), "version 99"),
        (lambda h: h["planes"][0].update(code="jpeg"), "unknown code"),
        (lambda h: h["planes"][0].update(shape=[2, 5, 70]), "cut short"),
        (lambda h: h["planes"][0].update(step=[1.0]), "1 steps of 2 channels"),
        (lambda h: h["planes"][0].pop("floor"), "other fields"),
        (lambda h: b"more", "4 bytes after the last plane"),
        (lambda h: h.update(planes=7), "no header"),
    ],
)
def test_a_payload_of_another_kind_is_refused_in_one_sentence(change, said):
    with pytest.raises(InputError, match=said) as caught:
        read_payload(damaged(change), "page.html")
    assert str(caught.value).startswith("page.html") and str(caught.value).count("accepted:") == 1


@settings(max_examples=60, deadline=None)
@given(at=st.integers(0, 10**9), byte=st.integers(1, 255), keep=st.floats(0, 1))
def test_damage_anywhere_is_found(at, byte, keep):
    raw = bytearray(base64.b64decode(write_payload({}, planes()[0])))
    assume(at % len(raw) != 9)  # the system that wrote it, which changes nothing
    raw[at % len(raw)] ^= byte
    for broken in (bytes(raw), bytes(raw[: int(keep * (len(raw) - 1))])):
        with pytest.raises(InputError):
            read_payload(base64.b64encode(broken).decode())


def test_errors_that_are_stated_later_change_nothing_else():
    before = write_payload({"scene": "é", "stated_errors": {"cpu": None}, "title": "x"}, planes()[0])
    errors = {"cpu": {"mean": 0.1}}
    after = with_stated_errors(before, errors)
    assert after == write_payload({"scene": "é", "stated_errors": errors, "title": "x"}, planes()[0])
    with pytest.raises(InputError, match="cut short"):
        with_stated_errors(before[: len(before) // 8 * 4], errors)


def test_what_is_not_base64_is_refused():
    with pytest.raises(InputError, match="not base64"):
        read_payload("no payload!")


def test_light_is_the_same_whatever_vectors_its_file_is_on(tmp_path):
    """Principal vectors of either sign, a mixture of them, one vector a lamp: what is decoded is the file's spectra."""
    light = room()
    mixed = np.random.default_rng(3).normal(size=(6, 6))
    given = sources(tmp_path, light)
    data = page_data(given)
    wanted = light_maps(light, data.parts.objects)
    for basis_from_other in (-np.eye(6), mixed):
        turned = Environment(
            (light.coefficients @ np.linalg.inv(basis_from_other).T).astype(np.float32),
            light.basis @ basis_from_other,
            light.irradiance @ np.linalg.inv(basis_from_other).T,
        )
        planes = StoredPlanes()
        entry = add_light(planes, 0, light_maps(turned, data.parts.objects))
        found = decoded_light(read_payload(write_payload({}, planes))[1], 0, entry)
        for name in ("sky", "irradiance"):
            one, other = (np.einsum("k...,kw->...w", getattr(maps, name), maps.basis) for maps in (wanted, found))
            assert np.abs(other - one).max() <= 0.01 * one.max(), name
            assert np.median(np.abs(other - one) / one.mean(axis=-1, keepdims=True)) < 0.002, name
