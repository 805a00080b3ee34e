"""Plugins of Mitsuba 3 that read Irodori's coefficients: the BSDF ``irodori_surface``, the emitter ``irodori_sky``.

An export for Mitsuba contains a copy of this file, which needs only Mitsuba and NumPy. Choose a spectral variant,
import this file, and then load the scene:

    import mitsuba
    mitsuba.set_variant("llvm_ad_spectral")
    import irodori_mitsuba
    picture = mitsuba.render(mitsuba.load_file("scene.xml"))

A spectrum is the sum of a few basis vectors weighted with the coefficients of a texel or a pixel. It is interpolated
linearly between the wavelengths, and outside 400 to 700 nm it keeps its end value. Importing the file raises an
ImportError unless a supported variant is chosen.
"""

# mypy: ignore-errors
# Mitsuba's types depend on the variant, which is chosen at run time.

import drjit as dr
import mitsuba as mi
import numpy as np

_VARIANTS = ("llvm_ad_spectral", "cuda_ad_spectral")
if mi.variant() not in _VARIANTS:
    raise ImportError(f"found Mitsuba's variant {mi.variant()!r}; accepted: {' or '.join(_VARIANTS)}")

_FIRST_NM, _STEP_NM, _LAST = 400.0, 5.0, 60
_GREEN = 30  # index of the wavelength, 550 nm, whose refractive index decides how often each term is sampled
_LEAST_REFLECTANCE = 1e-3
_TINY = 1e-18
_LOBES = ("gaussian", "ggx")


def _read(props) -> dict[str, np.ndarray]:
    with np.load(str(mi.file_resolver().resolve(props["file"]))) as file:
        return {name: file[name] for name in file.files}


class _Vectors:
    """Table of m spectra, (m, 61), interpolated at the wavelengths of a ray."""

    def __init__(self, spectra: np.ndarray) -> None:
        self.count = len(spectra)
        self.table = mi.Float(np.ascontiguousarray(spectra, dtype=np.float32).ravel())

    def at(self, wavelengths, active=True) -> list:
        """Return the m spectra at the given wavelengths, nm."""
        found: list[list] = [[] for _ in range(self.count)]
        for wavelength in wavelengths:
            place = dr.clip((wavelength - _FIRST_NM) / _STEP_NM, 0.0, float(_LAST))
            first = dr.minimum(mi.UInt32(place), _LAST - 1)
            part = place - mi.Float(first)
            for number, values in enumerate(found):
                index = first + number * (_LAST + 1)
                low, high = (dr.gather(mi.Float, self.table, index + i, active) for i in (0, 1))
                values.append(low + part * (high - low))
        return [mi.Spectrum(values) for values in found]


class _Picture:
    """Picture (h, w, m) with bilinear interpolation; columns wrap around if ``wraps``, rows are clamped."""

    def __init__(self, pixels: np.ndarray, wraps: bool) -> None:
        self.height, self.width, self.count = pixels.shape
        self.wraps = wraps
        self.data = mi.Float(np.ascontiguousarray(pixels, dtype=np.float32).ravel())

    def at(self, u, v, active=True) -> list:
        """Return the m values at the coordinates u and v, each 0..1, v from the top."""
        if not self.wraps:
            u = dr.clip(u, 0.5 / self.width, 1.0 - 0.5 / self.width)
        x, y = u * self.width - 0.5, dr.clip(v * self.height - 0.5, 0.0, self.height - 1.0)
        left, above = dr.floor(x), dr.floor(y)
        fx, fy = x - left, y - above
        column = mi.Int32(left)
        first = dr.select(column < 0, column + self.width, column)
        second = column + 1
        second = dr.select(second >= self.width, second - self.width, second)
        row = mi.Int32(above)
        below = dr.minimum(row + 1, self.height - 1)
        corners = [(row, first, (1 - fx) * (1 - fy)), (row, second, fx * (1 - fy)),
                   (below, first, (1 - fx) * fy), (below, second, fx * fy)]  # fmt: skip
        places = [(mi.UInt32((r * self.width + c) * self.count), weight) for r, c, weight in corners]
        return [
            sum(weight * dr.gather(mi.Float, self.data, place + i, active) for place, weight in places)
            for i in range(self.count)
        ]


