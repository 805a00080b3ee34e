"""Virtual camera: photographs the virtual bench into DNG files."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np

from irodori.capture.rig.devices import CameraDevice, DeviceError
from irodori.config.capture_table import FILTERS, Pose, Shot, chart_capture, room_chart_capture
from irodori.config.models import Camera, Chart, EnvironmentDefinition, Object, Rig, VirtualRoom
from irodori.config.parts import AnyCamera, PhotographedObject, SceneRadiance
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.classroom import light_on_chart, room_coefficients
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.imperfections import Faults, lamp_light
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.scene_view import scene_mosaic, scene_radiance
from irodori.simulation.virtual_rig.sensor import Sensor, band_weights
from irodori.simulation.virtual_rig.subjects import (
    chart_mosaic,
    object_mosaic,
    room_chart_mosaic,
    room_mosaic,
    white_mosaic,
)

Photographed: TypeAlias = Object | PhotographedObject | EnvironmentDefinition | SceneRadiance


class VirtualCamera(CameraDevice):
    """Camera device that computes photographs of the virtual bench, after a camera definition's block ``virtual``.

    Parameters
    ----------
    camera : Camera or PhotographingCamera
    rig : Rig
        Definitions.
    bench : Bench
        True state of the rig. The camera photographs this state, not the one that the shot asks for.
    session : str
        Name of the subject.
    shots : sequence of Shot
        All photographs of the session in order, along which the light drifts.
    subject : Object, PhotographedObject, EnvironmentDefinition or SceneRadiance, optional
        Definition of the subject; none for the session of a camera's reference photographs.
    """

    suffix = ".dng"
    is_virtual = True
    model = "virtual camera"

    def __init__(
        self,
        camera: AnyCamera,
        rig: Rig,
        bench: Bench,
        session: str,
        shots: Sequence[Shot],
        subject: Photographed | None = None,
    ) -> None:
        if camera.virtual is None or rig.virtual is None or camera.optics is None:
            raise ValueError(
                "a camera without the blocks virtual and optics, or a rig without virtual; accepted: with them"
            )
        self.camera, self.rig, self.bench, self.subject = camera, rig, bench, subject
        self.optics = camera.optics
        self.sensor = Sensor(**vars(camera.virtual.sensor))
        self.light = lamp_light(rig)
        self.band_weights = band_weights(camera, self.light)
        self.faults = Faults(rig.virtual.imperfections, rig.virtual.seed, session, shots)

    @cached_property
    def sample(self) -> Sample:
        """Sample of the object on the table."""
        if not isinstance(self.subject, Object | PhotographedObject):
            raise DeviceError("nothing stands on the table; accepted: a session of an object")
        return Sample.from_definition(self.subject)

    @cached_property
    def _scene(self) -> np.ndarray:
        """Radiance of the scene in front of the lens, (rows, columns, 61)."""
        if not isinstance(self.subject, SceneRadiance):
            raise DeviceError("nothing is known of a scene; accepted: a session that photographs one")
        return scene_radiance(self.subject.radiance, self.optics)

    @cached_property
    def _room(self) -> tuple[VirtualRoom, np.ndarray]:
        """The virtual room, and the share of each of its sources in every pixel of its panorama."""
        subject = self.subject
        if not isinstance(subject, EnvironmentDefinition) or subject.image is None or subject.virtual is None:
            raise DeviceError(
                "an environment without the blocks image and virtual; accepted: a room of the virtual rig"
            )
        return subject.virtual, room_coefficients(subject.virtual, subject.image.width, subject.image.height)

    @property
    def _charts(self) -> dict[str, Chart]:
        """Definition of every chart, by the subject's name on the bench; none outside a camera's own session."""
        if not isinstance(self.camera, Camera):
            return {}
        further = {chart_capture(name): chart for name, chart in self.camera.further_charts.items()}
        return {"chart": self.camera.chart, **further}

    @cached_property
    def _room_charts(self) -> dict[str, tuple[Chart, np.ndarray]]:
        """Every chart in the room by the subject's name on the bench, and the light on it, relative to the rig's."""
        subject = self.subject
        if not isinstance(subject, EnvironmentDefinition) or subject.virtual is None:
            return {}
        room = subject.virtual
        return {
            room_chart_capture(name): (chart, light_on_chart(room, room.charts[name], self.light) / self.light)
            for name, chart in subject.room_charts.items()
        }

    @cached_property
    def _hot_rate_e_per_s(self) -> np.ndarray:
        optics = self.optics
        return self.faults.hot_rate_e_per_s(optics.height_px, optics.width_px)

    def capture(self, shot: Shot, path: Path) -> None:
        """Photograph the bench into a file; the shot determines the exposure time and the place in the session."""
        write_dng(
            path,
            self._exposed(shot),
            black_level=self.sensor.black_level,
            white_level=self.sensor.white_level,
            exposure_s=shot.exposure_s,
            model=self.model,
            iso=shot.iso,
            f_number=shot.f_number,
        )

    def _exposed(self, shot: Shot) -> np.ndarray:
        """Return the numbers of the mosaic, (height, width)."""
        response, hot_rate = self._seen(shot)
        light = self.faults.light(shot) * response
        return self.sensor.expose(light, shot.exposure_s, self.faults.noise(shot), hot_rate)

    def _seen(self, shot: Shot):
        """Return the mosaic's responses after the optics, and the extra dark current of hot pixels, electrons/s."""
        subject = self.bench.subject
        state = FILTERS.index(self.bench.filter)
        weights = self.band_weights[3 * state : 3 * state + 3]
        if subject == "environment" and isinstance(self.subject, EnvironmentDefinition):
            # A panorama is stitched or unwrapped: vignetting and hot pixels are corrected there.
            room, coefficients = self._room
            return room_mosaic(room, coefficients, self.light, weights), 0.0
        optics = self.optics
        height, width = optics.height_px, optics.width_px
        if subject == "dark":
            return np.zeros((height, width)), self._hot_rate_e_per_s
        pose = self.faults.real_pose(shot, self.bench.pose())
        plate = self.faults.ideal_from_seen(shot, width, height)
        if subject == "white" and isinstance(self.camera, Camera):
            response = white_mosaic(self.camera, self.rig, pose, plate, weights)
        elif subject in self._charts:
            response = chart_mosaic(self._charts[subject], self.camera, self.rig, pose, plate, weights)
        elif subject in self._room_charts:
            chart, light = self._room_charts[subject]
            response = room_chart_mosaic(chart, light, self.camera, self.rig, plate, weights)
        elif subject == "scene":
            response = scene_mosaic(self._scene, self.light, optics, plate, weights)
        elif subject == "object":
            response = self._object(pose, plate, weights)
        else:
            raise DeviceError(f"nothing known of the subject {subject!r}; accepted: what a session photographs")
        return self.faults.through_optics(response), self._hot_rate_e_per_s

    def _object(self, pose: Pose, plate: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the mosaic of the object in a pose, for the map of the filter plate and the weights of the bands."""
        assert isinstance(self.subject, Object | PhotographedObject)  # as `sample` has seen
        subject = self.subject
        return object_mosaic(
            self.sample,
            self.camera,
            self.rig,
            pose,
            plate,
            weights,
            patch=subject.level_patch,
            markers=subject.markers,
            placements=subject.placements,
        )

    def status(self) -> dict[str, str]:
        """Return the camera's model, battery, storage and bit depth as text."""
        bits = str(self.sensor.bits)
        return {"model": self.model, "battery": "100 %", "storage": "unlimited", "bits": bits}

    def close(self) -> None:
        """Do nothing, because a virtual camera holds no resources."""
