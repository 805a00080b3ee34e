"""Refusal of scenes with materials that reflect more light than falls on them."""

from collections.abc import Sequence

from irodori.config.models import Body, Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.shapes.shape import Shape
from irodori.material.energy import Energy, energy_of
from irodori.material.material_file import Material
from irodori.rendering.integrators import body_material, with_backs
from irodori.rendering.scene_arrays import as_back

_KEY = "allow_energy_gain"


def load_materials(scene: Scene, shapes: Sequence[Shape], files: Sequence) -> list[Material]:
    """Load and check the materials of a scene's objects; arguments and errors as in `refuse_energy_gain`."""
    materials = with_backs(scene, [Material.load(path) for path in files])
    refuse_energy_gain(scene, shapes, files, materials)
    return materials


def refuse_energy_gain(scene: Scene, shapes: Sequence[Shape], files: Sequence, materials: Sequence[Material]) -> None:
    """Raise an error if a material's albedo exceeds 1 by more than its error, unless the scene allows that.

    Parameters
    ----------
    scene : Scene
    shapes : sequence of Shape
        Shapes of the scene's objects.
    files : sequence of path
        Files of the objects' materials, in the order of the scene, then those of the backs that it gives.
    materials : sequence of Material
        Materials loaded from these files, with their backs.

    Raises
    ------
    InputError
        The message names the object, the share of its texels and the largest albedo.
    """
    known: dict[tuple[str, str], Energy] = {}
    named = [(item.object, path, m) for item, path, m in zip(scene.objects, files, materials, strict=False)]
    turned = [one for one in zip(scene.objects, materials, shapes, strict=True) if one[0].back is not None]
    for (item, material, shape), path in zip(turned, files[len(materials) :], strict=True):
        named.append((f"{item.back} as the back of {item.object}", path, as_back(material, shape)))
    for name, path, material in named:
        if (name, str(path)) in known:
            continue
        with store.open_file(path) as file:
            error = file.read("albedo_error") if "albedo_error" in file else None
        energy = known[name, str(path)] = energy_of(material, error)
        if energy.gains:
            _refuse(scene, InputError(path, "albedo", *_words(name, energy)))
        elif energy.rim_fraction > 0.0:
            text = "%s: %.1f %% of texels send back up to %.2f times the light at grazing angles (%.0f degrees)"
            LOGGER.info(text, name, 100 * energy.rim_fraction, energy.rim_max, energy.rim_deg)
    for index, body in enumerate(scene.bodies):
        fault = body_fault(index, body)
        if fault is not None:
            _refuse(scene, InputError("scene", *fault))


def body_fault(index: int, body: Body) -> tuple[str, str, str] | None:
    """Return field, fault and accepted values of a body that reflects more light than it receives, else None."""
    material = body_material(body)
    sides = {"material": material}
    if body.back is not None:
        sides["back"] = as_back(material, Shape.from_definition(body.shape))
    for key, side in sides.items():
        if (energy := energy_of(side)).gains:
            return f"bodies[{index}].{key}", *_words("a body", energy)
    return None


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
