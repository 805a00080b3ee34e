"""Random numbers keyed by pixel, sample and dimension, independent of threads and tiles.

The samples of a pixel are divided into independent replicates. Within a replicate, the first dimensions are pairs of a
Sobol sequence (paired and shuffled as in Kollig and Keller 2002). Further dimensions are hashed. Each replicate's mean
is unbiased, and the spread of the replicates is a valid error estimate for such points; the spread of single samples
would not be.

All pixels use the same points, each with its own digital shift. In the dimensions of the first surfaces, this shift is
the one that turns the points into a later part of the sequence: pixels have their parts in the order of a curve through
the picture that fills squares one after another (Morton 1966), shuffled anew for each pair of dimensions (Ahmed and
Wonka 2020, doi 10.1145/3414685.3417881). The samples of a square of pixels together then cover the dimensions evenly
too. The error of a pixel is the same, but errors of neighbours cancel, where a filter takes their mean. In the other
dimensions the shift is random.
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
#: Dimension before which, from the first surface on, neighbouring pixels have neighbouring parts of the sequence.
_ORDERED = VERTEX + PER_VERTEX + LOBE + 2
_LARGEST_SET = 4096
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_ODD = np.uint64(0xD1342543DE82EF95)


class Numbers(NamedTuple):
    """Sobol points that all pixels use, for compiled loops."""

    points: np.ndarray  # (replicates, samples of a set, DIMENSIONS) uint32
    replicates: int
    samples: int  # of a replicate
    most: int  # the same for pixels that need more
    seed: int
    directions: np.ndarray  # (replicates, DIMENSIONS, 32) uint32 by which each bit of an index changes a point
    levels: int  # bits of a pixel's place on the curve, 0 for places that have no neighbours


def make_numbers(samples: int, seed: int, replicates: int, more: int = 1) -> Numbers:
    """Return the Sobol points for a number of samples per pixel.

    Parameters
    ----------
    samples : int
        Samples per pixel, a multiple of ``replicates``.
    seed : int, from 0
    replicates : int
        At least 2.
    more : int
        Samples of the pixels that need most, as a multiple of ``samples``. The first samples of a set are a run of the
        sequence, and so is the whole set: each number of samples covers the dimensions evenly.
    """
    count = samples // replicates
    size, run = min(more * count, _LARGEST_SET), min(count, _LARGEST_SET)
    generator, sets = np.random.default_rng([seed, 0x1D0]), replicates * (DIMENSIONS // 2)
    order = _shuffled_runs(sets, size, run, generator)
    found, directions = _scrambled_sobol(sets, size, generator)
    points = np.take_along_axis(found, order[..., None], axis=1)
    points = points.reshape(replicates, DIMENSIONS // 2, size, 2).swapaxes(1, 2).reshape(replicates, size, DIMENSIONS)
    directions = directions.reshape(replicates, DIMENSIONS, 32)
    return Numbers(np.ascontiguousarray(points), replicates, count, more * count, seed, directions, 0)


def in_order(numbers: Numbers, width: int, height: int) -> Numbers:
    """Return the numbers for a picture of a size in pixels, whose neighbouring pixels share a sequence."""
    return numbers._replace(levels=2 * (max(width, height) - 1).bit_length())


def _shuffled_runs(sets: int, size: int, run: int, generator: np.random.Generator) -> np.ndarray:
    """Return the numbers from 0 to ``size``, (sets, size): runs in random order, each shuffled, then what is left."""
    whole = size // run * run
    runs = np.broadcast_to(np.arange(whole).reshape(-1, run), (sets, whole // run, run))
    runs = generator.permuted(runs, axis=2)
    order = generator.permuted(np.broadcast_to(np.arange(whole // run), (sets, whole // run)), axis=1)
    runs = np.take_along_axis(runs, order[..., None], axis=1).reshape(sets, whole)
    rest = generator.permuted(np.broadcast_to(np.arange(whole, size), (sets, size - whole)), axis=1)
    return np.concatenate([runs, rest], axis=1)


def _scrambled_sobol(sets: int, count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return scrambled points of the first two dimensions of the Sobol sequence, (sets, count, 2) uint32 in 2⁻³².

    The second result, (sets, 2, 32), has the numbers by which each bit of a point's index changes the point.

    The points are like those of `scipy.stats.qmc.Sobol`, whose package takes a second to import: each direction number
    is multiplied by a random binary matrix, lower triangular from the most significant bit (Matoušek 1998), and all
    points of a set are moved by a random digital shift.
    """
    directions = np.ones((2, 32), dtype=np.uint64)
    for column in range(1, 32):  # of the primitive polynomial x + 1; the first dimension is the mirrored number
        directions[1, column] = directions[1, column - 1] << np.uint64(1) ^ directions[1, column - 1]
    places = np.arange(32, dtype=np.uint64)
    directions <<= places[::-1]
    shift = generator.integers(1 << 32, size=(sets, 1, 2), dtype=np.uint32)
    drawn = generator.integers(2, size=(sets, 2, 32, 32), dtype=np.uint8)
    # Each row of a matrix is the bits of a number, whose product with a direction number is the parity of their common
    # bits.
    rows = np.packbits(drawn, axis=3).view(">u4")[..., 0].astype(np.uint32)
    bit = np.uint32(1) << places[::-1].astype(np.uint32)
    rows = rows & ~(2 * bit - 1) | bit
    parity = np.bitwise_count(rows[..., :, None] & directions.astype(np.uint32)[:, None, :]) & np.uint8(1)
    scrambled = np.bitwise_or.reduce(parity * bit[:, None], axis=2)
    # In Gray code each point differs from the one before by the direction of the lowest bit set in its number.
    number = np.arange(1, count)
    steps = np.zeros((sets, count, 2), dtype=np.uint32)
    steps[:, 1:] = scrambled[:, :, np.log2(number & -number).astype(int)].swapaxes(1, 2)
    return np.bitwise_xor.accumulate(steps, axis=1) ^ shift, scrambled


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
def _reversed_place(x, y):
    """Return the place of a pixel on the curve, its 32 bits in reverse order, uint64."""
    place = np.uint64(0)
    for value, first in ((np.uint64(x), 31), (np.uint64(y), 30)):
        for bit in range(16):
            place |= ((value >> np.uint64(bit)) & np.uint64(1)) << np.uint64(first - 2 * bit)
    return place


