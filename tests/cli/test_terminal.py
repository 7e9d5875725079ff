"""Output in encodings that lack letters: it is spelled in what they have, is laid out by that, and never fails."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest

from eos_pin.cli.output import Terminal, grid
from eos_pin.cli.terminal import SPELLED, shown, spell, spell_output

ARM = (
    '<robot name="Räuber [機]"><link name="основа"/>'
    + "".join(
        f'<link name="l{i}"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial></link>'
        f'<joint name="关节{i}" type="revolute"><parent link="{f"l{i - 1}" if i > 1 else "основа"}"/>'
        f'<child link="l{i}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{axis}"/><limit lower="-2" upper="2" effort="90" velocity="2"/></joint>'
        for i, axis in enumerate(("0 0 1", "0 1 0", "1 0 0", "0 1 0"), 1)
    )
    + '<link name="tip"/><joint name="tip" type="fixed"><parent link="l4"/><child link="tip"/><origin xyz="0 0 0.3"/>'
    "</joint></robot>"
)


def test_shown_keeps_characters_of_the_encoding():
    for text, encoding in (("Räuber ²", "cp1252"), ("关节 → ─", "utf-8"), ("plain", "ascii"), ("关节", "utf-16")):
        assert shown(text, encoding) == text


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("Räuber", "Rauber"),
        ("m/s², ∂T/∂q → 0 … ±π", "m/s^2, dT/dq -> 0 ... +-pi"),
        ("─━│┃┌┐└┘├┼╭╯╴", "--||+++++++++"[:13]),
        ("关节1", "\\u5173\\u82821"),
        ("😀", "\\U0001f600"),
    ],
)
def test_shown_spells_characters_missing_in_ascii(text, wanted):
    assert shown(text, "ascii") == spell(text) == wanted
    assert wanted.isascii()


def test_bytes_of_a_file_name_pass_as_they_came():
    name = b"r\xe4u\xffber".decode("utf-8", "surrogateescape")
    for encoding in ("utf-8", "ascii", "cp1252"):
        assert f"→{name}".encode(encoding, SPELLED)[-8:].endswith(b"r\xe4u\xffber")
    assert name.encode("utf-16", SPELLED)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_tables_are_laid_out_by_the_text_shown(encoding, monkeypatch):
    monkeypatch.setattr(Terminal, "encoding", encoding)
    stream = io.TextIOWrapper(io.BytesIO(), encoding, SPELLED)
    terminal = Terminal(file=stream, width=70, highlight=False, emoji=False)
    terminal.print(grid("a [title]", ("joint", "value"), [("关节1", 1.0), ("arm[left]", 2.5), ("[/x] :smile:", 3.0)]))
    stream.flush()
    lines = stream.buffer.getvalue().decode(encoding).splitlines()
    assert "a [title]" in lines[0]
    names = [shown("关节1", encoding), "arm[left]", "[/x] :smile:"]
    rows = [next(line for line in lines if name in line) for name in names]
    # A Chinese letter takes two columns on the screen.
    wide = 2 if encoding == "utf-8" else 0
    ends = [line.rindex(value) + len(value) for line, value in zip(rows, ("1", "2.5", "3"), strict=True)]
    assert ends == [ends[1] - wide, ends[1], ends[1]]


def test_streams_that_cannot_change_are_left_alone(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setattr(sys, "stderr", None)
    spell_output()


@pytest.mark.parametrize(
    "settings",
    [{"PYTHONIOENCODING": code} for code in ("cp1252",)] + [{"LC_ALL": "C", "PYTHONUTF8": "0"}],
    ids=lambda settings: next(iter(settings.values())),
)
def test_commands_run_in_any_encoding(settings, tmp_path):
    (tmp_path / "robot.urdf").write_text(ARM, encoding="utf-8")
    commands = (
        (["info", "robot.urdf"], 0, "Try: eos-pin track"),
        (["track", "robot.urdf", "--duration", "0.1", "--out", "out"], 0, "Wrote"),
        (["ik", "robot.urdf", "--to", "0.2", "0.1", "0.9"], 0, "task error"),
        (["info", "robot.urdf", "--frame", "手"], 2, "no frame"),
        (["--help"], 0, "usage"),
        (["track", "--help"], 0, "[m/s"),
        (["track"], 2, "required"),
    )
    # Pictures have no encoding; drawing one takes seconds.
    code = (
        "from matplotlib.figure import Figure; from eos_pin.plots import pages\n"
        "pages.overview = lambda *arguments, **options: Figure((1.0, 1.0))\n"
        "import sys; from eos_pin.cli.main import main\n"
        f"for words, code, told in {commands!r}:\n"
        "    try: found = main(words)\n"
        "    except SystemExit as error: found = error.code\n"
        "    assert found == code, (found, code)\n"
        "    print('=====')"
    )
    plain = {key: value for key, value in os.environ.items() if not key.startswith(("LC_", "LANG", "PYTHONIO"))}
    source = tmp_path / "run.py"
    source.write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, source], cwd=tmp_path, env=plain | settings, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    assert b"Traceback" not in done.stderr + done.stdout
    said = done.stdout.split(b"=====")
    for (_, rc, told), text in zip(commands, said, strict=False):
        if rc != 2:
            assert told.encode() in text
    assert done.stderr.count(b"Error:") == 1
