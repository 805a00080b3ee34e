"""Compiled path tracing from the eye, all bands at once [eq. 5].

At each surface, one light is chosen and a direction sampled towards it, and another direction is sampled from the
surface's reflection; the power heuristic weights both (Veach and Guibas 1995). The mirror term has a single direction.
It is followed with the probability of its share of the reflected light; at the first surface it is followed in addition
to the other terms. Paths with little throughput end by Russian roulette, which does not bias the mean.
"""

import math

import numpy as np

from irodori.geometry.embree import hit_distance, hit_shape, is_blocked, trace
from irodori.geometry.surfaces import face_viewer
from irodori.jit.compilation import uncounted
from irodori.reflection.coat import passed
from irodori.reflection.fresnel import fresnel
from irodori.reflection.lobes import constants_of, features_of, strength, value_of
from irodori.reflection.lobes import density as lobe_density
from irodori.rendering.reference.band_loops import (
    PADDED,
    add_product,
    decode,
    fill_fresnel,
    fill_mixture,
    fill_mixture_grey,
    largest,
    scale,
    scale_by,
    summed,
    summed_product,
)
from irodori.rendering.reference.light_cache import cached_texel
from irodori.rendering.reference.lobe_sampling import Gloss, draw_cosine, draw_gloss, half_angles
from irodori.rendering.reference.random_numbers import (
    CHOICE,
    LIGHT,
    LOBE,
    PER_VERTEX,
    PICK,
    REST,
    SURVIVAL,
    TEXEL,
    VERTEX,
    Stream,
    draw_from,
)
from irodori.rendering.reference.sky_sampling import look_at_sky, sample_sky
from irodori.rendering.reference.sun_images import (
    draw_image,
    fill_image_shares,
    has_images,
    image_density,
    pick_chain,
    sun_density,
)
from irodori.rendering.reference.world import ALBEDO, NORMAL, PLACE, SHINE, Branch
from irodori.rendering.scene_arrays import COAT_BAND
from irodori.rendering.scene_lights import COLLIMATED, density_towards, sample_towards, unobstructed
from irodori.rendering.surface_hits import surface

#: Number of surfaces after which a path is cut and counted as cut; between two perfect mirrors it might never end.
LONGEST = 20_000
_GREEN = COAT_BAND  # band whose refractive index represents all bands when a term is chosen
_LEAST_REFLECTANCE = 1e-3  # least reflectance in that choice, because other bands may reflect more
_ROULETTE_FROM = 4  # Russian roulette begins at the fifth surface
#: At the first surface, the mirror term is followed in addition to the others, not with a probability: the image of a
#: lamp in a weak mirror, sampled seldom, would consist of bright dots. If the mirror's share is below 1 / MIRRORED,
#: only one of MIRRORED samples follows it.
MIRRORED = 4
_WIDEST = 2.0 * math.pi  # largest solid angle over which a direction is spread, sr
_OF_SUN = 0.5  # least probability of the mirror term where it shows a sun
_THIRD = 20  # bands of a part of the spectrum, see `ALBEDO`
# Columns of `Work.gloss`.
_SHARE, _BETA, _MU, _CONSTANT = 0, 1, 2, 3


@uncounted(forceinline=True)
def _fill_shares(world, point, share):
    """Fill the probabilities of choosing each light at a point, by its rough irradiance; return whether any is lit."""
    total = 0.0
    count = world.lights.kind.size
    for light in range(count):
        share[light] = unobstructed(world.lights, light, point)
        total += share[light]
    share[count] = world.sky.power
    total += share[count]
    for light in range(count + 1):
        share[light] = share[light] / total if total > 0.0 else 0.0
    return total > 0.0


@uncounted(forceinline=True)
def _weight(own, other):
    """Return the power-heuristic weight of a sample from its density and the other technique's, 1/sr.

    A density ``own`` below 0 stands for a single direction, which has no other technique and gets the weight 1.
    """
    return 1.0 / (1.0 + (other / own) ** 2) if own > 0.0 else 1.0