def _angles(direction):
    """Return azimuth (from +x towards +y, over 2π) and polar angle (from +z, over π) of unit vectors, both 0..1."""
    turn = dr.atan2(direction.y, direction.x) / (2.0 * dr.pi)
    across = dr.sqrt(dr.square(direction.x) + dr.square(direction.y))
    return dr.select(turn < 0.0, turn + 1.0, turn), dr.atan2(across, direction.z) * dr.inv_pi


def fresnel(cosine, n, k):
    """Return the unpolarised Fresnel reflectance of n + ik in air, for numbers or spectra."""
    c = dr.clip(cosine, 0.0, 1.0)
    s2 = (1.0 - c) * (1.0 + c)
    real = n * n - s2 - k * k
    modulus = dr.sqrt(real * real + 4.0 * dr.square(n * k))
    a2 = dr.maximum(0.5 * (modulus + real), 0.0)
    a = dr.sqrt(a2)
    across = (modulus + c * c - 2.0 * a * c) / dr.maximum(modulus + c * c + 2.0 * a * c, _TINY)
    along = modulus * c * c + s2 * s2
    ratio = (along - 2.0 * a * c * s2) / dr.maximum(along + 2.0 * a * c * s2, _TINY)
    return dr.clip(0.5 * across * (1.0 + ratio), 0.0, 1.0)


def _lobe(name: str, mu, cos_i, cos_r, half, cos_h):
    """Return D G / cosθ_r of a lobe."""
    cos_phi, sin2_phi = half.z, half.x * half.x + half.y * half.y
    if name == "gaussian":
        phi = dr.atan2(dr.sqrt(sin2_phi), cos_phi)
        facet = 2.0 * cos_phi / dr.maximum(cos_h, _TINY)
        bounded = dr.minimum(dr.minimum(facet * cos_i, 1.0) / dr.maximum(cos_r, _TINY), facet)
        return dr.exp(-dr.square(phi / mu)) * bounded
    m2 = mu * mu
    ratio = m2 / (m2 * (1.0 - sin2_phi) + sin2_phi)
    root_i, root_r = (dr.sqrt(c * c + m2 * (1.0 - c * c)) for c in (cos_i, cos_r))
    return 2.0 * cos_i * ratio * ratio / dr.maximum(cos_r * root_i + cos_i * root_r, _TINY)


def _inside(mu):
    """Return the probability of the untruncated Gaussian facet distribution for tilts up to 90°."""
    return 1.0 - dr.exp(-dr.square(0.5 * dr.pi / mu))


def _draw(name: str, mu, view, sample):
    """Draw a half vector from the facet distribution of a lobe; ``sample`` has two uniform random numbers."""
    if name == "gaussian":
        phi = mu * dr.sqrt(-dr.log(dr.maximum(1.0 - sample.x * _inside(mu), _TINY)))
        sine, cosine = dr.sincos(phi)
        across, along = dr.sincos(2.0 * dr.pi * sample.y)
        return mi.Vector3f(sine * along, sine * across, cosine)
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, mu, True).sample(view, sample)[0]


def _density(name: str, mu, view, half, cos_h):
    """Return the probability density, 1/sr, of the view direction mirrored at a half vector drawn by `_draw`."""
    if name == "gaussian":
        sine = dr.sqrt(half.x * half.x + half.y * half.y)
        phi = dr.atan2(sine, half.z)
        spread = dr.select(sine > 1e-6, phi / dr.maximum(sine, 1e-6), 1.0)
        return dr.exp(-dr.square(phi / mu)) * spread / (dr.pi * mu * mu * _inside(mu) * 4.0 * cos_h)
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, mu, True).pdf(view, half) / (4.0 * cos_h)


