"""Ctrl-C at places where it can be handled, so that it ends the command even if a library catches it."""

from __future__ import annotations

import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from eos_pin.errors import is_taken

#: While modules are imported, Ctrl-C is tried again after this time [s].
AGAIN = 0.02
#: After this time [s] it is looked whether the interrupt is still on its way.
LOOK = 0.2


@contextmanager
def patient_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until no module is being imported, and repeat it where it was lost.

    Packages that are interrupted while they are imported take that for a missing dependency and go on, or crash. Others
    catch whatever is raised while they read a file, and destructors drop it.

    Raises:
        KeyboardInterrupt: Ctrl-C, at the latest where the block ends.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    waiting: list[threading.Timer] = []
    raised: list[KeyboardInterrupt] = []
    repeated = threading.Event()

    def repeat() -> None:
        repeated.set()
        _again()

    def look_after(seconds: float) -> None:
        waiting[:] = [threading.Timer(seconds, repeat)]
        waiting[0].daemon = True
        waiting[0].start()

    def handle(number: int, frame: FrameType | None) -> None:
        waiting.clear()
        if repeated.is_set() and raised:
            repeated.clear()
            if is_taken(raised[0]):
                return
            if _is_handled(raised[0]):
                look_after(LOOK)
                return
        repeated.clear()
        if _imports(frame):
            look_after(AGAIN)
            return
        raised[:] = [KeyboardInterrupt()]
        look_after(LOOK)
        raise raised[0]

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for timer in waiting:
            timer.cancel()
    if waiting and not (raised and is_taken(raised[0])):
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


def _is_handled(interrupt: KeyboardInterrupt) -> bool:
    """Whether an interrupt is being handled: files are closed and processes ended because of it."""
    error = sys.exc_info()[1]
    while error is not None and error is not interrupt:
        error = error.__context__
    return error is not None