@uncounted(forceinline=True)
def _meet_light(world, work, index, density):
    """Add the light of the environment or an area light that a path hits.

    ``density`` is that with which the path's direction was sampled, 1/sr, or below 0 for a single direction.
    """
    count = world.lights.kind.size
    if index < 0:
        drawn = look_at_sky(world.sky, work.direction, work.coefficients) * work.share[count]
        decode(world.sky.basis, 0, work.coefficients.size - 1, work.coefficients, work.radiance)
        weight = _weight(density, drawn)
        add_product(work.throughput, work.radiance, weight, work.total)
        return
    for light in range(count):
        if world.lights.surface[light] != index:
            continue
        of_light = density_towards(world.lights, light, work.origin, work.direction)
        if of_light > 0.0:
            weight = _weight(density, of_light * work.share[light])
            for band in range(PADDED):
                work.radiance[band] = world.lights.spectrum[light, band]
            add_product(work.throughput, work.radiance, weight, work.total)


@uncounted(forceinline=True, error_model="numpy")
def _gloss(world, work, index, direction, cos_i, cos_r):
    """Return the gloss term for a light direction without its Fresnel reflectance, the sampling density, and cosθ_H.

    The gloss term is Σ β D G / (π cosθ_r), in 1/sr: multiplied by F and radiance and integrated over light directions,
    it gives the reflected radiance. The density, in 1/sr, is that of choosing a component by its share and sampling a
    direction from its lobe.
    """
    cos_phi, cos_h, phi = half_angles(work.normal, work.to_eye, direction, cos_i, cos_r)
    factor, drawn, lobes = 0.0, 0.0, world.objects.lobes
    for component in range(world.objects.lobe.shape[1]):
        share = work.gloss[component, _SHARE]
        if share <= 0.0:
            continue
        which = world.objects.lobe[index, component]
        constant = (work.gloss[component, _CONSTANT], work.gloss[component, _CONSTANT + 1])
        geometry, f0, f1, f2 = features_of(lobes, which, cos_i, cos_r, cos_phi, cos_h, phi)
        factor += work.gloss[component, _BETA] / math.pi * geometry * value_of(lobes, which, constant, f0, f1, f2)
        drawn += share * lobe_density(lobes, which, work.gloss[component, _MU], cos_r, cos_phi, cos_h, phi)
    return factor, drawn, cos_h


@uncounted(forceinline=True)
def _reflect(world, work, index, direction, probability):
    """Fill ``work.mixture`` with diffuse and gloss term for a light direction; return its sampling density, 1/sr.

    ``probability`` has the probabilities of the diffuse, the gloss and the transmission term. For a direction below the
    surface, the transmission term of a sheet is filled; without one, 0 is returned and nothing filled.
    """
    normal, facet = work.normal, work.facet
    cos_i, above, cos_r = 0.0, 0.0, 0.0
    for axis in range(3):
        cos_i += direction[axis] * normal[axis]
        above += direction[axis] * facet[axis]
        cos_r += work.to_eye[axis] * normal[axis]
    if cos_i <= 0.0 or above <= 0.0:
        if probability[2] <= 0.0 or cos_i >= 0.0 or above >= 0.0:
            return 0.0
        work.aimed[1] = 1.0
        fill_mixture_grey(work.through, -cos_i / math.pi, 0.0, work.mixture)
        return probability[2] * -cos_i / math.pi
    objects, drawn, ground = world.objects, probability[0] * cos_i / math.pi, cos_i / math.pi
    if objects.coupled[index] == 1:
        ground *= passed(cos_i, objects.n[index, _GREEN], objects.k[index, _GREEN])
    if probability[1] <= 0.0:
        fill_mixture_grey(work.diffuse, ground, 0.0, work.mixture)
        return _with_images(world, work, direction, probability, drawn)
    factor, of_gloss, cos_h = _gloss(world, work, index, direction, cos_i, cos_r)
    if objects.grey[index] == 1:
        reflected = factor * fresnel(cos_h, objects.n[index, 0], objects.k[index, 0])
        fill_mixture_grey(work.diffuse, ground, reflected, work.mixture)
    else:
        fill_fresnel(min(cos_h, 1.0), world.bands.n, world.bands.k, index, work.fresnel)
        fill_mixture(work.diffuse, ground, work.fresnel, factor, work.mixture)
    return _with_images(world, work, direction, probability, drawn + probability[1] * of_gloss)


