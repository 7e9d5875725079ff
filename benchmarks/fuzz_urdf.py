"""Damaged URDF files by the thousand: each must load, or be refused by an `EosError`, quickly and in silence.

    python benchmarks/fuzz_urdf.py [--count N] [--first SEED] [--json FILE] [--keep FOLDER]

Real and bundled URDFs are mutated, by elements, attributes, numbers, names, bytes and encodings, with the traps of XML
among them. What still loads is used: mass matrix, a task, a chart, one control torque, and for some the shapes. Every
mutation is made from its seed alone, so a failure is repeated by `--first SEED --count 1`.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import copy
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import tyro
from confined import captured, time_limit
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError
from lxml import etree
from rich.progress import Progress

from eos_pin import ControlLoop, EosController, EosError, Hold, available_robots, load_robot
from eos_pin.cli import run
from eos_pin.presets import make_task
from eos_pin.report import console, figure, grid, stderr, write_json

SOURCES = (
    "ppr", "planar_chain_10", "panda", "ur5_robot", "ur5_joint_limited_robot", "kinova", "xarm7", "finger_edu", "z1",
    "so100", "talos_left_arm", "solo12", "double_pendulum_continuous", "iris", "pr2", "romeo_small", "a1",
    "anymal-kinova",
)  # fmt: skip
#: Nothing may take more processor time than this [s].
TIME_LIMIT = 5.0
#: Address space of a process; the libraries alone take one gigabyte of it [bytes].
MEMORY_LIMIT = 4 * 2**30
#: Mutations that one process does before it reports.
BATCH = 50
#: The shapes of one in this many robots are read; it takes a hundred times longer than all the rest.
SHAPES_EVERY = 25

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


@dataclass(frozen=True)
class Outcome:
    """What became of one mutated file.

    Attributes:
        seed: Seed it was made from.
        kind: `"loaded"`, the name of an `EosError`, or of what should not have happened.
        good: Whether that is allowed.
        seconds: Processor time it took.
        detail: Message or traceback.
    """

    seed: int
    kind: str
    good: bool
    seconds: float
    detail: str


# -- mutations ---------------------------------------------------------------------------------------------------


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


# -- trying ------------------------------------------------------------------------------------------------------


def attempt(seed: int, folder: Path) -> Outcome:
    """Load the mutation of a seed and use what loads."""
    path = folder / f"{os.getpid()}.urdf"
    path.write_bytes(mutated(seed))
    start = time.process_time()
    kind, good, detail = "loaded", True, ""
    with captured() as said, warnings.catch_warnings():
        warnings.simplefilter("error")
        # A mesh that cannot be read is left out with a warning.
        warnings.filterwarnings("ignore", message="left out meshes")
        try:
            with time_limit(8.0 * TIME_LIMIT):
                use(path, seed)
        except EosError as error:
            kind, detail = type(error).__name__, str(error)
            good = bool(detail)
        except Exception as error:
            kind, good, detail = type(error).__name__, False, traceback.format_exc()
    seconds = time.process_time() - start
    if said[0]:
        kind, good, detail = "said something on the terminal", False, said[0]
    if seconds > TIME_LIMIT:
        kind, good, detail = "too slow", False, f"{seconds:.1f} s, {kind} {detail}"
    return Outcome(seed, kind, good, seconds, detail)


def use(path: Path, seed: int) -> None:
    """Load a file and do with the robot what everybody does."""
    robot = load_robot(path, chain_to=("", "auto")[seed % 2])
    if seed % SHAPES_EVERY < 2:
        assert robot.visual is not None
        assert robot.collision is not None
    q = np.clip(np.full(robot.n, 0.1), robot.lower, robot.upper)
    assert np.isfinite(robot.mass(q)).all()
    assert np.isfinite(robot.bias(q, 0.1 * q)).all()
    task = make_task(robot)
    tau = ControlLoop(EosController(task, Hold(task.value(q), task.m))).step(0.0, q, 0.0 * q)
    assert np.isfinite(tau).all()


def batch(seeds: Sequence[int], folder: Path) -> tuple[list[Outcome], int]:
    """Outcomes of some seeds, in a process whose memory is limited; and the most memory that it has taken [bytes]."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_AS)[1]))
    done = []
    for seed in seeds:
        # A crash leaves behind who caused it.
        (folder / f"{os.getpid()}.seed").write_text(str(seed))
        done.append(attempt(seed, folder))
    (folder / f"{os.getpid()}.seed").unlink()
    return done, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def outcomes(seeds: Sequence[int], jobs: int) -> Iterator[tuple[list[Outcome], int]]:
    """All batches, as they are done; a crash of the interpreter is an outcome like any other."""
    batches = [seeds[i : i + BATCH] for i in range(0, len(seeds), BATCH)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            yield from Parallel(jobs, return_as="generator_unordered")(delayed(batch)(b, folder) for b in batches)
        except TerminatedWorkerError:
            crashed = [int(file.read_text()) for file in folder.glob("*.seed")]
            yield [Outcome(seed, "a process crashed here, or ran beside", False, 0.0, "") for seed in crashed], 0


def fuzz(
    *,
    count: int = 10_000,
    first: int = 0,
    jobs: int = 2,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    keep: Path | None = None,
) -> int:
    """Mutate URDFs, load them, and count what happens.

    Args:
        count: Number of mutations.
        first: Seed of the first.
        jobs: Processes.
        json_file: File for the figures, machine-readable.
        keep: Folder for the files that did what they should not.
    """
    start, memory = time.perf_counter(), 0
    done: list[Outcome] = []
    with Progress(console=stderr, transient=True) as progress:
        bar = progress.add_task("mutated URDFs", total=count)
        for some, peak in outcomes(range(first, first + count), jobs):
            done += some
            memory = max(memory, peak)
            progress.update(bar, advance=len(some))
    kinds = Counter((outcome.kind, outcome.good) for outcome in done)
    rows = []
    for (kind, good), number in sorted(kinds.items(), key=lambda item: (item[0][1], -item[1])):
        slowest = max((o.seconds, o.seed) for o in done if o.kind == kind)
        rows.append((kind, number, "allowed" if good else "WRONG", slowest[0], slowest[1]))
    console.print(grid(f"{len(done)} mutated URDFs", ("outcome", "how many", "", "slowest, s", "seed"), rows))
    seconds = time.perf_counter() - start
    console.print(f"most memory of a process {memory / 2**20:.0f} MB; {seconds:.0f} s in all")
    bad = sorted((outcome for outcome in done if not outcome.good), key=lambda outcome: outcome.seed)
    for outcome in bad[:20]:
        lines = outcome.detail.strip().splitlines()
        console.print(
            f"seed {outcome.seed}: {outcome.kind}: {lines[-1] if lines else ''}", markup=False, soft_wrap=True
        )
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        for outcome in bad:
            (keep / f"{outcome.seed}.urdf").write_bytes(mutated(outcome.seed))
            (keep / f"{outcome.seed}.txt").write_text(f"{outcome.kind}\n{outcome.detail}\n", encoding="utf-8")
    if json_file is not None:
        figures = {
            "count": len(done),
            "outcomes": {kind: number for (kind, _), number in kinds.items()},
            "wrong": [asdict(outcome) for outcome in bad],
            "slowest_seconds": max(outcome.seconds for outcome in done),
            "memory_bytes": memory,
            "seconds": seconds,
        }
        write_json(json_file, figures)
    complete = len(done) == count
    console.print(f"worst time {figure(max(o.seconds for o in done))} s; {len(bad)} wrong")
    return int(bool(bad) or not complete)


if __name__ == "__main__":
    sys.exit(run(fuzz))
