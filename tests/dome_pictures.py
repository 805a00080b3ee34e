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
