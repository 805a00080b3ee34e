"""Refusal of scenes with materials that reflect more light than falls on them."""

from collections.abc import Sequence

from irodori.config.models import Body, Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.material.energy import Energy, energy_of
from irodori.material.material_file import Material
from irodori.rendering.integrators import body_material

_KEY = "allow_energy_gain"


def load_materials(scene: Scene, files: Sequence) -> list[Material]:
    """Load and check the materials of a scene's objects; arguments and errors as in `refuse_energy_gain`."""
    materials = [Material.load(path) for path in files]
    refuse_energy_gain(scene, files, materials)
    return materials


def refuse_energy_gain(scene: Scene, files: Sequence, materials: Sequence[Material]) -> None:
    """Raise an error if a material's albedo exceeds 1 by more than its error, unless the scene allows that.

    Parameters
    ----------
    scene : Scene
    files : sequence of path
        Files of the objects' materials, in the order of the scene.
    materials : sequence of Material
        Materials loaded from these files.

    Raises
    ------
    InputError
        The message names the object, the share of its texels and the largest albedo.
    """
    known: dict[str, Energy] = {}
    for item, path, material in zip(scene.objects, files, materials, strict=True):
        if str(path) in known:
            continue
        with store.open_file(path) as file:
            error = file.read("albedo_error") if "albedo_error" in file else None
        energy = known[str(path)] = energy_of(material, error)
        if energy.gains:
            _refuse(scene, InputError(path, "albedo", *_words(item.object, energy)))
        elif energy.rim_fraction > 0.0:
            text = "%s: %.1f %% of texels send back up to %.2f times the light at grazing angles (%.0f degrees)"
            LOGGER.info(text, item.object, 100 * energy.rim_fraction, energy.rim_max, energy.rim_deg)
    for index, body in enumerate(scene.bodies):
        fault = body_fault(index, body)
        if fault is not None:
            _refuse(scene, InputError("scene", *fault))


def body_fault(index: int, body: Body) -> tuple[str, str, str] | None:
    """Return field, fault and accepted values of a body that reflects more light than it receives, else None."""
    energy = energy_of(body_material(body))
    return (f"bodies[{index}].material", *_words("a body", energy)) if energy.gains else None


def _words(name: str, energy: Energy) -> tuple[str, str]:
    share, largest = 100 * energy.certain_fraction, energy.certain_max
    found = (
        f"{name} that sends back up to {largest:.3g} times the light that reaches it, on {share:.3g} % of its texels"
    )
    return found, f"at most 1, within its error, or {_KEY}: true in the scene"


def _refuse(scene: Scene, error: InputError) -> None:
    if not scene.allow_energy_gain:
        raise error
    LOGGER.warning("%s: found %s; %s is set", error.field, error.found, _KEY)
