"""A drawing on the page has the points and words of its file."""

import re
from xml.etree.ElementTree import fromstring

import numpy as np

from bench.reports import figures
from bench.reports.embedded import embed_svg


def points_of(root):
    """Colour and place of each point of the lines and markers of an SVG, or of its short form."""
    named = {}
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        if element.get("id"):
            named[f"#{element.get('id')}"] = element
    points = []
    for element in root.iter():
        link = next((v for k, v in element.attrib.items() if k.endswith("href")), "")
        path = named.get(link, element)
        if path.tag != "path" or f"#{element.get('id')}" in named:
            continue
        style = f"{element.get('style', '')}; {path.get('style', '')}"
        colour = re.findall(r"(?:stroke|fill): (#\w+)", style)[-1]
        x, y = (float(element.get(name, "0")) if link else 0.0 for name in "xy")
        at = [0.0, 0.0]
        for letter, rest in re.findall("([MLHVCQ])([^MLHVCQz]*)", path.get("d")):
            numbers = [float(n) for n in rest.split()]
            at = {"H": [numbers[0], at[1]], "V": [at[0], numbers[0]]}.get(letter, numbers[-2:])
            points.append((colour, at[0] + x, at[1] + y))
    return sorted(point for point in points if point[0] != "#ffffff")


def test_points_and_words_of_a_drawing(tmp_path):
    figure, axes = figures.new_figure((5, 3), title="a <b> & $1$")
    axes[0, 0].pcolormesh(np.arange(9.0).reshape(3, 3), cmap="Blues")
    for marker in ("|", "o", "^"):
        axes[0, 0].errorbar([0.5, 1.234567, 2], [1, 2, 0.3], yerr=0.25, fmt=marker, capsize=2)
    figures.write_svg(figure, tmp_path / "c.svg")
    text, styles = (tmp_path / "c.svg").read_text(encoding="utf-8"), {}
    short = embed_svg(text, 'all "of" it', styles)
    assert len(short) + len("".join(styles)) < len(text) / 2
    full, root = fromstring(text), fromstring(short)
    style_of = {name: style for style, name in styles.items()}
    for element in root.iter():  # its classes as styles again
        element.set("style", style_of.get(element.get("class"), ""))
    words = [e.text for e in full.iter() if e.tag.endswith("}text")]
    assert [e.text for e in root.iter("text")] == words
    assert root.get("aria-label") == 'all "of" it' and root.get("viewBox") == full.get("viewBox")
    before, after = points_of(full), points_of(root)
    assert [point[0] for point in before] == [point[0] for point in after] and len(before) > 60
    for colour in {point[0] for point in before}:
        ours, theirs = (
            np.array([p[1:] for p in points if p[0] == colour]) for points in (after, before)
        )
        assert max(np.hypot(*(theirs - place).T).min() for place in ours) < 0.15
        assert max(np.hypot(*(ours - place).T).min() for place in theirs) < 0.15
