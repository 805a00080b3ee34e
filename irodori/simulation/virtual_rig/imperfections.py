"""Switchable imperfections of the virtual rig: lamp, optics, poses, filter plate, sensor.

All random numbers depend only on the seed and on the place of a photograph in its session, never on the photographs
taken before. A session that was interrupted and continued therefore gives the same files as one that was not.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from irodori.config.capture_table import Pose, Shot
from irodori.config.models import Imperfections, Rig
from irodori.simulation.virtual_rig.classroom import equal_luminance
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import light

_C2_NM_PER_MIRED = 14.38777  # second radiation constant of Planck's law


def lamp_light(rig: Rig) -> np.ndarray:
    """Return the spectrum of the light of a virtual rig's lamp, (61,), of the luminance of the one in its definition.

    Another temperature changes it as an ideal conversion filter would, in Wien's approximation of Planck's law.
    """
    stated = light(rig.light.spectrum)
    if rig.virtual is None or not rig.virtual.imperfections.lamp_spectrum.enabled:
        return stated
    shift_mired = rig.virtual.imperfections.lamp_spectrum.shift_mired
    return equal_luminance(stated * np.exp(-_C2_NM_PER_MIRED * shift_mired / WAVELENGTH_NM), stated)


@dataclass(frozen=True)
class SessionPlace:
    """Place of a photograph in its session: its number, and the number of moves and filter changes before it."""

    number: int
    arrival: int
    insertion: int


def places(shots: Sequence[Shot]) -> dict[str, SessionPlace]:
    """Return the place of every photograph in a session: file name -> place."""
    found, arrival, insertion, before = {}, 0, 0, None
    for number, shot in enumerate(shots):
        if before is not None:
            arrival += (shot.pose, shot.subject) != (before.pose, before.subject)
            insertion += shot.filter != before.filter
        found[shot.file] = SessionPlace(number, arrival, insertion)
        before = shot
    return found


class Faults:
    """Values of the imperfections for every photograph of one session.

    Parameters
    ----------
    definition : Imperfections
    seed : int
        Seed of the rig.
    session : str
        Name of the subject; sessions with different names have different random numbers.
    shots : sequence of Shot
        All photographs of the session, in order.
    """

    def __init__(self, definition: Imperfections, seed: int, session: str, shots: Sequence[Shot]) -> None:
        self._definition, self._seed, self._session = definition, seed, session
        self._places = places(shots)
        self._light = self._drift(len(shots))

    def _value(self, name: str, key: str, off: float = 0.0):
        fault = getattr(self._definition, name)
        return getattr(fault, key) if fault.enabled else off

    def _rng(self, *key) -> np.random.Generator:
        text = "/".join(map(str, (self._session, *key)))
        return np.random.default_rng([self._seed, zlib.crc32(text.encode())])

    def _drift(self, count: int) -> np.ndarray:
        """Return the light's relative power at each photograph: a first-order autoregressive process with mean 1."""
        rms = self._value("light_drift", "relative_rms")
        memory = math.exp(-1.0 / self._definition.light_drift.correlation_shots)
        noise = self._rng("light").normal(size=count)
        light, level = np.ones(count), 0.0
        for i in range(count):
            level = noise[i] if i == 0 else memory * level + math.sqrt(1.0 - memory**2) * noise[i]
            light[i] = 1.0 + rms * level
        return light

    def light(self, shot: Shot) -> float:
        """Return the relative power of the lamp during a photograph."""
        return float(self._light[self._places[shot.file].number])

    def noise(self, shot: Shot) -> np.random.Generator:
        """Return the random generator of a photograph's shot noise and read noise."""
        return self._rng("noise", shot.file)

    def real_pose(self, shot: Shot, pose: Pose) -> Pose:
        """Return the true pose of the rig for a nominal one; photographs without a move between them have the same."""
        rms = self._value("pose_error", "rms_deg")
        light, camera = self._rng("pose", self._places[shot.file].arrival).normal(size=2) * rms
        return replace(pose, light_deg=pose.light_deg + light, camera_deg=pose.camera_deg + camera)

    def through_optics(self, response: np.ndarray) -> np.ndarray:
        """Return a mosaic with vignetting and stray light added, (height, width)."""
        height, width = response.shape
        loss, stray = self._value("vignetting", "corner_loss"), self._value("stray_light", "fraction")
        y, x = np.ogrid[:height, :width]
        radius2 = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / ((width**2 + height**2) / 4)
        seen = response * (1.0 - loss * radius2)
        # The four positions of the mosaic have different colours: stray light keeps the mean colour of the picture.
        for row in (0, 1):
            for column in (0, 1):
                seen[row::2, column::2] += stray * response[row::2, column::2].mean()
        return seen

    def ideal_from_seen(self, shot: Shot, width_px: int, height_px: int) -> np.ndarray:
        """Return the map from a picture through the filter plate, which shifts and turns it, to a picture without it.

        Returns
        -------
        (2, 3) float64, affine map of mosaic coordinates; the identity if the filter is out
        """
        if shot.filter == "out" or not self._definition.filter_plate.enabled:
            return np.eye(2, 3)
        plate = self._definition.filter_plate
        repeat = self._rng("plate", self._places[shot.file].insertion).normal(size=2) * plate.repeat_rms_px
        centre = np.array([width_px / 2, height_px / 2])
        # The plate's shift is given in superpixels of two mosaic pixels.
        shift = 2.0 * (np.array(plate.shift_px) + repeat)
        angle, scale = math.radians(plate.rotation_deg), plate.magnification
        c, s = math.cos(angle) / scale, math.sin(angle) / scale
        turn = np.array([[c, s], [-s, c]])
        return np.column_stack([turn, centre - turn @ (centre + shift)])

    def hot_rate_e_per_s(self, height_px: int, width_px: int) -> np.ndarray:
        """Return the extra dark current of each mosaic pixel, electrons/s; it is the same in all sessions of a rig."""
        fraction = self._value("hot_pixels", "fraction")
        rng = np.random.default_rng([self._seed, zlib.crc32(b"hot pixels")])
        hot = rng.random((height_px, width_px)) < fraction
        rate = rng.exponential(self._definition.hot_pixels.mean_rate_e_per_s, size=(height_px, width_px))
        return np.where(hot, rate, 0.0)
