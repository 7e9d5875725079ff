"""The command line as `python -m eos_pin`, and as `eos-pin`."""

from __future__ import annotations

import os
import signal
import sys


def main() -> int:
    """Run the command line; Ctrl-C outside of its command, while modules are imported, ends the process with code 130.

    What is ignored stays ignored, such as Ctrl-C in a job in the background.
    """
    hears = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if hears:
        signal.signal(signal.SIGINT, _leave)
    # Imported here: a package that is interrupted while it is imported shows a traceback, or takes it for a missing
    # dependency.
    from eos_pin.cli.main import main as command

    try:
        if hears:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return command()
    except KeyboardInterrupt:
        _leave()
        return 130
    finally:
        sys.stdout.flush()
        if hears:
            signal.signal(signal.SIGINT, _leave)


def _leave(*_: object) -> None:
    os.write(2, b"Interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
