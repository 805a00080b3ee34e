"""The documents and their site: no dead link, nothing from elsewhere, formulas and figures in place, and no barrier."""

import csv
import json
import os
import re
import subprocess
import sys
import unicodedata
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml
from accessibility import violations

from benchmarks.site_figures import DRAWN
from irodori.viewer.browser import browser_command

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
#: Documents that one reads where the repository lies, without a site.
DOCUMENTS = [*sorted(ROOT.glob("*.md")), ROOT / "config" / "README.md", *sorted(DOCS.rglob("*.md"))]
READMES = ("README.md", "README.ja.md")
#: Of the figures, together.
MOST_BYTES = 3_000_000


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```|`[^`\n]*`", "", text, flags=re.MULTILINE | re.DOTALL)


def links(text: str) -> list[str]:
    return re.findall(r"\]\(([^()\s]+)\)", without_code(text))


def anchors(text: str) -> set[str]:
    """Return the names under which a document's headings can be linked to, where Markdown is shown as it lies."""
    heads = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    words = (unicodedata.normalize("NFC", head).strip().lower() for head in heads)
    return {re.sub(r"[^\w\- ]", "", word).replace(" ", "-") for word in words}


# ---- the documents as they lie in the repository


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_of_a_document_lead_to_files_and_headings_that_exist(path):
    for link in links(text_of(path)):
        file, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        target = (path.parent / file).resolve() if file else path
        assert target.exists(), f"{path.name}: {link}"
        assert not anchor or anchor in anchors(text_of(target)), f"{path.name}: {link}"


def test_a_dead_link_and_a_dead_anchor_are_noticed():
    assert links("[a](b.md#c) `[d](e)` ![f](g.png)\n```\n[h](i)\n```\n") == ["b.md#c", "g.png"]
    assert anchors("# Bit for bit\n## `irodori check` and more\n```\n# none\n```") == {
        "bit-for-bit", "irodori-check-and-more"}  # fmt: skip


@pytest.mark.parametrize("name", READMES)
def test_the_readme_is_short(name):
    assert len(text_of(ROOT / name).splitlines()) <= 120


def test_the_japanese_readme_has_the_parts_of_the_english_one():
    english, japanese = (text_of(ROOT / name) for name in READMES)
    for part in (r"^#+ ", r"^\d\. ", r"^\| "):
        found = [len(re.findall(part, text, re.MULTILINE)) for text in (english, japanese)]
        assert found[0] == found[1] > 0, part
    blocks = [re.findall(r"^```bash\n.*?^```", text, re.MULTILINE | re.DOTALL) for text in (english, japanese)]
    assert blocks[0] == blocks[1] and len(blocks[0]) == 3
    own = [sorted(set(links(text)) - set(READMES)) for text in (english, japanese)]
    assert own[0] == own[1]


def test_the_readme_states_the_figures_of_its_prose_in_both_languages():
    with (DOCS / "figures/error_budget.csv").open(newline="") as file:
        (light,) = (float(row["mean"]) for row in csv.DictReader(file) if row["stage"] == "light")
    for text in (without_code(text_of(ROOT / name)) for name in READMES):
        assert all(figure in text for figure in (f"{light:.2f}", "0.27", "0.28"))


def test_figures_are_small_shown_and_drawn_by_the_script():
    figures = {path.name for path in (DOCS / "figures").iterdir() if path.suffix in (".png", ".svg")}
    assert figures == {*DRAWN, "viewer.png"}
    assert sum(path.stat().st_size for path in (DOCS / "figures").iterdir()) < MOST_BYTES
    shown = {Path(link).name for path in DOCUMENTS for link in links(text_of(path))}
    assert figures <= shown


def test_every_picture_says_what_it_shows():
    for path in DOCUMENTS:
        for words in re.findall(r"!\[([^\]]*)\]\(", text_of(path)):
            assert len(words.split()) >= 3 or "。" in words or "、" in words, f"{path.name}: {words!r}"


def test_every_formula_has_its_mathml_and_no_other_is_kept():
    block = re.compile(r"^```math\n(.*?)^```", re.MULTILINE | re.DOTALL)
    blocks = [tex.strip() for path in DOCUMENTS for tex in block.findall(text_of(path))]
    known = json.loads(text_of(DOCS / "hooks" / "formulas.json"))
    assert blocks and set(blocks) == set(known)
    assert all(mathml.count("<math ") == 1 and "error" not in mathml for mathml in known.values())


# ---- the site


class _Page(HTMLParser):
    """What a page asks for, links to, and can be linked to by."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.ids, self.links, self.loads, self.elements = path, set(), [], [], 0
        self.styled: set[tuple[str, str]] = set()  # what its colours depend on: elements with a class or a style
        self.feed(text_of(path))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.elements += 1
        self.styled |= {(tag, f"{given.get('style')} {word}") for word in (given.get("class") or "").split()}
        self.styled.add((tag, given.get("style") or ""))
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        elif tag in ("img", "script", "link", "iframe", "source"):
            self.loads += [given[name] for name in ("src", "href") if given.get(name)]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the built site; a warning fails the build."""
    folder = tmp_path_factory.mktemp("documentation") / "site"
    # The theme tells of its own future at every build; this is no warning of ours.
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert built.returncode == 0 and "WARNING" not in built.stderr, built.stderr[-4000:]
    return folder


@pytest.fixture(scope="module")
def pages(site) -> dict[Path, _Page]:
    # The page for what is not found names everything from the top of a server, and is left out.
    return {path: _Page(path) for path in sorted(site.resolve().rglob("*.html")) if path.name != "404.html"}


@pytest.mark.heavy
def test_every_document_has_a_page_and_every_page_its_place(site, pages):
    names = {str(path.relative_to(site.resolve())) for path in pages}
    assert {str(path.relative_to(DOCS).with_suffix(".html")) for path in DOCS.rglob("*.md")} <= names
    assert {"reference/commands.html", "reference/configuration.html", "reference/package/core.html"} <= names
    # What mkdocs.yml leaves out of the navigation nobody finds.
    assert yaml.safe_load(text_of(ROOT / "mkdocs.yml"))["validation"]["nav"]["omitted_files"] == "warn"


@pytest.mark.heavy
def test_no_page_loads_anything_from_elsewhere(site, pages):
    for page in pages.values():
        for target in page.loads:
            place = urlsplit(target)
            assert (not place.scheme and not place.netloc) or place.scheme == "data", f"{page.path.name}: {target}"
            assert (page.path.parent / unquote(place.path)).exists() or not place.path, f"{page.path.name}: {target}"
    for style in site.rglob("*.css"):
        assert not re.search(r"url\((?!['\"]?data:)['\"]?(https?:)?//", text_of(style)), style.name


@pytest.mark.heavy
def test_no_link_of_the_site_is_dead(site, pages):
    count = 0
    for page in pages.values():
        for link in page.links:
            place = urlsplit(link)
            if place.scheme or place.netloc:
                continue
            target = (page.path.parent / unquote(place.path)).resolve() if place.path else page.path
            target = target / "index.html" if target.is_dir() else target
            assert target.is_relative_to(site.resolve()) and target.exists(), f"{page.path.name}: {link}"
            if place.fragment and target.suffix == ".html":
                assert unquote(place.fragment) in pages[target].ids, f"{page.path.name}: {link}"
            count += 1
    assert count > 1000


@pytest.mark.heavy
def test_formulas_are_typeset_without_a_script(pages):
    found = {path: text_of(path) for path in pages}
    known = json.loads(text_of(DOCS / "hooks" / "formulas.json"))
    assert sum(text.count("<math ") for text in found.values()) >= len(known)
    assert not [name for name, text in found.items() if 'class="math"' in text or "katex-error" in text]


@pytest.mark.heavy
def test_the_reference_has_every_command_every_key_and_the_docstrings(site):
    from irodori.command_line import SUBCOMMANDS
    from irodori.config.validation import load_schema

    commands = text_of(site / "reference" / "commands.html")
    for name in SUBCOMMANDS:
        assert f'id="irodori-{name}"' in commands and f"usage: irodori {name}" in commands, name
    keys = text_of(site / "reference" / "configuration.html")
    for key in load_schema("scene")["properties"]:
        assert f"<code>{key}" in keys, key
    verdict = text_of(site / "reference" / "package" / "calibration.html")
    assert "irodori.calibration.verdict" in verdict and "Compare recovered reflectances with every tolerance" in verdict


@pytest.mark.heavy
@pytest.mark.skipif(browser_command() is None, reason="NO BROWSER: pages are not tested; install Debian's chromium")
def test_nothing_on_the_site_bars_anyone(site, pages, tmp_path):
    # Pages of the package are all made by one template: two stand for them.
    chosen = [path for path in pages if path.parent.name != "package" or path.stem in ("index", "colour")]
    assert len(chosen) > 25
    # Colours come from styles alone: of the pages, as many are looked at for contrast as have every styled element,
    # first those that have many for their length, for that is what looking takes.
    coloured, left = [], set().union(*(pages[path].styled for path in chosen))
    while left:
        coloured.append(max(chosen, key=lambda path: len(pages[path].styled & left) / pages[path].elements))
        left -= pages[coloured[-1]].styled
    assert violations(coloured) == {}
    assert violations([path for path in chosen if path not in coloured], contrast=False) == {}
    pale = tmp_path / "pale.html"
    pale.write_text("<html lang='en'><body><p style='color: #ccc; background: #fff'>pale</p></body></html>")
    assert "color-contrast" in str(violations([pale])) and "color-contrast" not in str(
        violations([pale], contrast=False)
    )
    bad = tmp_path / "bad.html"
    bad.write_text("<html><body><img src='x.png'></body></html>")
    assert "image-alt" in str(violations([bad]))
