"""Checks of an object's lobes and coat, of its virtual materials, and of settings that exclude some of them."""

from irodori.config.models import Fit, ModelledMaterial, Object
from irodori.config.validation import suggest
from irodori.core.errors import InputError

#: Value in place of lobes: the lobes that predict left-out photographs best are chosen.
AUTO = "auto"
#: Values that settings of the fit must have for an object with two lobes.
SETTINGS_WITH_TWO_LOBES = {"solver": "varpro"}


def check_lobes(definition: Object, fit: Fit, file) -> None:
    """Refuse lobes that are not registered, and settings of the fit that are incompatible with two lobes.

    Raises
    ------
    InputError
    """
    _check_names(definition, file)
    if len(definition.lobes) == 1:
        return
    if AUTO in definition.lobes:
        raise InputError(file, "lobes", f"{AUTO} beside a lobe", f"{AUTO} alone, or one or two lobes")
    for key, accepted in SETTINGS_WITH_TWO_LOBES.items():
        found = getattr(fit, key)
        if found != accepted:
            raise InputError(file, "lobes", f"two lobes with fit.{key}: {found}", f"one lobe, or fit.{key}: {accepted}")


def check_coat(definition: Object, file) -> None:
    """Refuse the coat of a thin sheet, whose transmitted light it would reduce too."""
    if definition.coat != Object.coat and definition.sheet is not None:
        raise InputError(file, "coat", f"{definition.coat} of a thin sheet", f"{Object.coat} of a sheet")


def _check_names(definition: Object, file) -> None:
    named = {f"lobes[{place}]": name for place, name in enumerate(definition.lobes) if name != AUTO}
    for m, material in enumerate(definition.virtual.materials if definition.virtual else ()):
        if isinstance(material, ModelledMaterial):
            named[f"virtual.materials[{m}].lobe"] = material.lobe
            for c, further in enumerate(material.further_gloss):
                named[f"virtual.materials[{m}].further_gloss[{c}].lobe"] = further.lobe
    if set(named.values()) <= {ModelledMaterial.lobe}:  # the default, which is registered
        return
    from irodori.reflection.registry import names  # imports the compiler, which most configurations do not need

    for place, name in named.items():
        if name not in names():
            raise InputError(
                file,
                place,
                repr(name),
                suggest(name, (*names(), AUTO) if place.startswith("lobes") else names(), "lobes"),
            )
