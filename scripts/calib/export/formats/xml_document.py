"""Render XML documents with comments."""

import re
from collections.abc import Iterable
from xml.etree import ElementTree


def render_xml_document(root: ElementTree.Element, lines: Iterable[str]) -> str:
    """Render an XML document with comment lines at its top."""
    # Two hyphens would end a comment.
    comments = [re.sub("-(?=-)", "- ", " ".join(line.split())) for line in lines]
    ElementTree.indent(root)
    head = "".join(f"<!-- {comment} -->\n" for comment in comments)
    return f'<?xml version="1.0"?>\n{head}{ElementTree.tostring(root, encoding="unicode")}\n'
