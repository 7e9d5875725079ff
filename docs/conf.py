"""The documentation as a site that works offline: `python -m sphinx -W docs build/docs`, with the extra `docs`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import eos_pin

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

project, author, version = "eos_pin", "the authors of eos_pin", eos_pin.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
html_theme, html_title = "furo", f"eos_pin {version}"
html_static_path, html_css_files = ["static"], ["pages.css"]
html_show_copyright = False
exclude_patterns = ["_build"]
# Of the links to other sites only whether they answer is checked: `python -m sphinx -b linkcheck docs build/links`.
linkcheck_anchors = False
myst_heading_anchors = 3
# Text between single backquotes in docstrings is code.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_use_ivar = True
# A property that begins "Length [m]: …" is no reference to a class m.
suppress_warnings = ["ref.python"]

#: What each room of the public API is for, in the order of the pages.
ROOMS = {
    "robot": "Robots",
    "tasks": "Tasks",
    "trajectories": "Trajectories",
    "charts": "Charts",
    "control": "Control",
    "planning": "Planning",
    "simulation": "Simulation",
    "experiments": "Experiments",
    "viewer": "Viewer",
    "errors": "Errors",
}
PUBLIC = re.compile(r"^from \.(\w+) import (\w+) as", re.MULTILINE)


def write_reference(_app: Any = None) -> None:
    """Write a page for each room with everything public in it, from the list of public names."""
    folder = HERE / "reference"
    folder.mkdir(exist_ok=True)
    names: dict[str, list[str]] = {room: [] for room in ROOMS}
    for room, name in PUBLIC.findall((HERE.parent / "eos_pin" / "__init__.pyi").read_text(encoding="utf-8")):
        names[room].append(name)
    for room, title in ROOMS.items():
        lines = [title, "=" * len(title), ""]
        for name in names[room]:
            thing = getattr(eos_pin, name)
            kind = (
                "function" if not isinstance(thing, type) else "exception" if issubclass(thing, Exception) else "class"
            )
            lines += [f".. auto{kind}:: eos_pin.{name}", *(["   :members:"] if kind == "class" else [])]
            # Methods of a base that has no page of its own.
            lines += ["   :inherited-members:"] * (name == "Chart") + [""]
        page = folder / f"{room}.rst"
        text = "\n".join(lines)
        # An unchanged page is not built again.
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def escape(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Make plain text of docstrings what Sphinx reads: bars and stars are no markup, what is indented is code."""
    for i, line in enumerate(lines):
        # What follows a colon and an empty line with an indent is an example.
        if (
            line.endswith(":")
            and not "".join(lines[i + 1 : i + 2])
            and "".join(lines[i + 2 : i + 3]).startswith("    ")
        ):
            lines[i] = line + ":"
            continue
        parts = re.split(r"(`+[^`]+`+)", line)
        lines[i] = "".join(
            part if k % 2 else re.sub(r"([|*]|(?<=\w)_(?=\W|$))", r"\\\1", part) for k, part in enumerate(parts)
        )


def write_figures(app: Any) -> None:
    """Write the figures, and the explorer that the tutorial shows, where pages look for them."""
    from figures import explorer, figures

    figures()
    explorer(Path(app.outdir))


def setup(app: Any) -> None:
    """Connect the steps of the build."""
    app.connect("builder-inited", write_figures)
    app.connect("builder-inited", write_reference)
    app.connect("autodoc-process-docstring", escape, priority=400)
