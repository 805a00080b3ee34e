"""Random numbers keyed by pixel, sample and dimension, independent of threads and tiles.

The samples of a pixel are divided into independent replicates. Within a replicate, the first dimensions are pairs of a
Sobol sequence (paired and shuffled as in Kollig and Keller 2002); all pixels use the same points, each with its own
random digital shift. Further dimensions are hashed. Each replicate's mean is unbiased, and the spread of the replicates
is a valid error estimate for such points; the spread of single samples would not be.
"""

from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import uncounted

PIXEL, LENS = 0, 2
VERTEX = 4  # first dimension of the first surface
LIGHT, LOBE, CHOICE, PICK, SURVIVAL, TEXEL = 0, 2, 4, 5, 6, 7
PER_VERTEX = 8
REST = 1 << 20  # a dimension of each surface beyond those of the sequence
_VERTICES = 4
DIMENSIONS = VERTEX + _VERTICES * PER_VERTEX
_LARGEST_SET = 4096
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_ODD = np.uint64(0xD1342543DE82EF95)


class Numbers(NamedTuple):
    """Sobol points that all pixels use, for compiled loops."""

    points: np.ndarray  # (replicates, samples of a set, DIMENSIONS) uint32
    replicates: int
    samples: int  # of a replicate
    seed: int


def make_numbers(samples: int, seed: int, replicates: int) -> Numbers:
    """Return the Sobol points for a number of samples per pixel.

    Parameters
    ----------
    samples : int
        Samples per pixel, a multiple of ``replicates``.
    seed : int, from 0
    replicates : int
        At least 2.
    """
    count = samples // replicates
    size = min(count, _LARGEST_SET)
    generator = np.random.default_rng([seed, 0x1D0])
    points = np.empty((replicates, size, DIMENSIONS), dtype=np.uint32)
    for replicate in range(replicates):
        for pair in range(0, DIMENSIONS, 2):
            points[replicate, :, pair : pair + 2] = generator.permutation(_scrambled_sobol(size, generator.spawn(1)[0]))
    return Numbers(points, replicates, count, seed)


def _scrambled_sobol(count: int, generator: np.random.Generator) -> np.ndarray:
    """Return scrambled points of the first two dimensions of the Sobol sequence, (count, 2) uint32 in units of 2⁻³².

    The points are those of `scipy.stats.qmc.Sobol`, whose package takes a second to import: each direction number is
    multiplied by a random binary matrix, lower triangular from the most significant bit (Matoušek 1998), and all points
    are moved by a random digital shift.
    """
    directions = np.ones((2, 32), dtype=np.uint64)
    for column in range(1, 32):  # of the primitive polynomial x + 1; the first dimension is the mirrored number
        directions[1, column] = directions[1, column - 1] << np.uint64(1) ^ directions[1, column - 1]
    places = np.arange(32, dtype=np.uint64)
    directions <<= places[::-1]
    shift = generator.integers(2, size=(2, 32), dtype=np.uint32) @ (np.uint32(1) << np.arange(32, dtype=np.uint32))
    matrices = np.tril(generator.integers(2, size=(2, 32, 32), dtype=np.uint32), -1) | np.eye(32, dtype=np.uint32)
    bits = directions[:, None, :] >> places[::-1, None] & np.uint64(1)  # (dimension, bit from the highest, column)
    # Sums of 32 bits are exact in single precision, whose products of matrices are fast.
    sums = (matrices.astype(np.float32) @ bits.astype(np.float32)).astype(np.uint64)
    scrambled = np.bitwise_or.reduce((sums & np.uint64(1)) << places[::-1, None], axis=1)
    # In Gray code each point differs from the one before by the direction of the lowest bit set in its number.
    number = np.arange(1, count)
    steps = np.zeros((count, 2), dtype=np.uint64)
    steps[1:] = scrambled[:, np.log2(number & -number).astype(int)].T
    return (np.bitwise_xor.accumulate(steps, axis=0) ^ shift).astype(np.uint32)


@uncounted(forceinline=True)
def _mixed(z):
    """Return a hash of a 64-bit integer by the finaliser of SplitMix64 (Steele et al. 2014)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@uncounted(forceinline=True)
def pixel_key(x, y, replicate, seed):
    """Return the key, uint64, from which the random numbers of a pixel in a replicate are derived."""
    key = _mixed(np.uint64(seed) * _ODD + _GOLDEN)
    key = _mixed(key + (np.uint64(x) << np.uint64(32)) + np.uint64(y))
    return _mixed(key + np.uint64(replicate) * _GOLDEN)


@uncounted(forceinline=True)
def stream_of(numbers, key, replicate, sample):
    """Return the stream of a sample for `draw`: keys of its set and of itself, and its indices in the points."""
    size = numbers.points.shape[1]
    # A set of points that is used again gets a new shift.
    of_set = key + np.uint64(sample // size) * _ODD
    return of_set, _mixed(key + np.uint64(sample + 1) * _ODD), replicate, sample % size


class Stream(NamedTuple):
    """Random numbers of one sample from a dimension on, with the arguments of `draw`."""

    numbers: Numbers
    of_sample: tuple  # see `stream_of`
    first: int


@uncounted(forceinline=True)
def draw_from(stream, dimension):
    """Return a random number in [0, 1) of a `Stream`; ``dimension`` is counted from its first."""
    return draw(stream.numbers, stream.of_sample, stream.first + dimension)


@uncounted(forceinline=True)
def draw(numbers, stream, dimension):
    """Return the random number in [0, 1) of one dimension of a sample."""
    step = np.uint64(dimension) * _GOLDEN
    if dimension < DIMENSIONS:
        bits = np.uint32(_mixed(stream[0] + step) >> np.uint64(32)) ^ numbers.points[stream[2], stream[3], dimension]
    else:
        bits = np.uint32(_mixed(stream[1] + step) >> np.uint64(32))
    return np.float64(bits) * 2.0**-32