class _Side:
    """Reflection of one side of a surface, and light that a thin sheet lets through from its other side.

    Its directions are local, with +z away from this side. ``held`` has the arrays of an .npz file, those of the side
    with the prefix ``name``.
    """

    def __init__(self, held: dict, name: str = "") -> None:
        self.lobes = [str(lobe) for lobe in held[f"{name}lobes"]]
        unknown = [lobe for lobe in self.lobes if lobe not in _LOBES]
        if unknown:
            raise ValueError(f"the lobe {unknown[0]!r}; accepted: {', '.join(_LOBES)}")
        self.texture = _Picture(held[f"{name}texels"], bool(held["wraps"]))
        self.basis = _Vectors(held[f"{name}basis"])
        self.passed = _Vectors(held[f"{name}passed"])
        index = held[f"{name}index"]
        self.index = _Vectors(index)
        self.green = float(index[0, _GREEN]), float(index[1, _GREEN])
        self.mirror = float(held[f"{name}mirror"])
        self.is_coupled = bool(held[f"{name}coupled"])

    def terms(self, si, wi, uv, active):
        """Return reflectance, transmittance, β and μ of each gloss component, and the probabilities of all terms.

        The probabilities are those of the diffuse term, of each gloss component, of the mirror and of the light that
        passes through, in this order.
        """
        texel = self.texture.at(*uv, active)
        spectra = []
        for vectors, first in ((self.basis, 0), (self.passed, len(texel) - self.passed.count)):
            pairs = zip(texel[first:], vectors.at(si.wavelengths, active), strict=False)
            spectra.append(sum((c * vector for c, vector in pairs), mi.Spectrum(0.0)))
        pairs = texel[self.basis.count : len(texel) - self.passed.count]
        betas = [dr.select(mu > 0.0, beta, 0.0) for beta, mu in zip(pairs[::2], pairs[1::2], strict=True)]
        mus = [dr.select(mu > 0.0, mu, 1.0) for mu in pairs[1::2]]
        facing = fresnel(mi.Frame3f.cos_theta(wi), *self.green)
        gloss = [
            b * 4.0 * dr.square(m) * dr.maximum(facing, _LEAST_REFLECTANCE) for b, m in zip(betas, mus, strict=True)
        ]
        through = dr.maximum(dr.mean(spectra[1]), 1e-4) if self.passed.count else mi.Float(0.0)
        shares = [dr.maximum(dr.mean(spectra[0]), 1e-4), *gloss, self.mirror * facing, through]
        total = sum(shares)
        return spectra, betas, mus, [share / total for share in shares]

    def rough(self, si, wi, wo, terms, active):
        """Return all terms but the mirror times cosθ_i, and the density with which they sample ``wo``, 1/sr."""
        (spectrum, passed), betas, mus, shares = terms
        cos_i, cos_r = mi.Frame3f.cos_theta(wo), mi.Frame3f.cos_theta(wi)
        behind = active & (cos_i < 0.0) & (cos_r > 0.0)
        active = active & (cos_i > 0.0) & (cos_r > 0.0)
        half = dr.normalize(wi + wo)
        cos_h = dr.maximum(dr.dot(wi, half), _TINY)
        n, k = self.index.at(si.wavelengths, active)
        reflectance = fresnel(cos_h, n, k)
        factor, density = mi.Float(0.0), shares[0] * cos_i * dr.inv_pi
        for name, beta, mu, share in zip(self.lobes, betas, mus, shares[1:], strict=False):
            factor += beta * _lobe(name, mu, cos_i, cos_r, half, cos_h)
            density += dr.select(beta > 0.0, share * _density(name, mu, wi, half, cos_h), 0.0)
        ground = spectrum * cos_i
        if self.is_coupled:  # the ground has the light that passes the surface in and out
            green = [fresnel(cosine, *self.green) for cosine in (cos_i, cos_r, 1.0)]
            ground = ground * ((1.0 - green[0]) * (1.0 - green[1]) / dr.square(1.0 - green[2]))
        value = (ground + reflectance * factor) * dr.inv_pi
        value, density = dr.select(active, value, 0.0), dr.select(active, density, 0.0)
        if self.passed.count:
            value = dr.select(behind, passed * (-cos_i * dr.inv_pi), value)
            density = dr.select(behind, shares[-1] * -cos_i * dr.inv_pi, density)
        return value, density

    def sample(self, si, wi, terms, sample1, sample2, active):
        """Draw a direction; return it, whether the mirror is chosen, density and weight: BSDF times cosine over it."""
        mus, shares = terms[2:]
        cos_r = mi.Frame3f.cos_theta(wi)
        active = active & (cos_r > 0.0)
        even = mi.warp.square_to_cosine_hemisphere(sample2)
        wo, passed = even, mi.Float(shares[0])
        for name, mu, share in zip(self.lobes, mus, shares[1:], strict=False):
            half = _draw(name, mu, wi, sample2)
            chosen = (sample1 >= passed) & (sample1 < passed + share)
            wo = dr.select(chosen, mi.reflect(wi, half), wo)
            passed = passed + share
        is_mirror = (sample1 >= passed) & (shares[-2] > 0.0)
        wo = dr.select(is_mirror, mi.reflect(wi), wo)
        if self.passed.count:
            crosses = sample1 >= passed + shares[-2]
            is_mirror &= ~crosses
            wo = dr.select(crosses, mi.Vector3f(even.x, even.y, -even.z), wo)
            active &= crosses | (mi.Frame3f.cos_theta(wo) > 0.0)  # gloss below the surface is lost
        value, density = self.rough(si, wi, wo, terms, active)
        n, k = self.index.at(si.wavelengths, active)
        weight = dr.select(is_mirror, self.mirror * fresnel(cos_r, n, k) / dr.maximum(shares[-2], _TINY),
                           value / dr.maximum(density, _TINY))  # fmt: skip
        return wo, is_mirror, dr.select(is_mirror, shares[-2], density), weight


