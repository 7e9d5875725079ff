"""Worker processes: one a library, kept alive, asked for one round after the other in turn."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from peers import PEERS, WORKERS, bare_name, installed

#: One request may take so long [s].
PATIENCE = 600.0


class WorkerError(Exception):
    """A worker died, did not answer, or could not do what it was asked."""


class Worker:
    """A process that answers requests; see peers_workers/serve.py.

    Args:
        name: What it is called in tables.
        python: Its interpreter.
        script: What it runs.
    """

    def __init__(self, name: str, python: str | Path, script: Path) -> None:
        self.name, self.cases = name, frozenset[str]()
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed with the process)
        threads = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
        self._process = subprocess.Popen(
            [str(python), str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=os.environ | threads,
        )

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Answer to a request.

        Raises:
            WorkerError: There is none, or it is an error.
        """
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        try:
            print(json.dumps(request), file=stdin, flush=True)
        except OSError:
            raise self._dead() from None
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            if not selector.select(PATIENCE):
                self.stop()
                raise WorkerError(f"no answer after {PATIENCE:g} s")
        line = stdout.readline()
        if not line:
            raise self._dead()
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise WorkerError(reply["error"])
        return reply

    def take(self, problem: Mapping[str, Any]) -> None:
        """Give it a problem; `cases` says what it can do then."""
        self.cases = frozenset(self.ask({"problem": problem})["cases"])

    def run(self, case: str, inputs: Sequence[Sequence[float]], repeats: int) -> dict[str, Any]:
        """Microseconds of one call for each input, and its answer."""
        return self.ask({"run": case, "inputs": inputs, "repeats": repeats})

    def stop(self) -> None:
        """End the process."""
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()

    def _dead(self) -> WorkerError:
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines() or ["it ended without a word"]
        return WorkerError(lines[-1])


@dataclass
class Crew:
    """All workers, and what they were found unable to do.

    Attributes:
        workers: The workers that are there, eos_pin and Pinocchio first.
        versions: Their versions.
        missing: Why others are not there, and what failed, by name.
    """

    workers: list[Worker] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    def take(self, problem: Mapping[str, Any]) -> None:
        """Give all workers a problem; one that cannot take it is sent home."""
        for worker in tuple(self.workers):
            try:
                worker.take(problem)
            except WorkerError as error:
                self.missing[worker.name] = str(error)
                worker.stop()
                self.workers.remove(worker)

    def cases(self, *kinds: str) -> list[tuple[Worker, str]]:
        """Who can do what, of some kinds of cases."""
        return [
            (worker, case)
            for kind in kinds
            for worker in self.workers
            for case in sorted(worker.cases)
            if case.startswith(f"{kind}:")
        ]

    def rounds(
        self, cases: Sequence[tuple[Worker, str]], inputs: Sequence[Sequence[float]], *, repeats: int, rounds: int
    ) -> dict[tuple[str, str], tuple[np.ndarray, list[list[float]]]]:
        """Time cases in turn, one round after the other.

        Returns:
            Microseconds (rounds, inputs) and the answers, by names of worker and case; without those that failed.
        """
        times: dict[tuple[str, str], list[list[float]]] = {}
        answers: dict[tuple[str, str], list[list[float]]] = {}
        failed = set()
        for _ in range(rounds):
            for worker, case in cases:
                key = worker.name, case
                if key in failed:
                    continue
                try:
                    reply = worker.run(case, inputs, repeats)
                except WorkerError as error:
                    reply = {"answers": [[]], "trouble": str(error)}
                if not any(reply["answers"]):
                    failed.add(key)
                    self.missing[f"{worker.name}, {case}"] = reply["trouble"]
                    continue
                times.setdefault(key, []).append(reply["microseconds"])
                answers[key] = reply["answers"]
        return {key: (np.array(taken), answers[key]) for key, taken in times.items() if key not in failed}


@contextmanager
def crew(names: Sequence[str] | None = None) -> Iterator[Crew]:
    """Workers for eos_pin, Pinocchio and the peers that are installed.

    Args:
        names: Which peers; all of them by default.
    """
    found = Crew()
    try:
        for name in ("eos_pin", "Pinocchio"):
            found.workers.append(Worker(name, sys.executable, WORKERS / f"with_{name.lower()}.py"))
        for key, peer in PEERS.items():
            if names is not None and key not in names:
                continue
            versions = installed(peer)
            if isinstance(versions, str):
                found.missing[peer.name] = versions
                continue
            found.versions[peer.name] = versions[bare_name(peer.packages[0])]
            found.workers.append(Worker(peer.name, peer.python, peer.worker))
        yield found
    finally:
        for worker in found.workers:
            worker.stop()
