"""Write the classroom page of a scene, or list what an existing page contains."""

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from irodori.config.project import add_configfile, load_named
from irodori.core.errors import InputError, PlainError, is_file

_PAYLOAD = re.compile(r'<script type="application/octet-stream" id="payload">([^<]*)</script>')


def payload_of(path) -> str:
    """Return the payload of a page's file, base64.

    Raises
    ------
    InputError
        If there is no file, or it has no payload.
    """
    if not is_file(path):
        raise InputError(path, "", "no file", "a page that irodori wrote")
    found = _PAYLOAD.search(Path(path).read_text(encoding="utf-8", errors="replace"))
    if found is None:
        raise InputError(path, "", "no payload", "a page that irodori wrote")
    return found[1]


def inspected(path) -> str:
    """Return a page's header as JSON, with the value range of each plane; long lists are replaced by their length."""
    from irodori.viewer.payload import read_payload

    header, planes = read_payload(payload_of(path), path)
    ranges = {name: [float(p.min(initial=0)), float(p.max(initial=0))] for name, p in planes.items()}
    for plane in header["planes"]:
        plane["range"] = ranges[plane["name"]]
    return json.dumps(_shortened(header), indent=1, ensure_ascii=False)


def _shortened(value):
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    if isinstance(value, list) and len(value) > 8 and not isinstance(value[0], dict):
        return f"{len(value)} entries"
    return [_shortened(item) for item in value] if isinstance(value, list) else value


def write_scene(name: str, output: Path | None, configs: Sequence[str] = ()) -> Path:
    """Write a scene's page from the results in the working directory and return its path.

    ``configs`` are configurations on top of the default one.

    Raises
    ------
    InputError
        If there is no such scene, a result is missing, or the definition of an object or an environment has
        changed since its material or its light was made.
    """
    from irodori.config.pages import page_rooms, page_views
    from irodori.config.placed_names import materials_of
    from irodori.export.export_sources import light_of, material_of
    from irodori.viewer.stage import SceneSources, export_viewer

    loaded = load_named("scenes", name, configs)
    scene = loaded.scenes[name]
    files = [material_of(loaded, item, configs) for item in materials_of(scene)]
    lights = [light_of(loaded, room, configs) for room in page_rooms(scene)]
    sources = SceneSources(
        name,
        scene,
        tuple(loaded.objects[item.object].shape for item in scene.objects),
        tuple(files),
        tuple(lights),
        loaded.config.render.min_throughput,
    )
    output = output or Path(f"results/{name}/viewer.html")
    output.parent.mkdir(parents=True, exist_ok=True)
    pictures = [Path(f"results/{name}/{view}.{kind}") for view in page_views(scene)[:1] for kind in ("png", "exr")]
    poster, picture = ([*(p if p.is_file() else None for p in pictures), None, None])[:2]
    export_viewer(sources, output=output, poster=poster, picture=picture)
    return output


def main(arguments: list[str] | None = None, prog: str = "python -m irodori.viewer.viewer_command") -> int:
    """Run the command; return 0, or 2 after an error, which is printed in one sentence."""
    parser = argparse.ArgumentParser(prog=prog, description=__doc__)
    parser.add_argument("scene", help="name of a scene in the configuration's folder of definitions")
    add_configfile(parser)
    parser.add_argument("--output", type=Path, help="page to write, results/SCENE/viewer.html where absent")
    parser.add_argument("--inspect", action="store_true", help="write nothing: print what the scene's page holds")
    given = parser.parse_args(arguments)
    try:
        if given.inspect:
            print(inspected(given.output or Path(f"results/{given.scene}/viewer.html")))
        else:
            print(write_scene(given.scene, given.output, given.configfile))
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
