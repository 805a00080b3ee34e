"""Tables of photographs that somebody else took: what cannot be is refused, on the photograph where it occurs."""

import dataclasses
import shutil

import numpy as np
import pytest
from accidents import Mishap
from made import made
from sessions import definitions

from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.session import Session, take_stock
from irodori.capture.shot_list import object_shots
from irodori.config.capture_table import FILTERS, Taken, read_captures, write_captures
from irodori.config.models import Camera, Object, Rig
from irodori.core.errors import InputError
from irodori.ingest.first_look import check_captures
from irodori.ingest.mosaic import decode
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera

POSES = [{"light_deg": [45.0, 65.0], "camera_deg": [0.0, 30.0]}]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A folder of four poses of the plate, as the virtual rig photographs them, with their table."""
    folder = tmp_path_factory.mktemp("sound")
    definition, camera, rig = definitions(poses=POSES)
    # In a smaller picture the filter's plate moves the tiles by as much as a pose does.
    camera["optics"].update(width_px=240, height_px=160, pixel_pitch_um=33.0, principal_point_px=[120.0, 80.0])
    subject, camera, rig = made(Object, definition), made(Camera, camera), made(Rig, rig)
    bench, journal, planned = Bench(), Journal(folder / "captures.csv"), object_shots(subject, camera, ".dng")
    eye = VirtualCamera(camera, rig, bench, "plate", planned, subject)
    Session(eye, AutoOperator(bench.set), journal, None, take_stock(journal, planned)).run(planned, "plate")
    return folder


def other(shot):
    return dataclasses.replace(shot, filter=FILTERS[1 - FILTERS.index(shot.filter)])


def exchanged(shots, folder):
    return [other(shot) for shot in shots]


def exchanged_once(shots, folder):
    return [other(shot) if shot.capture == shots[4].capture else shot for shot in shots]


def shifted(shots, folder):
    through = [shot.file for shot in shots if shot.filter == "in"]
    contents = [(folder / file).read_bytes() for file in through]
    for file, content in zip(through, contents[1:] + contents[:1], strict=True):
        (folder / file).write_bytes(content)


def repeated(shots, folder):
    shutil.copyfile(folder / shots[2].file, folder / shots[4].file)


def level(value, model="virtual camera"):
    """Return the mistake of a photograph that has one level, with noise."""

    def spoil(shots, folder):
        mosaic = np.clip(value + np.random.default_rng(1).integers(-9, 10, (160, 240)), 0, 16383).astype(np.uint16)
        time = shots[4].exposure_s
        write_dng(folder / shots[4].file, mosaic, black_level=600, white_level=16380, exposure_s=time, model=model)

    return spoil


MISTAKES = {
    "exchanged in the whole table": (exchanged, 1, "filter: found it is .* no filter adds light.* 'in' and 'out'"),
    "exchanged in one pose": (exchanged_once, 5, "filter: found .*"),
    "names shifted by a pose": (shifted, 1, "order: found it shows what .* names of one filter state shifted"),
    "one picture for two poses": (repeated, 4, "identical: found the very picture of .*delivered twice"),
    "black": (level(600), 4, "black: found .*cap on the lens, or the lamp off"),
    "another body": (level(9000, "spare"), 4, "body: found taken with 'Irodori spare'.*is this the right one"),
    "white": (level(16400), 4, "blown: found 100% of what is lit is saturated"),
}


def check(folder, shots):
    write_captures(folder / "captures.csv", shots)
    check_captures(folder / "captures.csv", folder, folder / "checked.csv", ["object"], (240, 160))


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_table_is_refused_on_its_photograph(tmp_path, sound, name):
    mistake, at, words = MISTAKES[name]
    folder = shutil.copytree(sound, tmp_path / "set")
    shots = read_captures(folder / "captures.csv")
    spoilt = mistake(shots, folder) or shots
    with pytest.raises(InputError, match=words) as caught:
        check(folder, spoilt)
    assert shots[at].capture in caught.value.file
    assert not (folder / "checked.csv").exists()


def test_a_photograph_out_of_focus_is_named_and_not_refused(tmp_path, sound, caplog):
    """A grazing view may be soft for want of depth of field, so that a person has to look."""
    folder = shutil.copytree(sound, tmp_path / "set")
    shots = read_captures(folder / "captures.csv")
    taken = decode(folder / shots[4].file)
    soft = Mishap(blur_px=2.0).seen(taken.values.astype(float)).round().astype(np.uint16)
    time = shots[4].exposure_s
    write_dng(folder / shots[4].file, soft, black_level=600, white_level=16383, exposure_s=time, model="virtual camera")
    check(folder, shots)
    (said,) = [one.getMessage() for one in caplog.records if one.levelname == "WARNING"]
    assert shots[4].file in said and "look at the focus, and whether something shook" in said


def test_sound_photographs_pass_and_so_do_those_for_which_the_table_gives_a_reason(tmp_path, sound):
    folder = shutil.copytree(sound, tmp_path / "set")
    shots = read_captures(folder / "captures.csv")
    check(folder, shots)
    repeated(shots, folder)
    shots[4] = dataclasses.replace(shots[4], taken=Taken(accepted="the same view on purpose"))
    check(folder, shots)
    assert read_captures(folder / "checked.csv")[4].taken.accepted == "the same view on purpose"


def test_a_filter_may_be_made_up_for_by_the_aperture(tmp_path, sound):
    folder = shutil.copytree(sound, tmp_path / "set")
    shots = read_captures(folder / "captures.csv")
    for shot in shots:  # behind the filter a sixth of the time, and six times the light through the lens
        taken = decode(folder / shot.file)
        time, model = (shot.exposure_s / 6.0 if shot.filter == "in" else shot.exposure_s), "virtual camera"
        write_dng(folder / shot.file, taken.values, black_level=600, white_level=16383, exposure_s=time, model=model)
    told = [
        dataclasses.replace(shot, exposure_s=shot.exposure_s / 6.0, f_number=8.0 / 6.0**0.5)
        if shot.filter == "in"
        else dataclasses.replace(shot, f_number=8.0)
        for shot in shots
    ]
    check(folder, told)
    assert len(read_captures(folder / "checked.csv")) == len(shots)
