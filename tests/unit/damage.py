"""Kinds of damage to files, for the tests that fuzz their readers."""

from hypothesis import strategies as st


def cut(content: bytes, share: float) -> bytes:
    """Return a file cut short, to a share of its length below 1."""
    return content[: min(int(share * len(content)), len(content) - 1)]


def flip(content: bytes, places: list[tuple[float, int]]) -> bytes:
    """Return a file with bits flipped: (place as a share of its length, bits to flip) each."""
    out = bytearray(content)
    for share, bits in places:
        out[int(share * len(out))] ^= bits
    return bytes(out)


shares = st.floats(0.0, 1.0, exclude_max=True)
#: One to eight damaged bytes; mostly a single bit, as a disk or a cable flips it.
places = st.lists(
    st.tuples(shares, st.sampled_from([1 << bit for bit in range(8)]) | st.integers(1, 255)), min_size=1, max_size=8
)
