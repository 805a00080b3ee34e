"""Check that OpenCV, which needs libraries of the system, can be loaded."""

from irodori.core.errors import PlainError


def need_opencv(what: str) -> None:
    """Raise a `PlainError` that says that ``what`` needs OpenCV if OpenCV cannot be loaded."""
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        raise PlainError(
            f"{what} needs OpenCV, which does not start ({error}): install the system's libgl1 and libglib2.0-0"
        ) from error
