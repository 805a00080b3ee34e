"""Pages from templates: escaped, complete, of one style, and whole or not at all."""

import re
from pathlib import Path

import pytest
from jinja2 import UndefinedError

import irodori.report
from irodori.report.html_page import fragment, write_page

TEMPLATES = Path(irodori.report.__file__).parent / "templates"
CASE = {"part": "A", "stage": "fit <b>", "case": "0 & 0", "expected": "refused", "tests": "1", "outcome": "as expected"}


def test_names_are_escaped_wherever_they_stand(tmp_path):
    write_page(tmp_path / "p.html", "stability.html.j2", rows=[CASE], expected="as expected")
    page = (tmp_path / "p.html").read_text()
    assert "fit &lt;b&gt; (part A)" in page and "<td>0 &amp; 0</td>" in page and "<b>" not in page
    table = fragment("time.html.j2", rules=[('"<i>"', 1, 2.0, 3.0)])
    assert "<td>&#34;&lt;i&gt;&#34;</td><td>1</td><td>2.0</td><td>3</td>" in table


def test_a_page_with_a_missing_figure_is_not_written(tmp_path):
    with pytest.raises(UndefinedError, match="expected"):
        write_page(tmp_path / "p.html", "stability.html.j2", rows=[CASE])
    assert not list(tmp_path.iterdir())


def test_an_unknown_number_is_a_dash():
    page = fragment("cameras.html.j2", cameras={"c": {"gain": [2.0 / 3.0, float("nan")], "hot pixels": 7}})
    assert "<td>0.6667, –</td>" in page and "<td>7</td>" in page


def test_a_measured_lens_is_reported_in_the_words_of_its_file():
    assert fragment("lenses.html.j2", lenses={}).strip() == ""
    page = fragment("lenses.html.j2", lenses={"eye": ["focal length 7.5 mm, 7.1 % more than <typed>"]})
    assert "The lens of eye" in page and "<li>focal length 7.5 mm, 7.1 % more than &lt;typed&gt;</li>" in page


def test_one_style_and_nothing_from_elsewhere():
    texts = {path.name: path.read_text() for path in TEMPLATES.iterdir()}
    assert [name for name, text in texts.items() if "<style" in text] == ["base.html.j2"]
    assert not [name for name, text in texts.items() if re.search(r"https?:|<script|<link|style=|\|\s*safe", text)]


def test_no_page_is_written_by_hand():
    package = Path(irodori.report.__file__).parents[1]
    tag = re.compile(r"</?(html|body|table|t[rdh]|h[1-6]|p|img|figure|details)\b[^a-z]*>")
    assert not [path for path in package.rglob("*.py") if tag.search(path.read_text())]