@uncounted(forceinline=True)
def _with_images(world, work, direction, probability, drawn):
    """Return the density of a direction if some are aimed at images of suns, from that without these, 1/sr.

    Also fills by how much it is larger.
    """
    if not has_images(world.images):
        return drawn
    aimed, work.aimed[1] = work.aimed[0], 1.0
    if aimed <= 0.0 or drawn <= 0.0:
        return drawn
    start = (work.origin[0], work.origin[1], work.origin[2])
    towards = image_density(world.images, work.image, start, (direction[0], direction[1], direction[2]))
    whole = (1.0 - aimed) * drawn + aimed * (probability[0] + probability[1]) * towards
    work.aimed[1] = max(whole / drawn, 1.0)
    return whole


@uncounted(forceinline=True)
def _look_for_images(world, work):
    """Fill ``work.aimed`` and ``work.image`` at the origin of the next ray."""
    start = (work.origin[0], work.origin[1], work.origin[2])
    facet = (work.facet[0], work.facet[1], work.facet[2])
    work.aimed[0] = fill_image_shares(world.images, start, facet, work.image)


@uncounted(forceinline=True)
def _leave(world, work, index, sign):
    """Set the origin of a ray that leaves a side slightly above its point; with ``sign`` -1, slightly below it."""
    p = work.point
    height = world.offset_mm[world.objects.shape[index]] + world.steps * (abs(p[0]) + abs(p[1]) + abs(p[2]))
    for axis in range(3):
        work.origin[axis] = p[axis] + sign * height * work.facet[axis]


@uncounted(forceinline=True)
def _crosses(work, direction):
    """Return whether a direction leads below the surface."""
    facet = work.facet
    return facet[0] * direction[0] + facet[1] * direction[1] + facet[2] * direction[2] < 0.0


@uncounted(forceinline=True)
def _add_chosen_light(world, ray, work, index, probability, stream):
    """Choose a light, sample a direction towards it, and add its light that the surface reflects along the path.

    ``stream`` has the random numbers of this surface.
    """
    chosen, count = -1, world.lights.kind.size
    pick = draw_from(stream, PICK) if count > 0 else 0.0
    for light in range(count + 1):
        if work.share[light] > 0.0:
            chosen = light
            if pick < work.share[light]:
                break
            pick -= work.share[light]
    u, v = draw_from(stream, LIGHT), draw_from(stream, LIGHT + 1)
    if chosen == count:
        density = sample_sky(world.sky, u, v, work.light, work.coefficients)
    else:
        density = sample_towards(world.lights, chosen, work.origin, u, v, work.light)
    if density <= 0.0:
        return
    other = _reflect(world, work, index, work.light, probability)
    if other <= 0.0:
        return
    if probability[2] > 0.0 and _crosses(work, work.light):
        _leave(world, work, index, -1.0)
    share = work.share[chosen]
    if chosen < count and world.lights.surface[chosen] >= 0:
        trace(world.intersect, world.scene, ray, work.origin, work.light, np.inf)
        if hit_shape(ray) != world.lights.surface[chosen]:
            return
    else:
        trace(world.occluded, world.scene, ray, work.origin, work.light, np.inf)
        if is_blocked(ray):
            return
    if chosen == count:
        decode(world.sky.basis, 0, work.coefficients.size - 1, work.coefficients, work.radiance)
    else:
        for band in range(PADDED):
            work.radiance[band] = world.lights.spectrum[chosen, band]
        if world.lights.kind[chosen] == COLLIMATED:
            other = 0.0  # sampling the reflection cannot find a single direction
    drawn = share * density
    scale_by(work.mixture, work.radiance, _weight(drawn, other) / drawn)
    add_product(work.throughput, work.mixture, 1.0, work.total)


