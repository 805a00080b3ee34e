"""Hooks of the documentation's site: pages that are made at every build, links out of the folder, formulas.

MkDocs calls the functions ``on_...``. The pages of commands and of the package are made at every build (see
`reference_pages`); so are copies of the documents that stand elsewhere in the repository. A link to a file that has no
page becomes plain text, so that no link leads out of the site.
"""

import json
import logging
import posixpath
import re
import sys
from pathlib import Path

import reference_pages
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

LOGGER = logging.getLogger("mkdocs.hooks")
ROOT = Path(__file__).resolve().parents[2]
FORMULAS = Path(__file__).with_name("formulas.json")
#: Documents of the repository outside docs/, and their pages.
COPIED = {
    "config/README.md": "reference/configuration.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "README.md": "index.md",
}
_PACKAGE = "reference/package"
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
_FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)


def on_config(config):
    """Put the rooms of the package into the navigation, and let formulas be typeset."""
    # The package of this repository, installed or not: `mkdocs` does not look where it was started.
    sys.path.insert(0, str(ROOT))
    rooms = [{room.title: f"{_PACKAGE}/{room.name}.md"} for room in reference_pages.rooms(ROOT)]
    config.nav = _replaced(config.nav, _PACKAGE, [{"All rooms": f"{_PACKAGE}/index.md"}, *rooms])
    fences = [{"name": "math", "class": "math", "format": _formula}]
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": fences}
    return config


def on_files(files, config):
    """Add the pages that are made, and those of documents that stand elsewhere."""
    pages = {page: (ROOT / source).read_text(encoding="utf-8") for source, page in COPIED.items() if page != "index.md"}
    pages["reference/commands.md"] = reference_pages.commands_page()
    pages |= {f"{_PACKAGE}/{name}.md": text for name, text in reference_pages.package_pages(ROOT).items()}
    for page, text in pages.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    """Let links between documents of the repository lead to their pages; drop those to files without a page."""
    uri = page.file.src_uri
    source = next((s for s, p in COPIED.items() if p == uri and p != "index.md"), f"docs/{uri}")
    pieces, end = [], 0
    for fence in _FENCE.finditer(markdown):
        pieces += [_linked(markdown[end : fence.start()], source, uri), fence[0]]
        end = fence.end()
    return "".join([*pieces, _linked(markdown[end:], source, uri)])


def on_page_content(html, page, config, files):
    """Take an empty head of a column for a cell like others, which readers of the page aloud do not announce."""
    return html.replace("<th></th>", "<td></td>")


def on_post_page(output, page, config):
    """Name the dialogue of the search, for those who hear the page."""
    dialogue = 'data-md-component="search" role="dialog"'
    return output.replace(dialogue, f'{dialogue} aria-label="Search"')


def _linked(markdown: str, source: str, uri: str) -> str:
    def replaced(found) -> str:
        mark, text, target = found.groups()
        path, hash_, anchor = target.partition("#")
        if not path or re.match(r"[a-z]+:", target):
            return found[0]
        repository_path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        page = COPIED.get(repository_path)
        if page is None and repository_path.startswith("docs/"):
            page = repository_path.removeprefix("docs/")
        if page is None:
            if not (ROOT / repository_path).exists():
                raise PluginError(f"{source}: link to {target}, which does not exist")
            return text
        return f"{mark}[{text}]({posixpath.relpath(page, posixpath.dirname(uri) or '.')}{hash_}{anchor})"

    return _LINK.sub(replaced, markdown)


def _replaced(entries, name: str, by):
    """Return a navigation in which the entry of some name is another."""
    if isinstance(entries, list):
        return [_replaced(entry, name, by) for entry in entries]
    if isinstance(entries, dict):
        return {title: _replaced(entry, name, by) for title, entry in entries.items()}
    return by if entries == name else entries


def _formula(source, language, class_name, options, md, **_):
    """Return the MathML of a formula, which ``write_formulas.mjs`` has made from its TeX."""
    known = json.loads(FORMULAS.read_text(encoding="utf-8"))
    tex = source.strip()
    if tex not in known:
        # An exception would end here: the extension shows the source then. A warning fails the build.
        LOGGER.warning("formula without MathML, run docs/hooks/write_formulas.mjs: %s", tex)
        return ""
    return f'<div class="formula" tabindex="0">{known[tex]}</div>'
