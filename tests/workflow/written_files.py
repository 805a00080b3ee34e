"""Tables of `docs/files.md`: every dataset of a finished run's HDF5 files, as the files themselves say.

``python tests/workflow/written_files.py RESULTS`` writes them anew.
"""

import re
import sys
from pathlib import Path

import h5py

PAGE = Path(__file__).resolve().parents[2] / "docs/files.md"
_BEGIN, _END = "<!-- datasets: written by tests/workflow/written_files.py -->", "<!-- end of datasets -->"
#: Kinds of files: a pattern of the path, how the page writes it, what it holds.
KINDS = (
    (r"cameras/[^/]+/reference", "cameras/CAMERA/reference", "What normalises the photographs of a camera"),
    (r"cameras/[^/]+/calibration", "cameras/CAMERA/calibration", "From responses to spectra, with its errors"),
    (r".*/linear/[^/]+", "WHERE/linear/CAPTURE", "Linear responses of one pose, both filter states on one grid"),
    (r"[^/]+/registration(-\d)?", "OBJECT/registration", "Where the object stood by its photographs"),
    (r"[^/]+/placement(-\d)?", "OBJECT/placement", "Where it stood by those of all objects photographed together"),
    (
        r"[^/]+/observations/tile-\d+",
        "OBJECT/observations/tile-NNN",
        "Responses and angles of every texel in every capture",
    ),
    (r"[^/]+/patch_levels", "OBJECT/patch_levels", "The lamp's level in every photograph, by a patch in the frame"),
    (r"[^/]+/lobes", "OBJECT/lobes", "The form of gloss, chosen by photographs that were left out"),
    (r"[^/]+/levels", "OBJECT/levels", "The lamp's level in every photograph, estimated with the materials"),
    (r"[^/]+/brdf/tile-\d+", "OBJECT/brdf/tile-NNN", "Reflection fitted to each texel separately"),
    (r"[^/]+/surface", "OBJECT/surface", "The same with gloss shared by paint"),
    (r"[^/]+/material", "OBJECT/material", "The result: spectra and gloss of the object"),
    (r"environments/[^/]+", "environments/ENVIRONMENT", "Light from all directions"),
    (r".*/photographs/[^/]+/radiance", "SCENE/photographs/NAME/radiance", "What stands before a virtual camera"),
    (r".*/photographs/[^/]+/comparison", "SCENE/photographs/NAME/comparison", "Photograph and rendering, compared"),
    (r"[^/]+(/truth)?/light-maps", "SCENE/light-maps", "Light that falls on the objects of a scene, baked"),
    (r".*/truth", "OBJECT/truth, environments/ENVIRONMENT/truth", "What the virtual rig photographed"),
)


def kind_of(name: str) -> int:
    """Return the number of the kind that a file of a results folder is of, given its path without the suffix."""
    return next(number for number, (pattern, *_) in enumerate(KINDS) if re.fullmatch(pattern, name))


def _numbered(text: str) -> str:
    """Return text in which the number of a level of blurred light is NN."""
    return re.sub(r"(level-|theta_|azimuth_)\d\d", r"\1NN", text)


def described(path: Path) -> dict[str, tuple[str, str, str, str]]:
    """Return dataset -> axes, type, unit and quantity of everything that a file holds values of."""
    found = {}

    def note(name: str, item) -> None:
        if not isinstance(item, h5py.Dataset) or item.attrs["quantity"].endswith("without values"):
            return
        codes = h5py.check_enum_dtype(item.dtype)
        kind = "text" if item.dtype.kind == "S" else str(item.dtype)
        kind = f"{kind}: {', '.join(f'{value} {code.lower()}' for code, value in codes.items())}" if codes else kind
        told = (item.attrs[key] for key in ("dims", "units", "quantity"))
        dims, units, quantity = (_numbered(text).replace("|", "\\|") for text in told)
        found[_numbered(name)] = (dims.replace(",", ", "), kind, units, quantity)

    with h5py.File(path) as file:
        file.visititems(note)
    return found


def of_results(results: Path) -> dict[int, dict[str, tuple[str, str, str, str]]]:
    """Return kind -> dataset -> description, over all files of a finished run."""
    found: dict[int, dict] = {}
    for path in sorted(results.rglob("*.h5")):
        found.setdefault(kind_of(path.relative_to(results).with_suffix("").as_posix()), {}).update(described(path))
    return found


def tables(found: dict) -> str:
    """Return the tables of the page."""
    parts = []
    for number in sorted(found):
        _, name, title = KINDS[number]
        files = ", ".join(f"`results/{one}.h5`" for one in name.split(", "))
        rows = [f"| `{dataset}` | {' | '.join(told)} |" for dataset, told in sorted(found[number].items())]
        head = "| Dataset | Axes | Type | Unit | What it is |\n| --- | --- | --- | --- | --- |"
        parts.append(f"### {title}: {files}\n\n{head}\n" + "\n".join(rows))
    return "\n\n".join(parts)


def of_page(page: str) -> str:
    """Return what stands between the marks of a page."""
    return page.partition(_BEGIN)[2].partition(_END)[0].strip()


def main() -> None:
    """Write the tables from a results folder into the page."""
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(_BEGIN)
    after = rest.partition(_END)[2]
    text = f"{before}{_BEGIN}\n\n{tables(of_results(Path(sys.argv[1])))}\n\n{_END}{after}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
