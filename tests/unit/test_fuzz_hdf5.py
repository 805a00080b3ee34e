"""HDF5 files cut short, with flipped bits, of wrong types and shapes: refused by name; nothing is written from them."""

from contextlib import suppress

import h5py
import numpy as np
import pytest
from damage import cut, flip, places, shares
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_up_camera import training
from scenes import material, sky

from irodori.calibration.estimators import fit
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material

PROVENANCE = store.Provenance("test")
TEXELS, CAPTURES, BANDS = 12, 17, 6


def write_observations(path) -> None:
    """A tile of observations of a matte texture."""
    rng = np.random.default_rng(0)
    geometry = rng.uniform(0.1, 1.2, (TEXELS, CAPTURES, 4))
    response = (
        0.4 * np.cos(geometry[..., :1]) * np.ones(BANDS) * (1 + 0.01 * rng.normal(size=(TEXELS, CAPTURES, BANDS)))
    )
    maps = {
        "response": (response.astype(np.float32), "1", "texel_number,capture,band"),
        "geometry": (geometry.astype(np.float32), "rad", "texel_number,capture,angle"),
        "weight": (np.ones((TEXELS, CAPTURES), np.float32), "1", "texel_number,capture"),
        "clipped": (np.zeros((TEXELS, CAPTURES), np.uint8), "1", "texel_number,capture"),
        "noise_model": (np.full((CAPTURES, BANDS, 2), 1e-6), "1", "capture,band,coefficient"),
        "texel": (np.ones(TEXELS, np.uint8), "1", "texel_number"),
    }
    with store.create(path, PROVENANCE) as out:
        for name, (values, units, dims) in maps.items():
            out.write(name, values, units=units, dims=dims, quantity=name, compression="fast")
        for name, value in {"rows": [0, 3], "width": 4, "filters": ["out", "in"]}.items():
            out.attribute(name, value)


def write_calibration(path, name: str) -> None:
    with store.create(path, PROVENANCE) as out:
        fit(name, training(0.003), 6).write(out)


def fit_tile(path) -> None:
    """Fit a tile into a folder of its own; a refusal must leave that folder empty."""
    folder = path.parent / "fitted"
    folder.mkdir(exist_ok=True)
    output = folder / "tile.h5"
    output.unlink(missing_ok=True)
    try:
        fit_brdf(path, output, FitOptions(), 1.5, 0.0, provenance=PROVENANCE)
    except InputError:
        assert list(folder.iterdir()) == []
        raise
    with store.open_file(output) as file:
        assert np.isfinite(file.read("alpha")).any()


