"""Safe parsing of untrusted XML, with the faults that parsers of other robot programs accept.

The parser resolves no entity, and opens no other file and no connection.
"""

from __future__ import annotations

import codecs
import re

from lxml import etree

from eos_pin.errors import RobotError
from eos_pin.robot.notes import Notes

_SAFE = {
    "resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False,
    "remove_comments": True, "remove_pis": True,
}  # fmt: skip
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_DECLARATION = re.compile(r"[\s\ufeff]*<\?xml\s.*?\?>", re.DOTALL)
_ENCODING = re.compile(rb"^[\s\xef\xbb\xbf]*<\?xml\s[^>]*?encoding\s*=\s*[\"']([\w.-]+)")


def parse(name: str, content: bytes, notes: Notes) -> etree._Element:
    """Root element of a document.

    A document that is not well-formed is read once more without its XML declaration, blank lines before it, and
    comments: these are what other parsers do not look at.

    Args:
        name: Its name in messages.
        content: The document.
        notes: Where to take down what had to be passed over.

    Raises:
        RobotError: It is not well-formed even so, or has a document type.
    """
    try:
        root = _root(content)
    except etree.XMLSyntaxError as error:
        text, passed = _lenient(content)
        try:
            if not passed:
                raise error
            root = _root(text)
        except etree.XMLSyntaxError as last:
            raise RobotError(f"{name} line {last.lineno}: not well-formed XML: {last.msg}") from last
        notes.add(f"not quite XML, but read: {', '.join(passed)}")
    if root.getroottree().docinfo.doctype:
        raise RobotError(
            f"{name} has a <!DOCTYPE>, which can define entities and pull in other files; eos_pin refuses it. "
            "A URDF needs none: remove it"
        )
    return root


def text_of(name: str, content: bytes) -> str:
    """The text of a document, by its byte order mark, its declaration, or as UTF-8.

    Raises:
        RobotError: It is not in the encoding it states.
    """
    stated = _ENCODING.match(content)
    encoding = stated[1].decode() if stated else "utf-8"
    encoding = next((code for mark, code in _MARKS.items() if content.startswith(mark)), encoding)
    try:
        return content.decode(encoding)
    except (LookupError, ValueError) as error:
        raise RobotError(f"{name} is not text in the encoding {encoding}: {error}") from error


def undeclared(text: str) -> str:
    """The text without its XML declaration, which does not apply to text; lines keep their numbers."""
    found = _DECLARATION.match(text)
    return "\n" * found[0].count("\n") + text[found.end() :] if found else text


def _root(content: bytes) -> etree._Element:
    parser = etree.XMLParser(**_SAFE)
    try:
        return etree.fromstring(content, parser)
    except etree.XMLSyntaxError:
        # Plugins of simulators use prefixes nobody declares; those parts are of no interest here.
        if any(problem.type_name != "NS_ERR_UNDEFINED_NAMESPACE" for problem in parser.error_log):
            raise
        return etree.fromstring(content, etree.XMLParser(**_SAFE, recover=True))


def _lenient(content: bytes) -> tuple[bytes, list[str]]:
    """The document without parts that other parsers ignore, and notes about them; lines keep their numbers."""
    try:
        text = text_of("", content)
    except RobotError:
        return content, []
    passed = []
    bare = undeclared(text)
    if bare != text:
        passed.append("the XML declaration")
    start = len(bare) - len(bare.lstrip("\ufeff \t\r\n"))
    if "\ufeff" in bare[:start]:
        passed.append("a byte order mark that is not at the start")
        bare = bare[:start].replace("\ufeff", "") + bare[start:]
    parts, here = [], 0
    # Not by a regular expression: it would begin anew at every comment that is never closed.
    while (begin := bare.find("<!--", here)) >= 0 and (end := bare.find("-->", begin + 4)) >= 0:
        parts += [bare[here:begin], "\n" * bare.count("\n", begin, end)]
        if "--" in bare[begin + 4 : end] or bare[end - 1] == "-":
            passed = [*passed, "comments with --"] if "comments with --" not in passed else passed
        here = end + 3
    return "".join([*parts, bare[here:]]).encode(errors="replace"), passed
