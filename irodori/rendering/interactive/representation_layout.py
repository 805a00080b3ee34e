"""Compile-time layout of a colour representation: vector widths and omitted terms."""

from dataclasses import dataclass

from llvmlite import ir
from numba import types
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

from irodori.jit.vectors import Vector, constant


@dataclass(frozen=True)
class Layout:
    """Compile-time constants of a kernel; the kernel is compiled for each combination.

    Parameters
    ----------
    surface : int
        Lanes of a texel: the channels of the reflected colour, then the power and the roughness coordinate of the first
        gloss component.
    light : int
        Lanes of the environment's stored light.
    coloured : bool
        Whether a path's throughput differs between channels. If not, light is summed in its stored form and converted
        to a colour once per pixel.
    components : int
        Gloss components of a texel, at most 5.
    parts : int
        Largest number of rows of round lobes per component, see `irodori.rendering.interactive.round_lobes`.
    sheets : bool
        Whether any object is a thin sheet; kernels for other scenes have no code for them.
    coats : bool
        Whether any object has a coupled coat; kernels for other scenes have no code for them.
    """

    surface: int
    light: int
    coloured: bool
    components: int = 1
    parts: int = 1
    sheets: bool = False
    coats: bool = False

    @property
    def seen(self) -> int:
        """Numbers that gloss sees in one direction: the share of free directions, then the light of other objects.

        That light has three numbers (XYZ) if it is only added to pixels, else coefficients of a basis of spectra.
        """
        return 8 if self.coloured else 4


class _LayoutType(types.Type):
    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        super().__init__(name=repr(layout))


@typeof_impl.register(Layout)
def _typeof(value, context):
    return _LayoutType(value)


@register_model(_LayoutType)
class _LayoutModel(models.OpaqueModel):
    pass


@unbox(_LayoutType)
def _unbox(kind, value, c):
    return NativeValue(c.context.get_dummy_value())


def _constant(field: str):
    def typed(typingctx, layout):
        value = getattr(layout.layout, field)
        kind = types.boolean if isinstance(value, bool) else types.int64

        def codegen(context, builder, sig, args):
            return ir.Constant(context.get_value_type(kind), int(value))

        return kind(layout), codegen

    return intrinsic(typed)


def _black(field: str, times: int = 1):
    def typed(typingctx, layout):
        kind = Vector(types.float32, times * getattr(layout.layout, field))

        def codegen(context, builder, sig, args):
            return constant(kind, 0.0)

        return kind(layout), codegen

    return intrinsic(typed)


surface_lanes, light_lanes = _constant("surface"), _constant("light")
is_coloured = _constant("coloured")
has_sheets, has_coats = _constant("sheets"), _constant("coats")
gloss_components, gloss_parts, seen_lanes = _constant("components"), _constant("parts"), _constant("seen")
#: Vectors of zeros: of a texel's lanes, of the light's, of light at two levels, and of what gloss sees in
#: four cells.
surface_black, light_black, pair_black = _black("surface"), _black("light"), _black("light", 2)
seen_cells_black = _black("seen", 4)
