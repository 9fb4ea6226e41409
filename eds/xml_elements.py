"""Untrusted XML as a tree of elements with their lines: no DTD, no entities, bounded size.

Elements of foreign namespaces are skipped, with their content.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler, feature_namespaces
from xml.sax.xmlreader import AttributesNSImpl

from defusedxml.common import DefusedXmlException
from defusedxml.expatreader import DefusedExpatParser

from coulombus.eds.description import EdsError

__all__ = ["XmlElement", "read_elements"]

MOST_ELEMENTS = 500_000
"""A drive of 3,000 objects has about 40,000: thirteen per object with its parameter."""
MOST_DEEP = 64
MOST_TEXT = 4000
"""Largest number of characters kept between an element's tags."""
REMEDY = "expected the XDD or XDC file (CiA 311) as the device's maker gives it"


@dataclass(slots=True)
class XmlElement:
    """An element by its local name, with the attributes that have no namespace.

    Attributes
    ----------
    space : URI of its namespace; empty: none
    line : of its start tag
    text : beginning of the text between its tags
    """

    name: str
    space: str
    line: int
    attributes: Mapping[str, str]
    children: list[XmlElement] = field(default_factory=list)
    text: str = ""

    def all(self, name: str) -> Iterator[XmlElement]:
        """Yield the elements of this name at any depth, in order."""
        for child in self.children:
            if child.name == name:
                yield child
            else:
                yield from child.all(name)

    def first(self, name: str) -> XmlElement | None:
        """Return the first element of this name at any depth, None if there is none."""
        return next(self.all(name), None)

    def children_named(self, name: str) -> list[XmlElement]:
        """Return the child elements of this name."""
        return [child for child in self.children if child.name == name]


class _Tree(ContentHandler):
    """Builds the tree from a parser's events.

    Attributes
    ----------
    open : elements whose end tag has not come
    passed : depth within an element of another namespace; 0: not in one
    """

    def __init__(self, path: str, parser: DefusedExpatParser) -> None:
        super().__init__()
        self.path, self.parser = path, parser
        self.root: XmlElement | None = None
        self.open: list[XmlElement] = []
        self.passed = self.count = 0

    @property
    def line(self) -> int:
        return max(1, self.parser.getLineNumber() or 1)

    def startElementNS(self, name: tuple[str | None, str], qname: str | None, attrs: AttributesNSImpl) -> None:
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise EdsError(f"{self.path}:{self.line}: has more than {MOST_ELEMENTS} elements; {REMEDY}")
        if len(self.open) + self.passed >= MOST_DEEP:
            raise EdsError(f"{self.path}:{self.line}: elements are nested more than {MOST_DEEP} deep; {REMEDY}")
        space, local = name[0] or "", name[1]
        if self.passed or (self.root is not None and space not in ("", self.root.space)):
            self.passed += 1
            return
        element = XmlElement(local, space, self.line, {key: text for (where, key), text in attrs.items() if not where})
        if self.root is None:
            self.root = element
        else:
            self.open[-1].children.append(element)
        self.open.append(element)

    def endElementNS(self, name: tuple[str | None, str], qname: str | None) -> None:
        if self.passed:
            self.passed -= 1
        else:
            self.open.pop()

    def characters(self, content: str) -> None:
        if not self.passed and len(self.open[-1].text) < MOST_TEXT:
            self.open[-1].text += content[:MOST_TEXT]


def read_elements(path: str, text: str) -> XmlElement:
    """Return the root element of a text; `path` names it in errors.

    Raises
    ------
    EdsError
        The text is not well-formed; it has a DTD or entities, which no XDD needs, and which can
        include other files or expand to gigabytes; it is larger or more deeply nested than a device
        description.
    """
    parser = DefusedExpatParser(forbid_dtd=True)
    tree = _Tree(path, parser)
    parser.setFeature(feature_namespaces, True)
    parser.setContentHandler(tree)
    try:
        parser.feed(text)
        parser.close()
    except SAXParseException as error:
        line = max(1, error.getLineNumber() or 1)
        raise EdsError(f"{path}:{line}: is not well-formed XML ({error.getMessage()}); {REMEDY}") from error
    except DefusedXmlException as error:
        raise EdsError(f"{path}:{tree.line}: declares a DTD or entities, which are not read; {REMEDY}") from error
    assert tree.root is not None  # otherwise it is not well-formed
    return tree.root
