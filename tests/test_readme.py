"""What the README says is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import eos_pin
from eos_pin.cli.main import main

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


@pytest.mark.usefixtures("unchecked")
def test_python_examples_run_one_after_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = "\n".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    assert (tmp_path / "run.npz").exists()


def test_map_names_every_room_and_existing_modules() -> None:
    package = Path(eos_pin.__file__).parent
    table = README[README.index("## Where things are") :]
    rooms = {path.stem for path in package.iterdir() if path.is_dir() or path.suffix == ".py"}
    rooms = {room for room in rooms if not room.startswith("__")}
    named = set(re.findall(r"^\| (`.*?) \|", table, re.MULTILINE))
    assert {room for row in named for room in re.findall(r"`(\w+)`", row)} == rooms
    for room, modules in re.findall(r"^\| `(\w+)` \|.*\|(.*)\|$", table, re.MULTILINE):
        for module in re.findall(r"`(\w+)`", modules):
            assert list((package / room).glob(f"{module}.*")), f"{room}/{module} is on the map, but not in the package"


def test_commands_and_links_exist() -> None:
    listed = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    for command in set(re.findall(r"`eos-pin (\w+)", README + listed)):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_ci_runs_the_test_command_of_the_readme() -> None:
    (command,) = re.findall(r"^python3 -m venv .*pytest.*$", README, re.MULTILINE)
    assert ".[test]" in command
    pattern = re.search(r"grep -m1 -E '(.*?)' README.md", (ROOT / ".ci" / "run").read_text())
    assert pattern is not None
    assert re.match(pattern[1], command)


def test_version_is_one() -> None:
    assert f'version = "{eos_pin.__version__}"' in (ROOT / "pyproject.toml").read_text()
    assert f"version: {eos_pin.__version__}" in (ROOT / "CITATION.cff").read_text()
