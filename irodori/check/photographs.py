"""Check of all photographs that a configuration names: each is decoded once, and nothing is written."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from irodori.calibration.chart import Located, locate_patches
from irodori.calibration.chart_reading import ChartPhotograph
from irodori.calibration.charts import read_chart
from irodori.calibration.illumination import illumination
from irodori.check.findings import Finding
from irodori.config.capture_table import LENS, Shot, chart_capture, check_unchanged, read_captures, shot_path
from irodori.config.cross_checks.captures_on_rig import table_and_folder
from irodori.config.loaded import Loaded
from irodori.config.models import Chart, MirrorBallSource, Optics
from irodori.config.photograph_sets import PhotographSets
from irodori.core.errors import InputError, PlainError, is_file
from irodori.core.progress import track
from irodori.ingest.exposure_settings import filter_states, relative_exposure_s, settle_set
from irodori.ingest.first_look import first_looks
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.set_plausibility import FocalRange, SetLook
from irodori.lens.opencv import need_opencv
from irodori.spectra.published import chart_spectra

#: Level from which a superpixel clips, of the range; and the share of those that a photograph may have.
_CLIPPED, _FEW = 0.98, 1e-3
_SET_OF = {"cameras": "camera", "objects": "object", "environments": "environment"}


class PhotographSet(NamedTuple):
    """Set of photographs: its name, subject and camera, the paths of its table and files, and what files must match.

    ``kind`` is ``cameras``, ``objects``, ``environments`` or ``scenes``, ``subject`` the name of the definition.
    ``roles`` are the roles of its photographs in the table, ``size_px`` the size that the files must have, and
    ``lens_mm`` focal length and distance; None where the definition does not state them.
    """

    name: str
    kind: str
    subject: str
    camera: str
    table: Path
    folder: Path
    roles: tuple[str, ...]
    size_px: list[int] | None
    lens_mm: list[float] | None


class _Bright(NamedTuple):
    """Photograph of an exposure series, from which the longest exposure without clipping is chosen."""

    shot: Shot
    mosaic: Mosaic
    clips: bool

    @classmethod
    def of(cls, shot: Shot, mosaic: Mosaic) -> "_Bright":
        return cls(shot, mosaic, float((mosaic.largest >= _CLIPPED).mean()) > _FEW)

    def rank(self) -> tuple[bool, float]:
        """Return a sort key that is largest for the best photograph."""
        return not self.clips, -self.shot.exposure_s if self.clips else self.shot.exposure_s


class PhotographCheck:
    """Check of the photographs of a configuration.

    Parameters
    ----------
    loaded : Loaded
    decoded : callable (PhotographSet, Shot, path, Mosaic), optional
        Called with every photograph after it was decoded.
    optics : dict, optional
        Filled with the optics of each camera whose lens is measured from photographs of the printed sheet, by name of
        the camera, before the photographs of other roles are decoded.
    """

    def __init__(
        self,
        loaded: Loaded,
        decoded: Callable[[PhotographSet, Shot, Path, Mosaic], None] | None = None,
        optics: dict[str, Optics] | None = None,
    ) -> None:
        self._loaded, self._decoded = loaded, decoded
        self._optics = {} if optics is None else optics
        self._whites: dict[str, list] = {}
        #: Number of photographs checked so far.
        self.count = 0
        #: Where the patches of the charts lie, by name of set and of chart.
        self.located: dict[tuple[str, str], Located] = {}

    def findings(self) -> Iterator[Finding]:
        """Yield the errors and warnings of all existing photographs; photographs still to be taken are skipped."""
        for name in self._loaded.cameras:
            yield from self._of_sheets(name)
        for one in self._sets():
            yield from self._of_set(one)

    def _of_sheets(self, camera: str) -> Iterator[Finding]:
        """Measure the lens of a camera from the photographs of the role ``lens``, as `calibrate_lens` does."""
        sets = PhotographSets(self._loaded)
        asked = SimpleNamespace(camera=camera)
        typed = self._loaded.cameras[camera].optics
        try:
            files = sets.sheet(asked)
        except InputError:
            return  # the check of the camera's other photographs reports what is wrong with the table
        if not files or typed is None:
            return
        try:
            need_opencv("the role lens")
        except PlainError as error:
            yield Finding(True, str(error))
            return
        # OpenCV takes a third of a second to load.
        from irodori.lens.stage import SheetReader, check_size

        table, folder = Path(sets.table(asked)), Path(sets.folder(asked))
        one = PhotographSet(f"camera {camera}, lens", "cameras", camera, camera, table, folder, (LENS,), None, None)
        sheets = SheetReader(table, typed.pixel_pitch_um)
        for shot in track([shot for shot in read_captures(table, folder) if shot.role == LENS], f"look {one.name}"):
            path = shot_path(shot, table, folder)
            self.count += 1
            try:
                check_unchanged(table, folder, [shot])
                mosaic = decode(path, shot.linear)
                if self._decoded is not None:
                    self._decoded(one, shot, path, mosaic)
                sheets.add(path, mosaic)
            except InputError as error:
                yield Finding(True, str(error), path)
        for path, words in sheets.left_out:
            yield Finding(False, f"{path}: {words}", path)
        try:
            found = sheets.measure()
            check_size(found, typed, table)
            self._optics[camera] = Optics.of(found.optics)
        except PlainError as error:
            yield Finding(True, str(error))

    def _sets(self) -> Iterator[PhotographSet]:
        """Yield the existing sets, cameras first, because other sets are compared with their white references."""
        sets = PhotographSets(self._loaded)
        for kind, key in _SET_OF.items():
            for name, definition in getattr(self._loaded, kind).items():
                if definition.captures is None or self._loaded.is_virtual(kind, name):
                    continue
                asked = SimpleNamespace(**{key: name})
                if is_file(sets.table(asked)):  # a session that is still to come has none
                    where = Path(sets.table(asked)), Path(sets.folder(asked)), tuple(sets.roles(asked))
                    stated = sets.size_px(asked), sets.lens_mm(asked)
                    yield PhotographSet(f"{key} {name}", kind, name, sets.camera_of(asked), *where, *stated)
        for name, scene in self._loaded.scenes.items():
            for label, placed in scene.photographs.items():
                optics = self._loaded.cameras[placed.camera].optics
                if placed.captures is None or optics is None:
                    continue
                table, folder = table_and_folder(placed.captures, Path())
                lens = [optics.focal_length_mm, math.dist(placed.position_mm, placed.target_mm)]
                size = [optics.width_px, optics.height_px]
                yield PhotographSet(
                    f"{name}, {label}", "scenes", name, placed.camera, table, folder, ("scene",), size, lens
                )

    def _of_set(self, one: PhotographSet) -> Iterator[Finding]:
        try:
            shots = [shot for shot in read_captures(one.table, one.folder) if shot.role in one.roles]
        except InputError as error:
            yield Finding(True, str(error))
            return
        focal = FocalRange.of(*one.lens_mm) if one.lens_mm else None
        seen = SetLook(shots, focal, self._whites.get(one.camera, ()))
        settled: list[Shot] = []
        best: dict[str, _Bright] = {}
        around: list[tuple[Shot, Mosaic]] = []
        decoded = partial(self._decoded, one) if self._decoded is not None else None
        looks = first_looks(seen, one.table, one.folder, f"look {one.name}", size_px=one.size_px, decoded=decoded)
        for shot, path, mosaic, refused, warnings in looks:
            self.count += 1
            if mosaic is None:
                yield Finding(True, str(refused), path)
                continue
            settled.append(shot)
            for words in warnings:
                yield Finding(False, words, path)
            if shot.role == "environment":
                around.append((shot, mosaic))
            if shot.role in ("chart", "white") and shot.filter == "out":
                bright = _Bright.of(shot, mosaic)
                best[shot.subject] = max(bright, best.get(shot.subject, bright), key=_Bright.rank)
        try:
            settle_set(settled, one.table)
        except InputError as error:
            yield Finding(True, str(error))
        for doubted in seen.doubted():
            text = f"{doubted.path}: {doubted.doubt.kind}: {doubted.doubt.words}"
            yield Finding(doubted.doubt.is_certain, text, doubted.path)
        if around and len(around) == sum(shot.role == "environment" for shot in shots):
            yield from self._of_surroundings(one, around)
        if "chart" in one.roles:
            self._whites[one.camera] = seen.whites
            yield from self._of_charts(one, best)

    def _of_surroundings(self, one: PhotographSet, photographs: list[tuple[Shot, Mosaic]]) -> Iterator[Finding]:
        """Merge the exposures of a panorama or mirror ball; refuse saturation and a ball elsewhere, as a run does."""
        # Compiled loops, slow to load.
        from irodori.ingest.camera_reference import Reference
        from irodori.ingest.develop import Frame, merge_frames
        from irodori.ingest.ingest_options import IngestOptions
        from irodori.ingest.photon_transfer import PhotonTransfer
        from irodori.light.mirror_ball import outline_doubt, used_part
        from irodori.light.omnidirectional import refuse_saturated

        source = self._loaded.environments[one.subject].source
        unknown = Reference(None, {}, PhotonTransfer(), (0, 0), [], None)
        options = IngestOptions(saturation=self._loaded.config.ingest.saturation)
        shortest = min((shot for shot, _ in photographs), key=relative_exposure_s)
        path = shot_path(shortest, one.table, one.folder)
        by_state = []
        try:
            for state in filter_states(shot for shot, _ in photographs):
                frames = [Frame(shot, mosaic, None) for shot, mosaic in photographs if shot.filter == state]
                by_state.append(merge_frames(unknown, frames, options, None))
            saturated = np.logical_or.reduce([one.clipped for one in by_state])
            if isinstance(source, MirrorBallSource):
                saturated &= used_part(source, *saturated.shape)
            refuse_saturated(saturated, path)
            if isinstance(source, MirrorBallSource):
                response = np.concatenate([one.response for one in by_state], axis=-1)
                if doubt := outline_doubt(source, response, path):
                    yield Finding(False, f"{path}: {doubt}", path)
        except InputError as error:
            yield Finding(True, str(error), path)

    def _of_charts(self, one: PhotographSet, best: Mapping[str, _Bright]) -> Iterator[Finding]:
        """Locate and read the patches of every chart, divided by the white reference, as calibration does."""
        camera = self._loaded.cameras[one.camera]
        for name, chart in {"": camera.chart, **camera.further_charts}.items():
            photograph = best.get(chart_capture(name))
            if photograph is None:
                continue
            path = shot_path(photograph.shot, one.table, one.folder)
            try:
                whole = _whole_chart(path, chart, photograph, best.get("white"))
                if whole is not None:
                    self.located[one.name, name] = whole.located
                    read_chart(whole, chart_spectra(chart.spectra)[1], chart)
            except InputError as error:
                yield Finding(True, str(error), path)


def _whole_chart(path, chart: Chart, photograph: _Bright, white: _Bright | None) -> ChartPhotograph | None:
    """Return a photographed chart with its patches located; None if the number of its spectra does not fit."""
    names, _ = chart_spectra(chart.spectra)
    if len(names) != chart.rows * chart.columns:
        return None  # a fault of the definition, which the check of definitions reports
    response, valid = _rate(photograph)
    if white is not None and white.mosaic.size == photograph.mosaic.size:
        even, lit = _rate(white)
        valid &= lit & (even > 0.0).all(axis=2)
        response = np.where(valid[..., None], response / np.where(even > 0.0, even, 1.0), 0.0)
    located = locate_patches(response, valid, chart, path)
    light = illumination(response, valid, located, path, 2) if white is None else None
    return ChartPhotograph(path, response, valid, 2, 1.0, ("out",), None, located, light)


def _rate(photograph: _Bright) -> tuple[np.ndarray, np.ndarray]:
    """Return superpixels in full scales per second of relative exposure, and a mask of those that are not clipped."""
    mosaic = photograph.mosaic
    rate = mosaic.superpixels / np.float32(mosaic.full_scale * relative_exposure_s(photograph.shot))
    return rate, mosaic.largest < _CLIPPED
