"""`RunLog`: a table of a run that is still there when the process was killed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from time import monotonic

from eos_pin._arrays import JointVector
from eos_pin.control.hardware.connection import CommandKind, Sample
from eos_pin.errors import OutputError

#: Rows are handed to the operating system after this time at the latest [s].
FLUSH = 0.05
#: Names of columns of commands.
PREFIX: dict[CommandKind, str] = {"torque": "tau", "velocity": "dq_command", "position": "q_command"}


class RunLog:
    """Table of samples and commands (.csv), a row each, written as the run goes on.

    Rows go to the operating system every `FLUSH` seconds, so that a process that is killed loses no more than those
    since then, and at most a part of its last row. All other files are written under another name and then renamed.

    Args:
        path: The file; one that is there already is replaced.
        joints: Names of the joints.
        command: Kind of the commands.

    Raises:
        OutputError: The file cannot be written.
    """

    def __init__(self, path: str | Path, joints: Sequence[str], command: CommandKind) -> None:
        self.path = Path(path)
        names = ["t", *(f"{what}_{joint}" for what in ("q", "dq", PREFIX[command]) for joint in joints), "latency"]
        self._rows = [",".join(names)]
        self._flushed = -FLUSH
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        except OSError as error:
            raise OutputError(f"the log {str(path)!r} cannot be written: {error.strerror}") from error

    def add(self, sample: Sample, command: JointVector, latency: float) -> None:
        """Add a row.

        Args:
            sample: Measured state.
            command: Command that followed.
            latency: Time from one to the other [s].
        """
        values = (sample.t, *sample.q.tolist(), *sample.dq.tolist(), *command.tolist(), latency)
        self._rows.append(",".join(map(repr, values)))
        now = monotonic()
        if now - self._flushed >= FLUSH:
            self._flushed = now
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            text = memoryview(("\n".join(self._rows) + "\n").encode())
            self._rows.clear()
            try:
                while text:
                    text = text[os.write(self._file, text) :]
            except OSError as error:
                raise OutputError(f"the log {str(self.path)!r} cannot be written on: {error.strerror}") from error

    def close(self) -> None:
        """Write the rest."""
        try:
            self._flush()
        finally:
            os.close(self._file)
