"""XML from strangers: read with the standard library's parser, which fetches nothing, without document types.

Prefixes need not be bound, for nothing here looks at them: elements are told by their local names.
"""

from __future__ import annotations

from typing import BinaryIO
from xml.etree import ElementTree
from xml.parsers import expat

__all__ = ["gml_id", "link_of", "local_name", "xml_root"]


def xml_root(file: BinaryIO) -> ElementTree.Element:
    """The document's first element.

    Raises:
        ValueError: the XML is damaged, or has a document type, which may say the same thing a million times over.
    """
    builder = ElementTree.TreeBuilder()

    def refuse(*_: object) -> None:
        raise ValueError("a document type, where none is expected")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.ParseFile(file)
    except (expat.ExpatError, LookupError) as error:  # the latter: of encodings
        raise ValueError(str(error)) from error
    return builder.close()


def local_name(element: ElementTree.Element) -> str:
    """The element's name without its prefix."""
    return element.tag.rpartition(":")[2]


def gml_id(element: ElementTree.Element) -> str:
    """The element's id, empty where it has none."""
    return next((value for key, value in element.attrib.items() if key.rpartition(":")[2] == "id"), "")


def link_of(element: ElementTree.Element) -> str:
    """What the element's ``xlink:href`` names, empty where it has none."""
    return next((value for key, value in element.attrib.items() if key.rpartition(":")[2] == "href"), "").lstrip("#")
