"""Files are whole or absent, carry their units, and are refused in words that name them."""

import os

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError

PROVENANCE = store.Provenance("fit_brdf", config_hash="c0ffee", code_hash="beef")
DIMS = ["", "row", "row,column", "row,column,band"]
FIXTURE_IS_REUSED = [HealthCheck.function_scoped_fixture]


def write_sample(path, values=None):
    values = np.arange(20000.0).reshape(100, 200) if values is None else values
    with store.create(path, PROVENANCE) as file:
        file.write("alpha", values, units="1", dims=DIMS[np.ndim(values)], quantity="diffuse weight")
    return path


def refusal(path, name=None):
    with pytest.raises(InputError) as caught, store.open_file(path) as file:
        if name is not None:
            file.read(name)
    assert str(path) in str(caught.value)
    return caught.value


# Writing


@pytest.mark.stability(stage="store", case="failure while writing")
@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_block_that_fails_leaves_no_file_and_no_temporary(tmp_path, failure):
    with pytest.raises(failure), store.create(tmp_path / "new" / "out.h5", PROVENANCE) as file:
        file.write("alpha", np.zeros((200, 200)), units="1", dims="row,column", quantity="x")
        raise failure
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.stability(stage="store", case="failure while writing")
def test_a_block_that_fails_leaves_the_earlier_file_as_it_was(tmp_path):
    path = write_sample(tmp_path / "out.h5")
    before = path.read_bytes()
    with pytest.raises(RuntimeError), store.create(path, PROVENANCE) as file:
        file.write("alpha", np.zeros(3), units="1", dims="row", quantity="x")
        raise RuntimeError
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["out.h5"]


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        file.write("alpha", 1.0, units="1", dims="", quantity="x")
        assert not path.exists()
    assert os.listdir(tmp_path) == ["out.h5"]


@given(
    values=st.integers(0, 3).flatmap(
        lambda axes: hnp.arrays(
            st.sampled_from([np.float64, np.float32, np.int32, np.uint8, np.bool_]),
            hnp.array_shapes(min_dims=axes, max_dims=axes, max_side=12) if axes else (),
        )
    )
)
@settings(deadline=None, suppress_health_check=FIXTURE_IS_REUSED, max_examples=40)
def test_values_type_and_meaning_come_back_as_written(tmp_path, values):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        file.write("maps/alpha", values, units="mm", dims=DIMS[values.ndim], quantity="height of the face")
    with store.open_file(path) as file:
        read = np.asarray(file.read("maps/alpha"))
        assert read.dtype == values.dtype and read.shape == values.shape
        assert np.array_equal(read, values, equal_nan=values.dtype.kind == "f")
        kept = file.dataset("maps/alpha").attrs
        attributes = {name: kept[name] for name in ("units", "dims", "quantity")}
    assert attributes == {"units": "mm", "dims": DIMS[values.ndim], "quantity": "height of the face"}


@pytest.mark.parametrize("shape", [(0,), (0, 61), (3000, 61), (70, 1000, 6), (2, 3, 400000)])
def test_empty_and_large_arrays_come_back_and_rows_can_be_read_alone(tmp_path, shape):
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    path = write_sample(tmp_path / "out.h5", values)
    with store.open_file(path) as file:
        assert np.array_equal(file.read("alpha"), values)
        if shape[0]:
            assert np.array_equal(file.dataset("alpha")[1:3], values[1:3])


def test_every_file_says_where_it_came_from(tmp_path):
    with store.open_file(write_sample(tmp_path / "out.h5")) as file:
        assert file.attribute("schema_version") == store.SCHEMA_VERSION
        assert file.attribute("rule") == "fit_brdf"
        assert file.attribute("config_hash") == "c0ffee"
        assert file.attribute("code_hash") == "beef"
        assert {"irodori", "numpy", "h5py"} <= set(file.attribute("created_by"))


