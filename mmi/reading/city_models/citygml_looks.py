"""What CityGML says about the looks of surfaces: pictures and colours, by the ids of polygons and rings.

Source: OGC City Geography Markup Language 2.0 (12-019), section 9.4.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mmi.reading.city_models.faces import Color
from mmi.reading.pictures import PictureShelf, file_beside
from mmi.reading.report import Ledger
from mmi.reading.xml_elements import local_name

__all__ = ["Look", "read_looks"]

Look = tuple[int | None, dict[str, list[float]], Color | None]
"""A polygon's picture, texture coordinates by ring id, and colour."""


def read_looks(path: Path, root: ElementTree.Element, ledger: Ledger) -> tuple[dict[str, Look], PictureShelf]:
    """What pictures and materials say, by polygon id. The first picture counts, and a picture more than a colour."""
    shelf = PictureShelf(ledger)
    looks: dict[str, Look] = {}
    places: dict[str, int | None] = {}
    for element in root.iter():
        kind = local_name(element)
        if kind == "ParameterizedTexture":
            image = next((one.text or "" for one in element if local_name(one) == "imageURI"), "").strip()
            if image not in places:
                file = file_beside(path.parent, image, ledger)
                places[image] = None if file is None else shelf.place_file(file, image, alpha=True)
                if file is None:
                    ledger.note("left out", "picture: it is not there", image)
            for target in (one for one in element if local_name(one) == "target"):
                uri = next((value for key, value in target.attrib.items() if key.endswith("uri")), "").lstrip("#")
                coordinates = _coordinates(target, uri, ledger)
                if places[image] is not None and coordinates and looks.get(uri, (None,))[0] is None:
                    looks[uri] = (places[image], coordinates, None)
        elif kind == "X3DMaterial":
            targets = [(one.text or "").strip().lstrip("#") for one in element if local_name(one) == "target"]
            color = _color(next((one.text or "" for one in element if local_name(one) == "diffuseColor"), ""))
            if color is None:
                ledger.note("left out", "colour: not three numbers", next(iter(targets), None))
            for name in targets if color is not None else ():
                looks.setdefault(name, (None, {}, color))
    return looks, shelf


def _coordinates(target: ElementTree.Element, uri: str, ledger: Ledger) -> dict[str, list[float]]:
    """Texture coordinates by ring id; none, and a note, where they are no numbers."""
    try:
        return {
            one.attrib.get("ring", "").lstrip("#"): [float(word) for word in (one.text or "").split()]
            for one in target.iter()
            if local_name(one) == "textureCoordinates"
        }
    except ValueError:
        ledger.note("left out", "face: texture coordinates that are no numbers", uri)
        return {}


def _color(text: str) -> Color | None:
    """sRGB bytes of three numbers in [0, 1]; a light grey where nothing is said, None where it is something else."""
    try:
        parts = [float(word) for word in (text or "0.8 0.8 0.8").split()][:3]
    except ValueError:
        return None
    if len(parts) < 3 or not np.isfinite(parts).all():
        return None
    red, green, blue = (round(255 * min(max(one, 0.0), 1.0)) for one in parts)
    return red, green, blue
