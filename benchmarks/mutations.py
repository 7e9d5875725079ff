"""URDF files damaged in a way that depends on a seed only: elements, attributes, numbers, names, bytes, encodings."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Sequence
from typing import TypeAlias

from lxml import etree

from eos_pin import available_robots

SOURCES = (
    "ppr", "planar_chain_10", "panda", "ur5_robot", "ur5_joint_limited_robot", "kinova", "xarm7", "finger_edu", "z1",
    "so100", "talos_left_arm", "solo12", "double_pendulum_continuous", "iris", "pr2", "romeo_small", "a1",
    "anymal-kinova",
)  # fmt: skip
#: What may stand in an attribute instead of what did.
ODD_NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e30", "9e29", "1e-320", "0", "-0", "-1", "1", "3.2", "1,5",
    "0x10", "1_000", "１２", "٣", "", " ", "one", "1 2", "1 2 3 4", "0 0 0", "nan nan nan", "1e200 1e200 1e200",
    "1e16 0 0", "9" * 5000,
)  # fmt: skip
ODD_WORDS = (
    "", " ", "fixed", "floating", "planar", "continuous", "prismatic", "revolute", "screw", "universe", "root_joint",
    "world", "ä 手", "a" * 5000, "../../../../etc/passwd", "/dev/zero", "file:///etc/passwd", "http://localhost:1/x",
    "package://", "package://a/../b.stl", "${x}", "$(find x)", "%s%n{}", "\u202e", "&amp;", "'\"",
)  # fmt: skip
TAGS = (
    "robot", "link", "joint", "inertial", "mass", "inertia", "origin", "axis", "limit", "mimic", "dynamics", "visual",
    "collision", "geometry", "mesh", "box", "sphere", "cylinder", "material", "texture", "transmission", "gazebo",
    "xacro", "capsule", "parent", "child",
)  # fmt: skip
PROLOGUES = (
    '<!DOCTYPE robot [<!ENTITY a "b">]>', '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    '<!DOCTYPE r [<!ENTITY % x SYSTEM "http://localhost:1/x"> %x;]>', '<?xml version="1.1"?>',
    '<?xml version="1.0" encoding="utf-7"?>', '<?xml version="1.0" encoding="ebcdic"?>', "<!-- -->", "<?php ?>",
    "\ufeff", "\0", "]]>", "&lol;",
)  # fmt: skip

Element: TypeAlias = etree._Element


def _source(name: str) -> bytes:
    return next(robot.path for robot in available_robots() if robot.name == name).read_bytes()


def mutated(seed: int) -> bytes:
    """A damaged URDF, the same one for the same seed."""
    rng = random.Random(seed)
    content = _source(rng.choice(SOURCES))
    root = etree.fromstring(content, etree.XMLParser(recover=True, remove_comments=True))
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3, 5))):
        rng.choice(ON_ELEMENTS)(rng, root)
    content = etree.tostring(root)
    for _ in range(rng.choice((0, 0, 0, 1, 1, 3))):
        content = rng.choice(ON_BYTES)(rng, content)
    return content


def _some(rng: random.Random, root: Element) -> Element:
    """An element; one tag is as likely as any other, so that the many shapes do not hide the few joints."""
    elements = [element for element in root.iter(etree.Element) if element is not root] or [root]
    tag = rng.choice(sorted({element.tag for element in elements}))
    return rng.choice([element for element in elements if element.tag == tag])


def _attribute(rng: random.Random, root: Element) -> tuple[Element, str]:
    for _ in range(50):
        element = _some(rng, root)
        if element.attrib:
            return element, rng.choice(sorted(element.attrib))
    return root, "name"


def _delete(rng: random.Random, root: Element) -> None:
    element = _some(rng, root)
    if element.getparent() is not None:
        element.getparent().remove(element)


def _duplicate(rng: random.Random, root: Element) -> None:
    element = _some(rng, root)
    if element.getparent() is not None:
        for _ in range(rng.choice((1, 1, 1, 2, 200))):
            element.addnext(copy.deepcopy(element))


def _move(rng: random.Random, root: Element) -> None:
    element, target = _some(rng, root), _some(rng, root)
    if target is not element and element not in target.iterancestors() and element is not root:
        target.append(element)


def _rename_tag(rng: random.Random, root: Element) -> None:
    _some(rng, root).tag = rng.choice(TAGS)


def _delete_attribute(rng: random.Random, root: Element) -> None:
    element, key = _attribute(rng, root)
    element.attrib.pop(key, None)


def _rename_attribute(rng: random.Random, root: Element) -> None:
    element, key = _attribute(rng, root)
    element.set(rng.choice(("name", "link", "value", "xyz", "type", "lower", "x")), element.attrib.pop(key, ""))


def _odd_number(rng: random.Random, root: Element) -> None:
    element, key = _attribute(rng, root)
    parts = element.get(key, "").split() or [""]
    # Instead of one number of several, or of all.
    parts[rng.randrange(len(parts))] = rng.choice(ODD_NUMBERS)
    element.set(key, " ".join(parts) if rng.random() < 0.7 else rng.choice(ODD_NUMBERS))


def _odd_word(rng: random.Random, root: Element) -> None:
    element, key = _attribute(rng, root)
    element.set(key, rng.choice(ODD_WORDS))


def _swap_values(rng: random.Random, root: Element) -> None:
    (one, a), (two, b) = _attribute(rng, root), _attribute(rng, root)
    first, second = one.get(a, ""), two.get(b, "")
    one.set(a, second)
    two.set(b, first)


def _rewire(rng: random.Random, root: Element) -> None:
    """Hang a joint elsewhere: loops, second parents, second roots."""
    ends = [end for joint in root.findall("joint") for end in joint if end.tag in ("parent", "child")]
    links = [link.get("name", "") for link in root.findall("link")]
    if ends and links:
        rng.choice(ends).set("link", rng.choice(links))


def _mimic(rng: random.Random, root: Element) -> None:
    joints = root.findall("joint")
    if joints:
        etree.SubElement(rng.choice(joints), "mimic", joint=rng.choice(joints).get("name", ""), multiplier="nan")


def _nest(rng: random.Random, root: Element) -> None:
    element = _some(rng, root)
    for _ in range(rng.choice((3, 200, 300, 5000))):
        element = etree.SubElement(element, rng.choice(("link", "a")))


def _crowd(rng: random.Random, root: Element) -> None:
    """Very many links, in a row or beside each other, moving or not."""
    count, in_a_row = rng.choice((100, 300, 3000)), rng.random() < 0.5
    kind = rng.choice(("fixed", "revolute", "continuous"))
    links = root.findall("link")
    parent = rng.choice(links).get("name", "") if links else "x"
    for i in range(count):
        etree.SubElement(root, "link", name=f"crowd{i}")
        joint = etree.SubElement(root, "joint", name=f"crowd_joint{i}", type=kind)
        etree.SubElement(joint, "parent", link=parent)
        etree.SubElement(joint, "child", link=f"crowd{i}")
        etree.SubElement(joint, "limit", lower="-1", upper="1", effort="1", velocity="1")
        if in_a_row:
            parent = f"crowd{i}"


def _weightless(rng: random.Random, root: Element) -> None:
    for inertial in list(root.iter("inertial")):
        if rng.random() < 0.7:
            inertial.getparent().remove(inertial)


def _scale_numbers(rng: random.Random, root: Element) -> None:
    """One attribute of all elements of a kind, by a factor: heavy, tiny, negative."""
    element, key = _attribute(rng, root)
    factor = rng.choice((1e150, 1e15, 1e-15, 1e-160, -1.0, 0.0))
    for other in root.iter(element.tag):
        try:
            other.set(key, " ".join(str(factor * float(part)) for part in other.get(key, "").split()))
        except ValueError:
            continue


def _truncate(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _flip(rng: random.Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 3, 50)) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content) + 1)
    return content[:start] + content[start + rng.choice((1, 5, 60, 2000)) :]


def _insert(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content) + 1)
    piece = rng.choice(
        (*PROLOGUES, *ODD_NUMBERS, "<", ">", '"', "/>", "</robot>", "<![CDATA[", "x:y", "\x80", "&#0;", "&#x110000;")
    )
    return content[:start] + piece.encode("utf-8", "surrogatepass") + content[start:]


def _repeat(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content) + 1)
    piece = content[start : start + rng.choice((10, 200, 5000))]
    return content[:start] + piece * rng.choice((2, 2, 30)) + content[start:]


def _prologue(rng: random.Random, content: bytes) -> bytes:
    return rng.choice(PROLOGUES).encode("utf-8") + content


def _bomb(rng: random.Random, content: bytes) -> bytes:
    """Entities that grow tenfold with each level, used in a text or an attribute."""
    grown = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(rng.choice((2, 9))))
    place = rng.choice(('<robot name="&e2;">', '<robot name="r">&e2;'))
    return f'<!DOCTYPE r [<!ENTITY e0 "aaaaaaaaaa">{grown}]>{place}'.encode() + content.partition(b">")[2]


def _recode(rng: random.Random, content: bytes) -> bytes:
    text = content.decode("utf-8", "replace")
    return text.encode(rng.choice(("utf-16", "utf-16-le", "utf-32", "latin-1", "cp037", "utf-7")), "replace")


ON_ELEMENTS: Sequence[Callable[[random.Random, Element], None]] = (
    _delete, _delete, _duplicate, _move, _rename_tag, _delete_attribute, _rename_attribute, _odd_number, _odd_number,
    _odd_number, _odd_word, _odd_word, _swap_values, _rewire, _mimic, _nest, _crowd, _weightless, _scale_numbers,
)  # fmt: skip
ON_BYTES: Sequence[Callable[[random.Random, bytes], bytes]] = (
    _truncate, _flip, _flip, _cut, _insert, _repeat, _prologue, _bomb, _recode,
)  # fmt: skip
