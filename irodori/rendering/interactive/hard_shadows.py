"""Hard shadows of collimated lights for a packet of hits."""

import numpy as np
from numba import types

from irodori.geometry.shapes.shape_rows import SHAPE, THROUGH
from irodori.jit.c_functions import c_function
from irodori.jit.compilation import uncounted
from irodori.jit.functions import select
from irodori.jit.vector_memory import gather, load, mask_bits, spread, store
from irodori.rendering.interactive.packets import FACET, NORMAL, OBJECT, RAYS, nearest_shapes, raised
from irodori.rendering.interactive.representation_layout import has_sheets

_occluded = c_function(types.void, types.uintp, types.uintp, types.uintp, types.uintp)
# RTCRay16 begins as RTCRayHit16 does: origin, direction and far end, sixteen words each.
_ORIGIN, _DIRECTION, _FAR = 0, 64, 128


@uncounted(forceinline=True)
def light_hits(job, packet, hits, seen):
    """Fill ``hits.lit`` with the cosine of incidence of each lamp at each hit, 0 for hits facing away or in shadow.

    It is negative where a lamp lights a sheet that lets light through from the other side.
    """
    world, frame, layout, f, i, hit = job.world, job.frame, job.layout, packet.f, packet.i, hits.f
    side = spread(np.float32(1.0), 16)
    for lamp in range(frame.lamps):
        lx, ly, lz = (
            frame.lamp_direction[3 * lamp],
            frame.lamp_direction[3 * lamp + 1],
            frame.lamp_direction[3 * lamp + 2],
        )
        cosine = load(hit, NORMAL * RAYS, 16) * lx + load(hit, (NORMAL + 1) * RAYS, 16) * ly
        cosine = cosine + load(hit, (NORMAL + 2) * RAYS, 16) * lz
        front = load(hit, FACET * RAYS, 16) * lx + load(hit, (FACET + 1) * RAYS, 16) * ly
        front = front + load(hit, (FACET + 2) * RAYS, 16) * lz
        if has_sheets(layout):
            through = gather(world.shape, load(hits.i, OBJECT * RAYS, 16) * SHAPE + THROUGH) >= 0.0
            side = select(through & (cosine < 0.0) & (front < 0.0), spread(np.float32(-1.0), 16), 1.0)
        facing = seen & (side * cosine > 0.0) & (side * front > 0.0)
        if mask_bits(facing):
            origin, left = (raised(hit, 0, side), raised(hit, 1, side), raised(hit, 2, side)), facing
            direction = spread(lx, 16), spread(ly, 16), spread(lz, 16)
            if world.bounded > 0:
                distance, _, doubtful = nearest_shapes(world, origin, direction)
                facing = facing & ~(distance < np.inf)
                left = facing & doubtful
            if mask_bits(left):
                for axis in range(3):
                    store(f, RAYS + _ORIGIN + axis * RAYS, origin[axis])
                    store(f, RAYS + _DIRECTION + axis * RAYS, direction[axis])
                store(f, RAYS + _FAR, spread(np.float32(np.inf), 16))
                store(i, 0, select(left, spread(-1, 16), 0))
                _occluded(world.occluded, packet.valid, world.scene, packet.rays, world.query)
                facing = facing & (load(f, RAYS + _FAR, 16) >= 0.0)
        store(hits.lit, lamp * RAYS, select(facing, cosine, 0.0))