#: What writes a file, and what reads it.
FILES = {
    "material": (lambda path: material(np.linspace(0.1, 0.9, 61)).save(path, PROVENANCE), Material.load),
    "environment": (lambda path: sky(lambda d: 2 + d[..., 2:], 32, 16).save(path, PROVENANCE), Environment.load),
    "calibration": (lambda path: write_calibration(path, "pinv"), Calibration.load),
    "calibration-local": (lambda path: write_calibration(path, "local"), Calibration.load),
    "observations": (write_observations, fit_tile),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the path of a whole file by its name in FILES."""
    folder = tmp_path_factory.mktemp("whole")
    for name, (write, _) in FILES.items():
        write(folder / f"{name}.h5")
    return lambda name: folder / f"{name}.h5"


def variables(file: h5py.File) -> list[str]:
    """Return the names of the datasets that hold values: an axis without any has its length alone."""
    names = []
    file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    return [name for name in names if not file[name].attrs.get("NAME", b"").startswith(b"This is a netCDF dimension")]


def everything(path) -> dict:
    """Return all datasets and attributes of a file."""
    with h5py.File(path) as file:
        names = variables(file)
        attributes = list(file.attrs)
    with store.open_file(path) as file:
        values = {name: file.read(name).tobytes() for name in names}
        return values | {f"@{name}": repr(file.attribute(name)) for name in attributes}


def taken_as_it_is(path) -> None:
    """Give a file the hash of its present content, so that its readers are what must refuse it."""
    with suppress(InputError):
        accept(path)


def refused(read, path) -> bool:
    """Whether a reader refuses a file; anything but a refusal in words fails."""
    try:
        read(path)
    except InputError as error:
        assert str(path) in str(error) and error.found and error.accepted and "\n" not in str(error)
        return True
    return False


@pytest.mark.stability(stage="fuzzing", case="HDF5 truncated")
@pytest.mark.parametrize("name", FILES)
@given(share=shares)
@settings(deadline=None, max_examples=examples(8), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_cut_short_is_refused(whole, tmp_path, name, share):
    path = tmp_path / "cut.h5"
    path.write_bytes(cut(whole(name).read_bytes(), share))
    assert refused(FILES[name][1], path)


@pytest.mark.stability(stage="fuzzing", case="HDF5 bit-flipped")
@pytest.mark.parametrize("name", FILES)
@given(damage=places)
@settings(deadline=None, max_examples=examples(25), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_with_flipped_bits_is_refused_or_the_same(whole, tmp_path, name, damage):
    path = tmp_path / "flipped.h5"
    path.write_bytes(flip(whole(name).read_bytes(), damage))
    assert path.read_bytes() == whole(name).read_bytes() or refused(FILES[name][1], path)
    taken_as_it_is(path)
    if refused(FILES[name][1], path):
        return
    # What was read is what was written; what nobody reads may be damaged, and then says so.
    try:
        found = everything(path)
    except (InputError, RuntimeError, KeyError):
        return
    assert found == everything(whole(name))


def put_dataset(file: h5py.File, name: str, odd) -> None:
    """Put something else in the place of a dataset."""
    values = file[name][()]
    attributes = {key: file[name].attrs[key] for key in ("units", "dims", "quantity")}
    del file[name]
    if odd == "absent":
        return
    others = {
        "text": lambda: np.array([b"abc", b"d"]), "empty": lambda: h5py.Empty("f4"), "number": lambda: 3.0,
        "one axis more": lambda: values[None], "one axis less": lambda: values[0] if values.ndim else values[None],
        "longer": lambda: np.concatenate([values, values]) if values.ndim else values,
        "complex": lambda: values.astype(complex),
        "nothing along an axis": lambda: values[:0] if values.ndim else values,
    }  # fmt: skip
    if odd == "group":
        file.create_group(name)
    else:
        file[name] = others[odd]()
        file[name].attrs.update(attributes)


ODD = ("absent", "text", "empty", "number", "one axis more", "one axis less", "longer", "complex",
       "nothing along an axis", "group")  # fmt: skip
ODD_ATTRIBUTES = (..., 3, -1.5, "text", "json:[", "json:{}", "json:[1]", b"\xff", np.arange(3), h5py.Empty("f4"))


@pytest.mark.stability(stage="fuzzing", case="HDF5 of wrong types or shapes")
@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
@settings(deadline=None, max_examples=examples(25), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_another_dataset_in_the_place_of_one_is_refused_or_will_do(whole, tmp_path, name, data):
    path = tmp_path / "other.h5"
    path.write_bytes(whole(name).read_bytes())
    with h5py.File(path, "a") as file:
        put_dataset(file, data.draw(st.sampled_from(variables(file))), data.draw(st.sampled_from(ODD)))
    taken_as_it_is(path)
    refused(FILES[name][1], path)


@pytest.mark.stability(stage="fuzzing", case="HDF5 of wrong types or shapes")
@pytest.mark.parametrize("name", FILES)
@given(data=st.data(), odd=st.sampled_from(ODD_ATTRIBUTES))
@settings(deadline=None, max_examples=examples(15), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_another_attribute_in_the_place_of_one_is_refused_or_will_do(whole, tmp_path, name, data, odd):
    path = tmp_path / "other.h5"
    path.write_bytes(whole(name).read_bytes())
    with h5py.File(path, "a") as file:
        attribute = data.draw(st.sampled_from(sorted(file.attrs)))
        del file.attrs[attribute]
        if odd is not ...:
            file.attrs[attribute] = odd
    taken_as_it_is(path)
    refused(FILES[name][1], path)


def test_whole_files_are_read(whole):
    assert not any(refused(read, whole(name)) for name, (_, read) in FILES.items())
