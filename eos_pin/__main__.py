"""The command line as `python -m eos_pin`."""

import sys

from eos_pin.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