class Surface(mi.BSDF):
    """BSDF of an object: diffuse reflection, gloss components and mirror reflection (equation 5 of the paper).

    Properties: ``file``, an .npz file of this export. The texture of a ball is looked up by the direction of the
    normal, rotated as the file states; that of other shapes by their texture coordinates, with v from the top. A thin
    sheet has two sides, through which diffuse light passes; others are black from behind.
    """

    def __init__(self, props) -> None:
        mi.BSDF.__init__(self, props)
        held = _read(props)
        self.is_ball = bool(held["is_ball"])
        self.object_from_world = mi.Matrix3f(np.ascontiguousarray(held["rotation"].T, dtype=np.float32))
        is_sheet = "back_texels" in held
        self.sides = [(1.0, _Side(held))] + ([(-1.0, _Side(held, "back_"))] if is_sheet else [])
        flags = mi.BSDFFlags
        varies = flags.SpatiallyVarying | flags.FrontSide
        rough = flags.DiffuseReflection | flags.GlossyReflection
        if is_sheet:
            varies, rough = varies | flags.BackSide, rough | flags.DiffuseTransmission
        self.m_components = [rough | varies, flags.DeltaReflection | varies]
        self.m_flags = rough | flags.DeltaReflection | varies

    def _seen(self, si, active):
        """Yield each side, the direction to the eye in its frame, a function that turns directions, and its terms."""
        uv = _angles(self.object_from_world @ si.n) if self.is_ball else (si.uv.x, si.uv.y)
        for sign, side in self.sides:

            def turned(way, sign=sign):
                return mi.Vector3f(way.x, way.y, sign * way.z)

            wi = turned(si.wi)
            yield side, wi, turned, side.terms(si, wi, uv, active)

    def eval(self, ctx, si, wo, active=True):
        """Return the BSDF times the cosine of the angle of incidence."""
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        """Return the probability density of sampling the direction ``wo``, 1/sr."""
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        """Return the results of `eval` and `pdf`."""
        value, density = mi.Spectrum(0.0), mi.Float(0.0)
        for side, wi, turned, terms in self._seen(si, active):  # one is seen, the other adds nothing
            found = side.rough(si, wi, turned(wo), terms, active)
            value, density = value + found[0], density + found[1]
        return value, density

    def sample(self, ctx, si, sample1, sample2, active=True):
        """Draw a direction; return it as a BSDF sample, and its weight: BSDF times cosine over density."""
        wo, is_mirror, density, weight = mi.Vector3f(0.0, 0.0, 1.0), mi.Mask(False), mi.Float(0.0), mi.Spectrum(0.0)
        for side, wi, turned, terms in self._seen(si, active):
            seen = mi.Frame3f.cos_theta(wi) > 0.0
            way, *found = side.sample(si, wi, terms, sample1, sample2, active)
            wo = dr.select(seen, turned(way), wo)
            is_mirror, density, weight = (
                dr.select(seen, new, old) for new, old in zip(found, (is_mirror, density, weight), strict=True)
            )
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.eta, bs.pdf = wo, 1.0, density
        bs.sampled_type = dr.select(is_mirror, mi.UInt32(+mi.BSDFFlags.DeltaReflection),
                                    mi.UInt32(+mi.BSDFFlags.GlossyReflection))  # fmt: skip
        bs.sampled_component = dr.select(is_mirror, mi.UInt32(1), mi.UInt32(0))
        active = active & (bs.pdf > 0.0)
        return bs, dr.select(active, weight, 0.0)

    def to_string(self) -> str:
        """Return its name for Mitsuba's log."""
        return f"irodori_surface[{', '.join(self.sides[0][1].lobes)}]"


