"""The lobes of an object's gloss, and what of the fit's settings two of them leave no choice of."""

from irodori.config.models import Fit, Object
from irodori.config.validation import suggest
from irodori.core.errors import InputError

#: Settings of the fit that an object with two lobes must leave as they are.
SETTINGS_WITH_TWO_LOBES = {"solver": "varpro", "refractive_index": "fixed", "pooling_radius_texels": 0, "huber": None}


def check_lobes(definition: Object, fit: Fit, file) -> None:
    """Refuse lobes that are not registered, and settings of the fit that do not go with two.

    Raises
    ------
    InputError
    """
    lobes = definition.lobes
    if lobes == Object.lobes:  # the default, which is registered
        return
    from irodori.reflection.registry import names  # with the compiler behind it, which most configurations do not need

    for place, name in enumerate(lobes):
        if name not in names():
            raise InputError(file, f"lobes[{place}]", repr(name), suggest(name, names(), "lobes"))
    if len(lobes) == 1:
        return
    for key, accepted in SETTINGS_WITH_TWO_LOBES.items():
        found = getattr(fit, key)
        if found != accepted:
            stated = "null" if accepted is None else accepted
            raise InputError(file, "lobes", f"two lobes with fit.{key}: {found}", f"one lobe, or fit.{key}: {stated}")