@uncounted(forceinline=True, error_model="numpy")
def _fill_gloss(world, work, index):
    """Fill ``work.gloss`` from the texel; return the sum of the components' β times the strength of their lobes."""
    objects, whole = world.objects, 0.0
    components = objects.lobe.shape[1]
    for component in range(components):
        at = work.texel.size - 2 * (components - component)
        beta, mu, share = work.texel[at], work.texel[at + 1], 0.0
        if beta > 0.0 and mu > 0.0:
            which = objects.lobe[index, component]
            share = beta * strength(objects.lobes, which, mu)
            constant = constants_of(objects.lobes, which, math.log(mu))
            work.gloss[component, _BETA], work.gloss[component, _MU] = beta, mu
            work.gloss[component, _CONSTANT], work.gloss[component, _CONSTANT + 1] = constant
        work.gloss[component, _SHARE] = share
        whole += share
    if whole > 0.0:
        for component in range(components):
            work.gloss[component, _SHARE] /= whole
    return whole


@uncounted(forceinline=True)
def _shares_of_terms(world, work, index, cos_r):
    """Return approximate shares of diffuse, gloss and mirror term in the light, F of the mirror, and transmission's.

    Also fills ``work.gloss``, ``work.diffuse``, ``work.through`` of a sheet and, if the refractive index varies between
    bands, ``work.fresnel`` with the mirror's reflectance.
    """
    objects = world.objects
    decode(world.bands.basis, index, objects.bases[index], work.texel, work.diffuse)
    if objects.coupled[index] == 1:
        scale(work.diffuse, passed(cos_r, objects.n[index, _GREEN], objects.k[index, _GREEN]))
    chi = objects.mirror[index]
    diffuse = summed_product(work.throughput, work.diffuse)
    total = summed(work.throughput)
    glossy = _fill_gloss(world, work, index)
    reflectance = 0.0
    if glossy > 0.0 or chi > 0.0:
        reflectance = fresnel(cos_r, objects.n[index, _GREEN], objects.k[index, _GREEN])
    # Approximately β F ∫ D G / (π cosθ_r) dω for a smooth surface and a view near the normal; never 0 with gloss.
    gloss = total * glossy * max(reflectance, _LEAST_REFLECTANCE)
    mirror = total * chi * reflectance
    if chi > 0.0 and objects.grey[index] == 0:
        fill_fresnel(min(cos_r, 1.0), world.bands.n, world.bands.k, index, work.fresnel)
        mirror = chi * summed_product(work.throughput, work.fresnel)
    through, sent = 0.0, objects.through[index]
    if sent >= 0:
        decode(world.bands.basis, sent, objects.bases[sent], work.through_texel, work.through)
        through = summed_product(work.throughput, work.through)
    whole = diffuse + gloss + mirror + through
    if not whole > 0.0:
        return 0.0, 0.0, 0.0, reflectance, 0.0
    return diffuse / whole, gloss / whole, mirror / whole, reflectance, through / whole


@uncounted(forceinline=True)
def _mirror(world, work, index, reflectance, weight, branch):
    """Set a branch to the mirror direction and multiply its throughput; return whether it leads away from the facet."""
    direction, throughput = branch.direction, branch.throughput
    cos_r, above = 0.0, 0.0
    for axis in range(3):
        cos_r += work.to_eye[axis] * work.normal[axis]
    for axis in range(3):
        direction[axis] = 2.0 * cos_r * work.normal[axis] - work.to_eye[axis]
        above += direction[axis] * work.facet[axis]
    weight *= world.objects.mirror[index]
    if world.objects.grey[index] == 1:
        scale(throughput, weight * reflectance)
    else:
        fill_fresnel(min(cos_r, 1.0), world.bands.n, world.bands.k, index, work.fresnel)
        scale_by(throughput, work.fresnel, weight)
    return above > 0.0