@pytest.mark.parametrize("dims", ["", "row", "row,column,band"])
def test_axes_without_a_name_are_refused_and_leave_no_file(tmp_path, dims):
    path = tmp_path / "out.h5"
    with pytest.raises(ValueError, match="alpha"), store.create(path, PROVENANCE) as file:
        file.write("alpha", np.zeros((2, 2)), units="1", dims=dims, quantity="x")
    assert os.listdir(tmp_path) == []


def test_maps_of_one_family_share_their_leading_axes(tmp_path):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        maps = {"mu": (np.ones((2, 3)), "rad", "roughness"), "more": (np.ones((2, 3, 4)), "1", "more")}
        store.write_maps(file, maps, "row,column,band")
    with store.open_file(path) as file:
        assert file.dataset("mu").attrs["dims"] == "row,column" and file.dataset("mu").attrs["units"] == "rad"
        assert file.dataset("more").attrs["dims"] == "row,column,band"


@pytest.mark.parametrize("value", [3, 2.5, "plain", {"a": [1, 2]}, [1.5, "x"], [], {}])
def test_attributes_come_back_as_written(tmp_path, value):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        file.attribute("note", value)
    with store.open_file(path) as file:
        assert file.attribute("note") == value


@given(text=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20))
@example(text="[draft] second varnish")
@example(text="{unclear}")
@settings(deadline=None, suppress_health_check=FIXTURE_IS_REUSED, max_examples=30)
def test_text_comes_back_as_text(tmp_path, text):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        file.attribute("note", text)
    with store.open_file(path) as file:
        assert file.attribute("note") == text


# Reading


def test_a_missing_file_is_refused_by_name(tmp_path):
    assert "no such file" in refusal(tmp_path / "absent.h5").found
    assert refusal(tmp_path)  # a folder is no file


@pytest.mark.stability(stage="store", case="truncated file")
@given(share=st.floats(0.0, 1.0, exclude_max=True))
@settings(deadline=None, suppress_health_check=FIXTURE_IS_REUSED, max_examples=40)
def test_a_file_cut_short_anywhere_is_refused(tmp_path, share):
    path = write_sample(tmp_path / "cut.h5", np.random.default_rng(1).random((100, 200)))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    refusal(path, "alpha")


