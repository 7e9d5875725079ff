"""Compare the files of a wheel with those of the source tree.

    python .ci/check_wheel.py dist/eos_pin-….whl

Expected are all tracked files of `eos_pin/` and the robots, and of each source of a compiled module only what was made
of it.
"""

import subprocess
import sys
import zipfile
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

ROOT = Path(__file__).parent.parent
COMPILED_FROM = {".pyx", ".pxd"}


def expected() -> set[str]:
    """Names that the wheel must have, compiled modules without their suffixes."""
    listed = subprocess.check_output(["git", "ls-files", "eos_pin", "robots"], cwd=ROOT, text=True)
    names = set()
    for path in map(Path, listed.splitlines()):
        if path.suffix not in COMPILED_FROM:
            names.add(str(path if path.parts[0] == "eos_pin" else "eos_pin" / path))
        elif path.suffix == ".pyx":
            names.add(str(path.with_suffix("")))
    return names


def found(wheel: Path) -> set[str]:
    """Names that the wheel has, without its metadata and without the suffixes of compiled modules."""
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name and name[-1] != "/"}
    return {name.removesuffix(next((s for s in EXTENSION_SUFFIXES if name.endswith(s)), "")) for name in names}


def main() -> None:
    """Compare, print the differences, and exit with 1 if there are any."""
    wheel = Path(sys.argv[1])
    wrong = sorted(expected() ^ found(wheel))
    for name in wrong:
        print(f"{'missing from' if name in expected() else 'not expected in'} the wheel: {name}")
    if wrong:
        raise SystemExit(1)
    print(f"{wheel.name}: {len(found(wheel))} files, {wheel.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