@uncounted(forceinline=True)
def _keep_mirror(world, work, index, terms, seldom):
    """Store the mirror branch of a path for later; return the other terms, and whether there is a branch to follow.

    A weak mirror is followed only in some samples; ``seldom`` is its weight in this sample, 0 if it is left out.
    """
    diffuse, gloss, mirror, reflectance, through = terms
    rough = diffuse + gloss + through
    if mirror <= 0.0 or rough <= 0.0:
        return terms, False
    weight, follows = 1.0 if mirror * MIRRORED >= 1.0 else seldom, False
    if weight > 0.0:
        for band in range(PADDED):
            work.kept.throughput[band] = work.throughput[band]
        follows = _mirror(world, work, index, reflectance, weight, work.kept)
        for axis in range(3):
            work.kept.origin[axis] = work.origin[axis]
    return (diffuse / rough, gloss / rough, 0.0, reflectance, through / rough), follows


@uncounted(forceinline=True)
def _favour_sun(world, work, terms):
    """Return the shares of the terms, that of the mirror raised where it shows a sun: a weak mirror would seldom do."""
    diffuse, gloss, mirror, reflectance, through = terms
    if mirror <= 0.0 or mirror >= _OF_SUN:
        return terms
    cosine = 0.0
    for axis in range(3):
        cosine += work.to_eye[axis] * work.normal[axis]
    x = 2.0 * cosine * work.normal[0] - work.to_eye[0]
    y = 2.0 * cosine * work.normal[1] - work.to_eye[1]
    z = 2.0 * cosine * work.normal[2] - work.to_eye[2]
    if sun_density(world.images, (x, y, z)) <= 0.0:
        return terms
    rest = (1.0 - _OF_SUN) / (1.0 - mirror)
    return rest * diffuse, rest * gloss, _OF_SUN, reflectance, rest * through


@uncounted(forceinline=True)
def _component(work, choice):
    """Return the gloss component that a number from 0 to 1 selects by the components' shares, never one of share 0."""
    chosen = 0
    for component in range(work.gloss.shape[0]):
        if work.gloss[component, _SHARE] > 0.0:
            chosen = component
            if choice < work.gloss[component, _SHARE]:
                break
            choice -= work.gloss[component, _SHARE]
    return chosen


@uncounted(forceinline=True)
def _turn(world, work, index, terms, stream):
    """Sample the next direction of a path and multiply its throughput.

    Returns the density of the direction in 1/sr, below 0 for the mirror direction, 0 if the path ends.
    """
    diffuse, gloss, mirror, reflectance, through = terms
    choice = draw_from(stream, CHOICE)
    d, normal = work.direction, work.normal
    if through > 0.0:
        _leave(world, work, index, 1.0)  # a light may have been sampled on the other side
    if choice < mirror:
        own = Branch(work.origin, d, work.throughput)
        return -1.0 if _mirror(world, work, index, reflectance, 1.0 / mirror, own) else 0.0
    u, v = draw_from(stream, LOBE), draw_from(stream, LOBE + 1)
    choice, aims, crosses = choice - mirror, False, False
    if through > 0.0:
        crosses = choice < through
        choice -= through
    if has_images(world.images):
        aimed = work.aimed[0] * (diffuse + gloss)
        aims = choice < aimed and not crosses
        if aims:
            chain, _ = pick_chain(work.image, choice / aimed)
            if not draw_image(world.images, world.sky, chain, (u, v), work, d):
                return 0.0
        else:
            choice = (choice - aimed) / (1.0 - work.aimed[0])
    if crosses:
        draw_cosine(normal, u, v, d)
        for axis in range(3):
            d[axis] = -d[axis]
        _leave(world, work, index, -1.0)
    elif not aims and choice < gloss:
        component = _component(work, choice / gloss)
        chosen = Gloss(world.objects.lobes, world.objects.lobe[index, component], work.gloss[component, _MU])
        if not draw_gloss(chosen, normal, work.to_eye, u, v, d):
            return 0.0
    elif not aims:
        draw_cosine(normal, u, v, d)
    drawn = _reflect(world, work, index, d, (diffuse, gloss, through))
    work.aimed[2] = work.aimed[1]
    if drawn > 0.0:
        scale_by(work.throughput, work.mixture, 1.0 / drawn)
    return drawn