@pytest.mark.stability(stage="store", case="damaged data")
def test_damaged_data_is_refused_on_reading(tmp_path):
    path = write_sample(tmp_path / "damaged.h5", np.random.default_rng(1).random((100, 200)))
    with h5py.File(path) as file:
        chunk = file["alpha"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    middle = chunk.byte_offset + chunk.size // 2
    content[middle : middle + 64] = bytes(64)
    path.write_bytes(content)
    assert "content that its rule did not write" in refusal(path).found
    accept(path)
    assert refusal(path, "alpha").field == "alpha"


@pytest.mark.stability(stage="store", case="foreign file")
@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89HDF\r\n\x1a\n", bytes(4096)])
def test_a_file_that_is_no_hdf5_is_refused(tmp_path, content):
    path = tmp_path / "other.h5"
    path.write_bytes(content)
    refusal(path)


@pytest.mark.stability(stage="store", case="foreign file")
@pytest.mark.parametrize(
    "attributes",
    [{}, {"rule": "fit_brdf"}, {"schema_version": 1}, {"schema_version": "draft-7", "rule": "x"}],
    ids=["none", "rule", "version", "text"],
)
def test_hdf5_of_another_program_is_refused(tmp_path, attributes):
    path = tmp_path / "foreign.h5"
    with h5py.File(path, "w") as file:
        file["alpha"] = np.zeros(3)
        file.attrs.update(attributes)
    assert refusal(path).field == "schema_version"


@pytest.mark.stability(stage="store", case="newer version")
def test_a_newer_schema_is_refused_with_both_versions(tmp_path):
    path = write_sample(tmp_path / "newer.h5")
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = store.SCHEMA_VERSION + 1
    error = refusal(path)
    assert str(store.SCHEMA_VERSION + 1) in error.found and str(store.SCHEMA_VERSION) in error.accepted


def test_a_missing_dataset_is_refused_and_the_present_ones_are_listed(tmp_path):
    path = write_sample(tmp_path / "out.h5")
    error = refusal(path, "beta")
    assert error.field == "beta" and "alpha" in error.accepted


def test_a_group_is_no_dataset(tmp_path):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        file.write("reflectance/basis", np.ones((61, 6)), units="1", dims="sample,component", quantity="basis")
    error = refusal(path, "reflectance")
    assert "reflectance/basis" in error.accepted


def test_a_missing_attribute_is_refused_by_file_and_name(tmp_path):
    path = write_sample(tmp_path / "out.h5")
    with store.open_file(path) as file, pytest.raises(InputError) as caught:
        file.attribute("weather")
    assert str(path) in str(caught.value) and caught.value.field == "weather"


def test_membership_tells_what_is_there(tmp_path):
    with store.open_file(write_sample(tmp_path / "out.h5")) as file:
        assert "alpha" in file and "beta" not in file


@pytest.mark.parametrize("compression", ["small", "fast"])
def test_either_packing_returns_the_same_bits(tmp_path, compression):
    values = np.random.default_rng(0).normal(size=(300, 200, 3)).astype(np.float32)
    values[:100] = 0.0
    with store.create(tmp_path / "a.h5", store.Provenance("test")) as out:
        out.write("x", values, units="1", dims="a,b,c", quantity="x", compression=compression)
    assert (tmp_path / "a.h5").stat().st_size < 0.9 * values.nbytes
    with store.open_file(tmp_path / "a.h5") as file:
        assert np.array_equal(file.read("x"), values)
        assert np.array_equal(file.dataset("x")[150:160, 20:30], values[150:160, 20:30])


def test_an_unknown_packing_is_refused(tmp_path):
    with (
        pytest.raises(ValueError, match="accepted: small, fast, none"),
        store.create(tmp_path / "a.h5", store.Provenance("test")) as out,
    ):
        out.write("x", np.zeros(100), units="1", dims="a", quantity="x", compression="zip")
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize(
    ("axes", "lengths", "name", "found"),
    [
        ({"alpha": "row,column", "beta": "row"}, {}, "beta", "2 axes"),
        ({"alpha": "row,column", "beta": "column,row"}, {}, "beta", "4 along the axis column"),
        ({"alpha": "row,column"}, {"column": 61}, "alpha", "5 along the axis column"),
        ({"alpha": "row,column", "name": "letter"}, {}, "name", "values of type"),
        ({"alpha": "row,column", "gamma": "row"}, {}, "gamma", "no such dataset"),
    ],
)
def test_datasets_that_do_not_fit_together_are_refused(tmp_path, axes, lengths, name, found):
    path = tmp_path / "out.h5"
    with store.create(path, PROVENANCE) as file:
        for dataset, values, dims in (("alpha", np.ones((4, 5)), "row,column"), ("beta", np.ones((4, 5)), "row,column"),
                                      ("name", np.array([b"a", b"b"]), "letter")):  # fmt: skip
            file.write(dataset, values, units="1", dims=dims, quantity="x")
    with store.open_file(path) as file:
        file.require_axes({"alpha": "row,column", "beta": "row,column"}, row=4)
        with pytest.raises(InputError, match=found) as caught:
            file.require_axes(axes, **lengths)
    assert caught.value.field == name


def test_an_attribute_of_another_kind_is_refused_with_both_kinds(tmp_path):
    with store.create(tmp_path / "out.h5", PROVENANCE) as file:
        file.attribute("rows", [0, 3])
    with store.open_file(tmp_path / "out.h5") as file:
        assert file.attribute("rows", list) == [0, 3]
        with pytest.raises(InputError, match="rows: found a list; accepted: float or int"):
            file.attribute("rows", (float, int))
