"""Ctrl-C that comes where it can be dealt with."""

from __future__ import annotations

import signal
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

#: While modules are imported, Ctrl-C is tried again after this time [s].
AGAIN = 0.02


@contextmanager
def patient_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until no module is being imported.

    Packages that are interrupted while they are imported take that for a missing dependency and go on, or crash.

    Raises:
        KeyboardInterrupt: Ctrl-C, at the latest where the block ends.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    waiting: list[threading.Timer] = []

    def handle(number: int, frame: FrameType | None) -> None:
        waiting.clear()
        if not _imports(frame):
            raise KeyboardInterrupt
        waiting.append(threading.Timer(AGAIN, _again))
        waiting[0].daemon = True
        waiting[0].start()

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for timer in waiting:
            timer.cancel()
    if waiting:
        raise KeyboardInterrupt


def _again() -> None:
    """Interrupt the main thread, also where it sleeps."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        interrupt_main()


def _imports(frame: FrameType | None) -> bool:
    """Whether a module is being imported in this frame or a caller of it."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