@uncounted(forceinline=True)
def _arrive(world, work, ray, index):
    """Fill point, normals and texel of the shape that a path hit; return the cosine to the viewer and the side seen."""
    distance, d = hit_distance(ray), work.direction
    for axis in range(3):
        work.point[axis] = work.origin[axis] + distance * d[axis]
        work.to_eye[axis] = -d[axis]
    side = surface(world, index, ray, work)
    work.spread[1] += work.spread[0] * distance * distance
    return face_viewer(work.normal, work.facet, d), side


@uncounted(forceinline=True)
def _spread(work, density):
    """Note the solid angle over which a direction is spread that was sampled with a density, 1/sr; -1 for a mirror."""
    if density > 0.0:
        work.spread[0] = max(work.spread[0], min(1.0 / density, _WIDEST))


@uncounted(forceinline=True)
def _add_cached(world, ray, work, index, terms, stream):
    """Add the diffuse light of a surface from the cache, if a texel may stand for it.

    Returns the terms that are left to the path, zeros if it ends. Sheets, which let light through, have no texels, and
    under a coupled coat the light counts by its angle, which texels do not tell.
    """
    texel = -1
    if terms[0] > 0.0 and index < world.placed and world.objects.coupled[index] == 0:
        texel = cached_texel(world, ray, work, index, draw_from(stream, TEXEL))
    if texel < 0:
        return terms
    half = stream.of_sample[1] % 2
    for band in range(PADDED):
        work.mixture[band] = work.diffuse[band] * world.cache.light[half, texel, band]
        work.diffuse[band] = np.float32(0.0)
    add_product(work.throughput, work.mixture, 1.0, work.total)
    _, gloss, mirror, reflectance, through = terms
    rest = gloss + mirror
    if not draw_from(stream, REST) < rest:
        return 0.0, 0.0, 0.0, reflectance, through
    scale(work.throughput, 1.0 / rest)
    return 0.0, gloss / rest, mirror / rest, reflectance, through


@uncounted(forceinline=True)
def _survives(world, work, stream):
    """Apply Russian roulette to a path; return whether it continues.

    The chance is that of a path that is not aimed at an image: small throughputs would end those that find suns.
    """
    chance = largest(work.throughput)
    if has_images(world.images):
        chance *= work.aimed[2]
    if chance >= 1.0:
        return True
    if not draw_from(stream, SURVIVAL) < chance:
        return False
    scale(work.throughput, 1.0 / chance)
    return True


@uncounted(forceinline=True, fastmath={"reassoc", "contract", "nsz"})
def _see(work, spectrum, shine, weight):
    """Add the diffuse reflectance (or radiance) and the share of gloss of a path's first hit to ``work.seen``."""
    for part in range(3):
        total = np.float32(0.0)
        for band in range(part * _THIRD, (part + 1) * _THIRD):
            total += spectrum[band]
        work.seen[ALBEDO + part] += weight * total / _THIRD
    work.seen[SHINE] += weight * shine


@uncounted(forceinline=True)
def follow(world, ray, work, drawn, seldom, weight):
    """Trace one path from the eye, add its radiance to ``work.total`` and return the number of branches that were cut.

    ``drawn`` has the random numbers and the stream of the path; ``seldom`` is as in `_keep_mirror`; ``weight`` is that
    of the path in the mean of its pixel.
    """
    for band in range(PADDED):
        work.throughput[band] = np.float32(weight)
    return _trace_path(world, ray, work, drawn, seldom, (-1, False))


@uncounted(forceinline=True)
def gather(world, ray, work, numbers, stream, start):
    """Trace one path from a point of a surface; add the radiance of a perfect diffuser there to ``work.total``.

    ``work`` has the point in ``point``, ``normal`` and ``facet``. ``start`` has the side whose coat reduces the light,
    and says whether direct light of the scene's own lights, other than the environment, is added. Returns the number of
    paths that were cut.
    """
    for band in range(PADDED):
        work.throughput[band] = work.diffuse[band] = np.float32(1.0)
    for axis in range(3):
        work.to_eye[axis] = work.normal[axis]
        work.origin[axis] = work.point[axis]
    return _trace_path(world, ray, work, (numbers, stream), 0.0, start)


