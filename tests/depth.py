"""Number of examples that the property-based tests of hard cases draw."""

_DEEPER = 8
_heavy = False


def ask_for_heavy(wanted: bool) -> None:
    """Say, before tests are collected, whether heavy tests are asked for."""
    global _heavy
    _heavy = wanted


def examples(count: int) -> int:
    """Return how many examples to draw where an ordinary run draws ``count``."""
    return count * _DEEPER if _heavy else count


def inputs(ordinary: int, heavy: int) -> int:
    """Return how many inputs a fuzzer reads: one number in an ordinary run, another where heavy tests are asked for."""
    return heavy if _heavy else ordinary