@uncounted(forceinline=True)
def _shuffled(place, key):
    """Return a number whose bits are exchanged at random, each depending on the lower ones (Laine and Karras 2011)."""
    place ^= place * np.uint64(0x3D20ADEA)
    place += key >> np.uint64(32)
    place *= (key >> np.uint64(16)) | np.uint64(1)
    place ^= place * np.uint64(0x05526C56)
    return place ^ place * np.uint64(0x53A22864)


@uncounted(forceinline=True)
def fill_shifts(numbers, pixel, replicate, part, shifts):
    """Fill the digital shifts of a pixel's points, (DIMENSIONS,) uint32.

    Parameters
    ----------
    numbers : Numbers
    pixel : (int, int, int)
        Column, row, and samples of a replicate.
    replicate : int
    part : int
        How many times the points have been used before; each time they get other shifts.
    """
    (x, y, samples), size = pixel, numbers.points.shape[1]
    key, ordered = pixel_key(x, y, replicate, numbers.seed) + np.uint64(part) * _ODD, VERTEX
    if numbers.levels > 0:
        ordered, taken = _ORDERED, 0
        while (1 << taken) < min(samples, size):
            taken += 1
        levels, place = min(numbers.levels, 32 - taken), _reversed_place(x, y)
        of_picture = pixel_key(part, 0, replicate, numbers.seed) * _ODD
        for pair in range(VERTEX, _ORDERED, 2):
            own = _mixed(of_picture + np.uint64(pair) * _GOLDEN)
            index, one, other = _shuffled(place, own), np.uint32(0), np.uint32(0)
            if part > 0:
                one, other = np.uint32(own >> np.uint64(32)), np.uint32(own & np.uint64(0xFFFFFFFF))
            for bit in range(levels):
                chosen = np.uint32(0) - np.uint32((index >> np.uint64(31 - bit)) & np.uint64(1))
                one ^= np.uint32(chosen & numbers.directions[replicate, pair, taken + bit])
                other ^= np.uint32(chosen & numbers.directions[replicate, pair + 1, taken + bit])
            shifts[pair], shifts[pair + 1] = one, other
    for dimension in range(DIMENSIONS):
        if not VERTEX <= dimension < ordered:
            shifts[dimension] = np.uint32(_mixed(key + np.uint64(dimension) * _GOLDEN) >> np.uint64(32))


@uncounted(forceinline=True)
def stream_of(numbers, key, replicate, sample, shifts):
    """Return the stream of a sample for `draw`: its key, its indices in the points, and their shifts."""
    return _mixed(key + np.uint64(sample + 1) * _ODD), replicate, sample % numbers.points.shape[1], shifts


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
    if dimension < DIMENSIONS:
        bits = stream[3][dimension] ^ numbers.points[stream[1], stream[2], dimension]
    else:
        bits = np.uint32(_mixed(stream[0] + np.uint64(dimension) * _GOLDEN) >> np.uint64(32))
    return np.float64(bits) * 2.0**-32
