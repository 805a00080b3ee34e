"""Error estimates of a measured object that need no ground truth."""

from dataclasses import dataclass, replace

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.config.models import Fit
from irodori.core import store
from irodori.geometry.shapes.shape import Shape
from irodori.material.angle_errors import errors_in_use, registered_errors
from irodori.material.fitted_tiles import FittedTiles
from irodori.material.material_file import Material, gloss_maps
from irodori.material.observed_angles import read_angles

_LIGHT = "D65"
#: Variance of the footprint of a sample along an axis, in squared sample widths: a sample averages evenly over its
#: width. The cubic interpolation of rectification adds none.
_SAMPLE_VARIANCE = 1.0 / 12.0
_GREEN = 1
#: Steps of Van Cittert's iteration, and standard deviations after which the blur kernel is cut off.
_STEPS, _REACH = 12, 4.0


def colours(material: Material) -> tuple[np.ndarray, np.ndarray]:
    """Return the diffuse reflectance α S / S_G as coefficients, (height, width, k), and a basis, (61, k)."""
    return material.coefficients * material.spectrum_scale[..., None], material.basis


def with_colours(material: Material, parts: list[tuple[np.ndarray, np.ndarray]]) -> Material:
    """Return a copy of a material whose diffuse reflectance is a sum of given spectra.

    Parameters
    ----------
    material : Material
    parts : list of (coefficients, basis)
        The terms of the sum: coefficients that can be broadcast to (height, width, k), and a basis (61, k).
    """
    one = np.ones(material.alpha.shape)
    coefficients = np.concatenate([np.broadcast_to(c, (*one.shape, c.shape[-1])) for c, _ in parts], axis=-1)
    basis = np.concatenate([b for _, b in parts], axis=1)
    return replace(material, alpha=one, green_response=one, coefficients=coefficients.astype(np.float32), basis=basis)


@dataclass(frozen=True)
class Photographs:
    """Weights with which each of J photographs enters the diffuse responses of the texels.

    Parameters
    ----------
    share : (height, width, J) float
        Sums to 1 in a texel with data, 0 elsewhere.
    tangent : (height, width, J) float
        tan θ_i: the relative change of cos θ_i by a radian.
    stretch : float
        Mean of (1 + 1/cos²θ_r) / 2: factor by which the camera's slant increases the variance of a sample's footprint.
    """

    share: np.ndarray
    tangent: np.ndarray
    stretch: float

    @classmethod
    def load(cls, tiles: list, response: np.ndarray, model_error: float) -> "Photographs":
        """Read the observations of an object and compute the weights of its photographs.

        Parameters
        ----------
        tiles : list of path
            Files of observations.
        response : (height, width) float
            Green diffuse response of the fit; NaN where there is none.
        model_error : float
            Relative error that the fit assumes for the light of a photograph.
        """
        parts = []
        for path in tiles:
            with store.open_file(path) as file:
                first, last = file.attribute("rows")
                maps = [file.read("weight"), read_angles(file), file.read("noise_model")]
            parts.append((first, last, *maps))
        shares, tangents, weights, slants = [], [], 0.0, 0.0
        for first, last, weight, geometry, noise in sorted(parts, key=lambda part: part[0]):
            diffuse = response[first:last].reshape(-1)
            used = (weight > 0.0) & np.isfinite(diffuse)[:, None]
            cosine = np.where(used, np.cos(geometry[..., 0]), 1.0)
            share = np.where(used, weight * cosine**2 / _variance(diffuse, cosine, noise[:, _GREEN], model_error), 0.0)
            total = share.sum(axis=1, keepdims=True)
            share = np.divide(share, total, out=np.zeros_like(share), where=total > 0.0)
            weights += share.sum()
            slants += (share / np.where(used, np.cos(geometry[..., 1]), 1.0) ** 2).sum()
            size = last - first, response.shape[1], weight.shape[1]
            shares.append(share.reshape(size))
            tangents.append(np.where(used, np.tan(geometry[..., 0]), 0.0).reshape(size))
        stretch = 0.5 * (1.0 + slants / weights) if weights > 0.0 else 1.0
        return cls(np.concatenate(shares), np.concatenate(tangents), float(stretch))

    def gains(self, model_error: float, pose_error_rad: float, rng: np.random.Generator) -> np.ndarray:
        """Draw random relative changes of the responses of all texels, (height, width), with a mean of zero.

        Each photograph gets one random error of its light and one of its pose, the same in all texels. The mean over
        the observed texels is subtracted, because it is an error of the object's scale and not scatter.
        """
        light, pose = rng.standard_normal((2, self.share.shape[-1]))
        change = self.share @ (model_error * light) + (self.share * self.tangent) @ (pose_error_rad * pose)
        seen = self.share.any(axis=-1)
        return np.where(seen, change - change[seen].mean(), 0.0) if seen.any() else change


def _variance(diffuse, cosine, noise, model_error: float) -> np.ndarray:
    """Return the variance that the fit expects for each green response, (texels, J); 1 where it is unknown."""
    expected = np.where(np.isfinite(diffuse), diffuse, 0.0)[:, None] * cosine
    found = noise[:, 0] + noise[:, 1] * np.maximum(expected, 0.0) + (model_error * expected) ** 2
    return np.where(found > 0.0, found, 1.0)


