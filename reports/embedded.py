"""Drawings of matplotlib, shortened for the page: its SVG repeats styles, commands and digits."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element, fromstring, tostring

ROUNDED = ("x", "y", "transform", "width", "height")  # attributes with numbers in points
PAPER = "fill: #ffffff"  # of a path that the page shows through
CURVED = re.compile("[CQ]")  # commands of a marker that stays one


def embed_svg(text: str, about: str, styles: dict[str, str]) -> str:
    """An SVG as a part of a page, with a label; ``styles`` gets the class of each style."""
    root = fromstring(text)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # the page knows the namespaces
        element.attrib = {name.rpartition("}")[2]: value for name, value in element.attrib.items()}
        element.text, element.tail = (
            words if (words or "").strip() else None for words in (element.text, element.tail)
        )
    markers = {f"#{path.get('id')}": path for path in root.iter("path") if path.get("id")}
    inches, box = float(root.get("width", "0pt")[:-2]) / 72, root.get("viewBox", "")
    (root,) = _shorten_element(
        root, {key: path for key, path in markers.items() if not CURVED.search(path.get("d", ""))}
    )
    for element in root.iter():
        if style := element.attrib.pop("style", ""):
            element.set("class", styles.setdefault(style, f"s{len(styles)}"))
        for name in {*ROUNDED} & {*element.attrib}:
            element.set(
                name,
                re.sub(
                    r"-?\d+\.\d+",
                    lambda number: _round_points(float(number[0])),
                    element.attrib[name],
                ),
            )
    root.attrib = {
        "role": "img",
        "aria-label": about,
        "style": f"--inches: {inches:.2f}",
        "viewBox": box,
    }
    return tostring(root, "unicode").replace(" />", "/>")


def _shorten_element(element: Element, markers: dict[str, Element]) -> list[Element]:
    """What stands in the place of an element: it with fewer descendants, these, or nothing."""
    if "rotate(-0" in element.get("transform", ""):
        del element.attrib["transform"]
    if element.tag == "use" and (marker := markers.get(element.get("href", ""))) is not None:
        style = _style_rules(element) | _style_rules(marker)
        at = float(element.get("x", "0")), float(element.get("y", "0"))
        return [
            Element(
                "path",
                d=_shorten_path(marker.get("d", ""), *at),
                style="; ".join(f"{k}: {v}" for k, v in style.items()),
            )
        ]
    if element.tag == "path":
        if element.get("style") == PAPER or f"#{element.get('id')}" in markers:
            return []
        element.set("d", _shorten_path(element.get("d", "")))
    children = [new for child in element for new in _shorten_element(child, markers)]
    element[:] = (
        _join_paths(children) if all(child.tag == "path" for child in children) else children
    )
    grouping = element.tag in ("g", "defs") and (element.tag == "g" or not children)
    return (
        [*element]
        if grouping and not element.attrib and element.find("title") is None
        else [element]
    )


def _style_rules(element: Element) -> dict[str, str]:
    return dict(rule.split(": ", 1) for rule in element.get("style", "").split("; ") if rule)


def _join_paths(paths: list[Element]) -> list[Element]:
    """Paths of one drawn object that look alike as one path."""
    alike: dict[tuple, Element] = {}
    for path in paths:
        look = tuple((name, value) for name, value in path.attrib.items() if name != "d")
        if look in alike and not path.get("id"):
            alike[look].set("d", alike[look].get("d", "") + path.get("d", ""))
        else:
            alike[look] = path
    return [*alike.values()]


def _shorten_path(data: str, x: float = 0, y: float = 0) -> str:
    """A path moved by so much, with one number for each level or upright line."""
    made, before = "", ["", ""]
    for command, numbers in re.findall("([MLCQz])([^MLCQz]*)", data):
        place = [
            _round_points(float(number) + (y if i % 2 else x))
            for i, number in enumerate(numbers.split())
        ]
        if command == "L" and place != before and before[0] == place[0]:
            made += f"V{place[1]}"
        elif command == "L" and place != before and before[1] == place[1]:
            made += f"H{place[0]}"
        else:
            made += command + " ".join(place)
        before = place[-2:] or ["", ""]
    return made


def _round_points(number: float) -> str:
    """A number of points with three digits that count, or to a tenth."""
    text = f"{number:.{1 if abs(number) >= 10 else 2}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