@uncounted(forceinline=True)
def _fill_own_shares(world, point, lamps, share):
    """Fill the probabilities of choosing each light at a place of `gather`; return whether any is lit."""
    if lamps:
        return _fill_shares(world, point, share)
    count = world.lights.kind.size
    for light in range(count):
        share[light] = 0.0
    share[count] = 1.0 if world.sky.power > 0.0 else 0.0
    return world.sky.power > 0.0


@uncounted(forceinline=True)
def _trace_path(world, ray, work, drawn, seldom, begun):
    """Follow a path to its end, from the ray in ``work`` or from a place; return the number of branches that were cut.

    ``drawn`` has the random numbers and the stream of the path; ``begun`` has the side of the place, -1 for a path that
    begins with the ray, and whether the scene's lamps light the place. For a place, ``work`` has its point as the
    origin, its normals, and spectrum and direction of a perfect diffuser seen from above in ``diffuse``, ``to_eye``.
    """
    (numbers, stream), (place, lamps) = drawn, begun
    density, vertex = -1.0, 0
    cut, kept, start, at_place = 0, False, float(work.throughput[0]), place >= 0
    work.aimed[2] = max(1.0, 1.0 / start)
    work.spread[0] = work.spread[1] = 0.0
    while True:
        goes_on, lit, index = False, False, np.int64(place)
        if not at_place:
            trace(world.intersect, world.scene, ray, work.origin, work.direction, np.inf)
            index = np.int64(hit_shape(ray))
        if not at_place and (index < 0 or index >= world.placed):
            _meet_light(world, work, index, density)
            if vertex == 0:
                _see(work, work.radiance, 0.0, start)
        else:
            own = Stream(numbers, stream, VERTEX + vertex * PER_VERTEX)
            terms = (1.0, 0.0, 0.0, 0.0, 0.0)
            if not at_place:
                cos_r, index = _arrive(world, work, ray, index)
                terms = (0.0, 0.0, 0.0, 0.0, 0.0)
                if cos_r > 0.0:
                    terms = _shares_of_terms(world, work, index, cos_r)
                if vertex == 0:
                    _see(work, work.diffuse, terms[1] + terms[2], start)
                    if terms[4] > 0.0:
                        _see(work, work.through, 0.0, start)
                    for axis in range(3):
                        work.seen[NORMAL + axis] += start * work.normal[axis]
                        work.seen[PLACE + axis] += start * work.point[axis]
                if work.spread[1] > 0.0:
                    terms = _add_cached(world, ray, work, index, terms, own)
            if terms[0] + terms[1] + terms[2] + terms[4] > 0.0:
                if not at_place:
                    _leave(world, work, index, 1.0)
                    if vertex == 0:
                        terms, kept = _keep_mirror(world, work, index, terms, seldom)
                if has_images(world.images) and terms[0] + terms[1] > 0.0:
                    _look_for_images(world, work)
                    terms = _favour_sun(world, work, terms)
                if at_place:
                    lit = _fill_own_shares(world, work.origin, lamps, work.share)
                elif terms[0] + terms[1] + terms[4] > 0.0:
                    lit = _fill_shares(world, work.origin, work.share)
                if lit:
                    _add_chosen_light(world, ray, work, index, (terms[0], terms[1], terms[4]), own)
                density = _turn(world, work, index, terms, own)
                _spread(work, density)
                goes_on = density != 0.0 and (vertex < _ROULETTE_FROM or _survives(world, work, own))
        at_place = False
        vertex += 1
        if goes_on and vertex < LONGEST:
            continue
        cut += int(goes_on)
        if not kept:
            return cut
        density, vertex, kept, work.aimed[2] = -1.0, 1, False, max(1.0, 1.0 / start)
        work.spread[0] = work.spread[1] = 0.0
        for axis in range(3):
            work.origin[axis], work.direction[axis] = work.kept.origin[axis], work.kept.direction[axis]
        for band in range(PADDED):
            work.throughput[band] = work.kept.throughput[band]
