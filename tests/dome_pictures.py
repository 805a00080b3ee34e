"""Pictures of balls under lamps of known directions, computed by formulas of their own, for tests."""

import numpy as np

SIZE = (120, 170)
BALL = (83.4, 58.7, 41.3)  # x, y, radius


def lamps(count: int, seed: int = 5) -> np.ndarray:
    """Return directions of lamps within 50 degrees of the camera, (count, 3)."""
    rng = np.random.default_rng(seed)
    angle, azimuth = np.radians(rng.uniform(8.0, 50.0, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)


def supersampled(shade, ball=BALL, size=SIZE, fine: int = 4) -> np.ndarray:
    """Return a picture (rows, columns, 3): a function of normals (n, 3) on the ball, a dim wall with a stand beside.

    Every pixel is the mean of fine x fine places.
    """
    x0, y0, radius = ball
    rows, columns = ((np.arange(side * fine) + 0.5) / fine - 0.5 for side in size)
    x, y = np.meshgrid(columns, rows)
    a, b = (x - x0) / radius, (y0 - y) / radius
    inside = a * a + b * b < 1.0
    out = np.where((np.abs(a + 0.1) < 0.25) & (b < -0.9), 0.05, 0.02 + 0.005 * (b > 0.3))[..., None].repeat(3, axis=2)
    normals = np.stack([a, b, np.sqrt(np.maximum(1.0 - a * a - b * b, 0.0))], axis=-1)[inside]
    out[inside] = shade(normals)
    return out.reshape(size[0], fine, size[1], fine, 3).mean(axis=(1, 3))


def mirror_ball(lamp: np.ndarray, **how) -> np.ndarray:
    """Return the picture of a polished ball: the image of a lamp of 10 degrees, which clips, and of a darker room."""

    def shade(normals):
        towards = 2.0 * normals[:, 2:] * normals - [0.0, 0.0, 1.0]
        room = 0.06 + 0.04 * towards[:, :1]
        return np.where(towards @ lamp > np.cos(np.radians(5.0)), 5.0, room[:, 0])[:, None] * np.ones(3)

    return np.clip(supersampled(shade, **how), 0.0, 1.0)


def eight_bits(picture: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


def sixteen_bits(picture: np.ndarray) -> np.ndarray:
    return np.rint(65535.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint16)


def _shade(normals: np.ndarray, lamp: np.ndarray, beta: float, mu: float) -> np.ndarray:
    """Return the response (n,) of a painted surface with normals (n, 3) under a lamp of level 1."""
    alpha = 0.45 + 0.1 * np.sin(7.0 * normals[:, 0]) * np.cos(5.0 * normals[:, 1])
    cosine, towards_eye = normals @ lamp, normals[:, 2]
    half = lamp + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    tilt, over = np.clip(normals @ half, -1.0, 1.0), float(half[2])
    # Fresnel's equations for unpolarised light that falls on the facet at the angle whose cosine is ``over``.
    inner = np.sqrt(1.0 - (1.0 - over**2) / 1.5**2)
    across, along = (over - 1.5 * inner) / (over + 1.5 * inner), (inner - 1.5 * over) / (inner + 1.5 * over)
    fresnel = 0.5 * (across**2 + along**2)
    masked = np.minimum(1.0, 2.0 * tilt * np.minimum(towards_eye, np.maximum(cosine, 0.0)) / over)
    gloss = beta * fresnel * np.exp(-((np.arccos(tilt) / mu) ** 2)) * masked / np.maximum(towards_eye, 1e-3)
    return np.where(cosine > 0.0, alpha * cosine + gloss, 0.0)


def painted_ball(lamp: np.ndarray, level: float, *, beta: float, mu: float, fine: int = 3, seed: int = 1) -> np.ndarray:
    """Return the green response of a ball of several greys with a gloss of equation (5), by its formula written anew.

    The index is 1.5. Noise is a two hundredth of the range.
    """

    def shade(normals):
        return level * _shade(normals, lamp, beta, mu)[:, None] * np.ones(3)

    picture = supersampled(shade, fine=fine)
    return picture + np.random.default_rng(seed).normal(0.0, 0.005, picture.shape)


#: Spherical caps on a plate: x, y of the centre and its height above the plate, and the radius, pixels.
CAPS = ((52.0, 44.0, -8.0, 27.0), (112.0, 70.0, 4.0, 24.0), (66.0, 92.0, -30.0, 45.0))


def relief_normals(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Return heights (...) in pixels and unit normals (..., 3) of a plate with caps: x right, y up, z to the camera."""
    height, normal = np.zeros(np.shape(x)), np.zeros((*np.shape(x), 3))
    normal[..., 2] = 1.0
    for x0, y0, z0, radius in CAPS:
        square = radius**2 - (x - x0) ** 2 - (y - y0) ** 2
        top = z0 + np.sqrt(np.maximum(square, 0.0))
        higher = (square > 0.0) & (top > height)
        height = np.where(higher, top, height)
        out = np.stack([x - x0, y0 - y, top - z0], axis=-1) / radius
        normal[higher] = out[higher]
    return height, normal


def relief(lamp: np.ndarray, level: float, *, beta: float, mu: float, fine: int = 3, seed: int = 1) -> np.ndarray:
    """Return the green response of a plate with caps, which cast shadows; paint and noise as of `painted_ball`."""
    rows, columns = ((np.arange(side * fine) + 0.5) / fine - 0.5 for side in SIZE)
    x, y = np.meshgrid(columns, rows)
    height, normal = relief_normals(x, y)
    lit = normal @ lamp > 0.0
    for x0, y0, z0, radius in CAPS:
        # A ray from a place towards the lamp meets the sphere of a cap, above the plate and not at its own place.
        away = np.stack([x - x0, y0 - y, height - z0], axis=-1)
        half = away @ lamp
        root = half**2 - (away**2).sum(axis=-1) + radius**2
        way = -half + np.sqrt(np.maximum(root, 0.0))
        lit &= ~((root > 0.0) & (way > 1e-3 * radius) & (height + way * lamp[2] > 0.0))
    shown = _shade(normal.reshape(-1, 3), lamp, beta, mu).reshape(x.shape) * lit
    picture = level * shown.reshape(SIZE[0], fine, SIZE[1], fine).mean(axis=(1, 3))[..., None].repeat(3, axis=2)
    return picture + np.random.default_rng(seed).normal(0.0, 0.005, picture.shape)