@dataclass(frozen=True)
class Spread:
    """Blur of a texture due to the limited resolution of the photographs.

    Parameters
    ----------
    rows, columns : float
        Standard deviation of the blur along each axis, texels.
    border : str
        Surroundings of the texture: ``joined`` (the last column continues in the first, rows end at the poles),
        ``black`` or ``unknown``.
    """

    rows: float
    columns: float
    border: str

    @classmethod
    def of(cls, shape: Shape, size: tuple[int, int], sample_mm: float, stretch: float) -> "Spread":
        """Compute the blur from the size of a sample on the object and the slant of the camera.

        Parameters
        ----------
        shape : Shape
        size : (2,) int
            Height and width of the texture, texels.
        sample_mm : float
            Side of a sample of the photographs on the object.
        stretch : float
            Increase of the variance by the slant, see `Photographs`.
        """
        atlas = shape.atlas(size[1], size[0])
        position = np.where(atlas.covered[..., None], atlas.position, np.nan)
        sides = [np.nanmedian(np.linalg.norm(np.diff(position, axis=axis), axis=-1)) for axis in (0, 1)]
        deviation = sample_mm * np.sqrt(_SAMPLE_VARIANCE * stretch)
        return cls(float(deviation / sides[0]), float(deviation / sides[1]), shape.border)

    def blurred(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Blur a texture, (height, width, k), with weighted means over known texels; zero at unknown texels.

        ``known`` is (height, width) bool.
        """
        top, bottom = values * known[..., None], known[..., None].astype(np.float64)
        joined = self.border == "joined"
        beyond = float(self.border == "black")  # values outside the object are known to be zero
        for axis, deviation in enumerate((self.rows, self.columns)):
            mode = ("nearest", "wrap")[axis] if joined else "constant"
            top = _blurred_along(top, axis, deviation, mode=mode)
            bottom = _blurred_along(bottom, axis, deviation, mode=mode, cval=beyond)
        return np.where(known[..., None], np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0.0), 0.0)

    def undone(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Deblur a texture, (height, width, k), by Van Cittert's iteration; unknown texels keep their values."""
        found = values.copy()
        for _ in range(_STEPS):
            found += np.where(known[..., None], values - self.blurred(found, known), 0.0)
        return found


def _blurred_along(values: np.ndarray, axis: int, deviation: float, **beyond) -> np.ndarray:
    """Convolve along an axis with a Gaussian integrated over each texel; ``deviation`` in texels."""
    from scipy import ndimage, special  # slow to import

    reach = int(np.ceil(_REACH * deviation + 0.5))
    edges = (np.arange(-reach, reach + 2) - 0.5) / max(deviation, 1e-9)
    weights = np.diff(special.ndtr(edges))
    return ndimage.convolve1d(values, weights / weights.sum(), axis=axis, **beyond)


@dataclass(frozen=True)
class Known:
    """The measured material of an object, with the error estimates of the stages.

    Parameters
    ----------
    material : Material
    gloss_error : (height, width, 2 components) float
        Standard errors of β and of μ (rad) for each gloss component; NaN where the fit states none.
    response, variance : (height, width, bands) float
        Diffuse responses and their variance by the camera's noise; NaN where there are none.
    calibration : Calibration
    left_out : float
        Mean CIEDE2000 of the chart's patches, each left out of the calibration in turn.
    photographs : Photographs
    spread : Spread
    model_error : float
        Relative standard deviation that the fit assumes for the light of a photograph.
    pose_error_rad : float
        Standard deviation that the fit assumes for the angle of incidence.
    covered : (height, width) bool
        Texels that lie on the surface.
    """

    material: Material
    gloss_error: np.ndarray
    response: np.ndarray
    variance: np.ndarray
    calibration: Calibration
    left_out: float
    photographs: Photographs
    spread: Spread
    model_error: float
    pose_error_rad: float
    covered: np.ndarray

    @classmethod
    def load(cls, files: dict, shape: Shape, sample_mm: float, fit: Fit) -> "Known":
        """Read the files of an object.

        Parameters
        ----------
        files : dict
            ``material``, ``calibration`` and lists of ``tiles`` and ``observations``.
        shape : Shape
        sample_mm : float
            Side of a sample of the photographs on the object.
        fit : Fit
            The key ``fit`` of the configuration.
        """
        own = Material.load(files["material"])
        fitted = FittedTiles(files["tiles"], *own.alpha.shape)
        with store.open_file(files["material"]) as file:
            fitted.misfit = file.attribute("errors", dict).get("lobe_choice_misfit", 1.0)
        of_gloss = [f"{name}_error" for name in gloss_maps(own.lobes)]
        parts = [maps for _, maps in fitted.read("diffuse_response", "diffuse_variance", *of_gloss)]
        maps = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        with store.open_file(files["calibration"]) as file:
            left_out = float(file.read(f"leave_one_out/delta_e_{_LIGHT.lower()}").mean())
        photographs = Photographs.load(files["observations"], maps["diffuse_response"][..., _GREEN], fit.model_error)
        angles = errors_in_use(fit.pose_error_deg, registered_errors(files["observations"][0]))
        return cls(
            material=own,
            gloss_error=np.stack([maps[name] for name in of_gloss], axis=-1),
            response=maps["diffuse_response"],
            variance=maps["diffuse_variance"],
            calibration=Calibration.load(files["calibration"]),
            left_out=left_out,
            photographs=photographs,
            spread=Spread.of(shape, own.alpha.shape, sample_mm, photographs.stretch),
            model_error=fit.model_error,
            pose_error_rad=float(np.radians(angles.theta_i_deg)),
            covered=shape.is_covered(*own.alpha.shape[::-1]),
        )

    def estimate(self) -> Material:
        """Return the measured material as it is rendered, with colours and gloss filled in at texels without data."""
        return self.material.filled(self.covered)[0]
