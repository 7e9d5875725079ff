"""The command line as `python -m eos_pin`, and as `eos-pin`."""

from __future__ import annotations

import os
import signal
import sys


def main() -> int:
    """Run the command line; Ctrl-C while its modules are imported ends the process at once, with code 130."""
    before = signal.signal(signal.SIGINT, _leave)
    # Imported here: a package that is interrupted while it is imported shows a traceback, or takes it for a missing
    # dependency.
    from eos_pin.cli.main import main as command

    signal.signal(signal.SIGINT, before)
    return command()


def _leave(*_: object) -> None:
    os.write(2, b"Interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
