"""Environments for the libraries that eos_pin is compared with.

    python benchmarks/peers.py setup [NAME ...]     one virtual environment a peer, below .peers/
    python benchmarks/peers.py list                 which are there, in which versions, and why others are not

Each peer gets an environment of its own, because their demands on NumPy and Pinocchio contradict each other. One that
does not install is reported and left out.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from eos_pin.cli.main import run
from eos_pin.cli.output import console, stderr
from eos_pin.errors import InputError

#: Where the environments are, in the checkout and ignored by git.
FOLDER = Path(__file__).resolve().parent.parent / ".peers"
#: The scripts that run inside them.
WORKERS = Path(__file__).resolve().parent / "peers_workers"
#: One installation may take so long, for some are built from source [s].
PATIENCE = 3600.0

#: Asks an environment for the versions of what is named on its command line.
_VERSIONS = (
    "import json, sys; from importlib.metadata import version; print(json.dumps({n: version(n) for n in sys.argv[1:]}))"
)


@dataclass(frozen=True)
class Peer:
    """A library to compare with.

    Attributes:
        name: What it is called in tables.
        packages: What pip installs, the library itself first.
        module: What must import.
        does: What it solves, in a few words.
    """

    name: str
    packages: tuple[str, ...]
    module: str
    does: str

    @property
    def key(self) -> str:
        """Name on the command line, of its folder and in its worker's file name."""
        return self.name.lower().replace(" ", "_")

    @property
    def folder(self) -> Path:
        """Its environment."""
        return FOLDER / self.key

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")

    @property
    def worker(self) -> Path:
        """The script that measures it."""
        return WORKERS / f"with_{self.key}.py"

    @property
    def trouble(self) -> Path:
        """File that says why it did not install."""
        return FOLDER / f"{self.key}.txt"


PEERS: Mapping[str, Peer] = {
    peer.key: peer
    for peer in (
        Peer("Pink", ("pin-pink", "daqp", "qpsolvers", "numpy"), "pink", "differential IK as a QP, on Pinocchio"),
        # The last TSID that comes as a whole from PyPI, with the Pinocchio it was built with; later ones are not.
        Peer(
            "TSID",
            ("tsid==1.7.1", "pin==3.4.0", "cmeel-urdfdom<5", "cmeel-tinyxml2<11"),
            "tsid",
            "inverse dynamics as a QP, in C++ on Pinocchio",
        ),
        Peer("PlaCo", ("placo", "numpy"), "placo", "IK and inverse dynamics as QPs, in C++ on Pinocchio"),
        Peer("mink", ("mink", "mujoco", "daqp", "qpsolvers", "numpy"), "mink", "differential IK as a QP, on MuJoCo"),
        Peer("Drake", ("drake", "numpy"), "pydrake", "IK as a nonlinear program, differential IK as a QP, in C++"),
        Peer("Robotics Toolbox", ("roboticstoolbox-python", "numpy"), "roboticstoolbox", "numerical IK in C++"),
    )
}

#: Those that other scripts than `run.py` compare with.
OTHERS: Mapping[str, Peer] = {
    peer.key: peer
    for peer in (
        Peer("ssik", ("ssik", "urchin", "numpy"), "ssik", "closed-form IK and self-motion of some arms"),
        Peer("roboplan", ("roboplan", "numpy"), "roboplan.cartesian_planning", "local Cartesian planning on Pinocchio"),
        Peer("tesseract", ("tesseract-robotics", "numpy"), "tesseract_robotics", "Descartes, a ladder graph"),
    )
}


def installed(peer: Peer) -> dict[str, str] | str:
    """Versions of what is in a peer's environment, or why it cannot be used."""
    if not peer.python.exists():
        return peer.trouble.read_text().strip() if peer.trouble.exists() else "not set up"
    try:
        done = _said(
            [str(peer.python), "-c", f"import {peer.module}\n{_VERSIONS}", *map(bare_name, peer.packages)], 120.0
        )
        versions: dict[str, str] = json.loads(done.splitlines()[-1])
    except (subprocess.SubprocessError, OSError, ValueError) as error:
        return _reason(error)
    return versions


def install(peer: Peer, say: Callable[[str], None] = lambda text: None) -> dict[str, str] | str:
    """Make a peer's environment anew.

    Args:
        peer: The peer.
        say: Told what is going on.

    Returns:
        The versions that were installed, or why it did not work.
    """
    FOLDER.mkdir(exist_ok=True)
    shutil.rmtree(peer.folder, ignore_errors=True)
    peer.trouble.unlink(missing_ok=True)
    try:
        say("making an environment")
        venv.create(peer.folder, with_pip=True)
        say("installing " + " ".join(peer.packages))
        quiet = ["-q", "--disable-pip-version-check", "--no-input"]
        _said([str(peer.python), "-m", "pip", "install", *quiet, *peer.packages], PATIENCE)
    except (subprocess.SubprocessError, OSError) as error:
        peer.trouble.write_text(_reason(error) + "\n")
        shutil.rmtree(peer.folder, ignore_errors=True)
    return installed(peer)


def bare_name(requirement: str) -> str:
    """Name of a package without the versions that are wanted."""
    return re.split(r"[<>=~!]", requirement)[0]


def _said(command: list[str], seconds: float) -> str:
    """What a command writes on stdout."""
    return subprocess.run(command, check=True, timeout=seconds, capture_output=True, text=True).stdout


def _reason(error: Exception) -> str:
    """The one line that says why something failed."""
    said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
    lines = [line.strip() for line in (said or str(error)).splitlines() if line.strip()]
    errors = [line for line in lines if line.lower().startswith("error")]
    return (errors or lines or [type(error).__name__])[-1]


def peers(
    command: Annotated[Literal["setup", "list"], tyro.conf.Positional],
    names: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
) -> int:
    """Set up or list the environments of the peers.

    Args:
        command: Make environments anew, or say what is in them.
        names: Which peers; all of them by default.
    """
    known = {**PEERS, **OTHERS}
    unknown = sorted({*names} - {*known})
    if unknown:
        raise InputError(f"no peer {unknown[0]!r}; there are {', '.join(known)}")
    chosen = [known[name] for name in names or known]
    rows = []
    with Progress(
        SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=stderr, transient=True
    ) as progress:
        for peer in chosen:
            bar = progress.add_task(peer.name)

            def say(text: str, bar: object = bar, name: str = peer.name) -> None:
                progress.update(bar, description=f"{name}: {text}")  # type: ignore[arg-type]

            found = install(peer, say) if command == "setup" else installed(peer)
            progress.remove_task(bar)
            what = found if isinstance(found, str) else ", ".join(f"{n} {v}" for n, v in found.items())
            rows.append((peer, what))
    for peer, what in rows:
        console.print(f"[bold]{peer.key}[/] ({peer.does}): {escape(what)}", soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(run(peers))
