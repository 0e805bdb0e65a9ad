"""XML with comments, as ElementTree writes it."""

from xml.etree import ElementTree


def render_xml_document(root, lines):
    """Text of an XML document with comment lines on its top."""
    # Two hyphens would end a comment.
    about = [" ".join(line.split()).replace("--", "- -") for line in lines]
    ElementTree.indent(root)
    head = "".join(f"<!-- {line} -->\n" for line in about)
    return f'<?xml version="1.0"?>\n{head}{ElementTree.tostring(root, encoding="unicode")}\n'
