"""The command line: `eos-pin`, and the `run` that every script shares."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version

import tyro

# What the commands need beyond their options is imported where it is used, so that `eos-pin --help` is quick.
from eos_pin.cli.analyze import analyze
from eos_pin.cli.arguments import STYLE, Registry, worded
from eos_pin.cli.demo import demo
from eos_pin.cli.explore import explore
from eos_pin.cli.ik import ik
from eos_pin.cli.info import info
from eos_pin.cli.many.bench import bench
from eos_pin.cli.many.sweep import sweep
from eos_pin.cli.output import console, guarded
from eos_pin.cli.plan import plan
from eos_pin.cli.rehearse import rehearse
from eos_pin.cli.replay import replay, robots
from eos_pin.cli.selfmotion import selfmotion
from eos_pin.cli.track import compare, track
from eos_pin.errors import OldNameError


def run(command: Callable[..., int], argv: Sequence[str] | None = None) -> int:
    """Parse arguments, run a command, and turn errors into one paragraph and an exit code.

    Returns:
        0, 1 for a run that failed, 2 for bad input, 130 for an interrupt.
    """

    def parsed() -> int:
        with Registry():
            return tyro.cli(worded(command), args=argv, config=STYLE)

    return guarded(parsed)


def main(argv: Sequence[str] | None = None) -> int:
    """The command `eos-pin`."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words == ["--version"]:
        console.print(f"eos-pin {version('eos-pin')}")
        return 0
    listed = (
        demo,
        explore,
        track,
        plan,
        compare,
        sweep,
        bench,
        rehearse,
        analyze,
        info,
        ik,
        selfmotion,
        replay,
        robots,
    )
    commands = {f.__name__: worded(f) for f in (*listed, robots)}

    def command() -> int:
        _refuse_old_flags(words)
        with Registry():
            return tyro.extras.subcommand_cli_from_dict(
                commands,
                prog="eos-pin",
                description="Extended operational space control of redundant robots, on any URDF.",
                args=argv,
                config=(*STYLE, tyro.conf.PositionalRequiredArgs),
            )

    return guarded(command)


#: Flags of earlier versions, and those that took their place.
_OLD_FLAGS = {"--rate": "--control-rate"}


def _refuse_old_flags(words: Sequence[str]) -> None:
    """Refuse a flag that was renamed.

    Raises:
        OldNameError: There is one; the message has the new one.
    """
    for word in words:
        flag = word.partition("=")[0]
        if flag in _OLD_FLAGS:
            raise OldNameError(f"the option {flag} was renamed: use {_OLD_FLAGS[flag]}")


if __name__ == "__main__":
    sys.exit(main())