class Sky(mi.Emitter):
    """Emitter of the environment's light, a picture with rows from the zenith +z and columns by azimuth from +x to +y.

    Properties: ``file``, an .npz file of this export; ``radius``, the radius of a sphere that encloses the scene.
    """

    def __init__(self, props) -> None:
        mi.Emitter.__init__(self, props)
        held = _read(props)
        self.radius = float(props["radius"])
        coefficients, basis = held["coefficients"].astype(np.float32), held["basis"]
        self.picture, self.basis = _Picture(coefficients, True), _Vectors(basis)
        height, width, _ = coefficients.shape
        self.size = width, height
        power = np.maximum(coefficients @ basis.sum(axis=1).astype(np.float32), 0.0)
        # Interpolation spreads the light of a pixel into its neighbours.
        power = np.maximum.reduce([np.roll(power, i, axis=1) for i in (-1, 0, 1)])
        padded = np.pad(power, ((1, 1), (0, 0)), mode="edge")
        power = np.maximum.reduce([padded[i : i + height] for i in (0, 1, 2)])
        edges = np.cos(np.linspace(0.0, np.pi, height + 1))
        power = power * (edges[:-1] - edges[1:])[:, None]
        self.drawn = bool(power.any())
        power = power if self.drawn else np.ones_like(power)
        # A small probability for every pixel, so that none is left out.
        self.choice = mi.DiscreteDistribution2D(mi.TensorXf((power + 1e-3 * power.mean()).astype(np.float32)))
        self.m_flags = +(mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying)

    def _radiance(self, direction, wavelengths, active):
        u, v = _angles(direction)
        coefficients, vectors = self.picture.at(u, v, active), self.basis.at(wavelengths, active)
        return sum((c * vector for c, vector in zip(coefficients, vectors, strict=True)), mi.Spectrum(0.0)), u, v

    def _density(self, u, v, active):
        width, height = self.size
        pixel = mi.Point2u(dr.minimum(mi.UInt32(u * width), width - 1), dr.minimum(mi.UInt32(v * height), height - 1))
        sine = dr.maximum(dr.sin(v * dr.pi), 1e-6)
        return self.choice.pdf(pixel, active) * (width * height) / (2.0 * dr.square(dr.pi) * sine)

    def eval(self, si, active=True):
        """Return the radiance seen by a ray that leaves the scene."""
        return dr.select(active, self._radiance(-si.wi, si.wavelengths, active)[0], 0.0)

    def sample_direction(self, it, sample, active=True):
        """Draw a direction in proportion to the power of the pixels; return it, and radiance over density."""
        width, height = self.size
        pixel, _, rest = self.choice.sample(sample, active)
        u, v = (mi.Float(pixel.x) + rest.x) / width, (mi.Float(pixel.y) + rest.y) / height
        sine, cosine = dr.sincos(v * dr.pi)
        across, along = dr.sincos(2.0 * dr.pi * u)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = mi.Vector3f(sine * along, sine * across, cosine)
        ds.dist = mi.Float(2.0 * self.radius)
        ds.p, ds.n = it.p + ds.d * ds.dist, -ds.d
        ds.uv, ds.time, ds.delta = mi.Point2f(u, v), it.time, False
        ds.pdf = self._density(u, v, active)
        ds.emitter = mi.EmitterPtr(self)
        value = self._radiance(ds.d, it.wavelengths, active)[0]
        return ds, dr.select(active & (ds.pdf > 0.0), value / dr.maximum(ds.pdf, _TINY), 0.0)

    def pdf_direction(self, it, ds, active=True):
        """Return the probability density of drawing a direction, 1/sr."""
        return dr.select(active, self._density(*_angles(ds.d), active), 0.0)

    def eval_direction(self, it, ds, active=True):
        """Return the radiance from a direction."""
        return dr.select(active, self._radiance(ds.d, it.wavelengths, active)[0], 0.0)

    def bbox(self):
        """Return an empty bounding box, because the light has no place."""
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        """Return its name for Mitsuba's log."""
        return f"irodori_sky[{self.size[0]} x {self.size[1]}]"


mi.register_bsdf("irodori_surface", Surface)
mi.register_emitter("irodori_sky", Sky)
