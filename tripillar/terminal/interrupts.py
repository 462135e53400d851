"""Ctrl-C and a termination: the process ends at any moment within two seconds, in one line, and leaves nothing behind.

It ends itself instead of raising an exception: libraries swallow those (`except BaseException` while they load), crash
when one passes through them, or compute on for minutes. A thread that waits for nothing else does it where compiled
code runs. Only the commands of a board and the served page, which end so every day, take Ctrl-C themselves.

A program loads this before anything else: it imports only what Python has loaded by then, or loads in a millisecond.
"""

import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

TYPE_CHECKING = False  # as of `typing`, which takes longer to load than all of this
if TYPE_CHECKING:
    from types import FrameType

    import psutil

GRACE_S = 1.2  #: left to what holds signals back, such as the writing of a file
TIDY_S = 0.4  #: left to processes started by this one to remove what they were writing
SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: processes started by others warn of what their parent left to them when it was killed, and remove it
_SILENT = "ignore:resource_tracker:UserWarning"

_rung: list[int] = []  #: the end of a pipe that wakes the thread
_ending = threading.Lock()
_last_words = ["interrupted."]
_codes: list[int] = []  #: exit codes of what is done


def install() -> None:
    """Take the signals over, once."""
    if _rung or threading.current_thread() is not threading.main_thread():
        return
    warnings = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = f"{warnings},{_SILENT}" if warnings else _SILENT
    atexit.register(_leave)  # before all others, so that it is called after them
    heard, rung = os.pipe()
    if sys.platform != "win32":  # where a pipe to be woken by may block, and never does
        os.set_blocking(rung, False)
    _rung.append(rung)
    for number in SIGNALS:
        signal.signal(number, _end)
    signal.set_wakeup_fd(rung, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(heard,), daemon=True, name="Ctrl-C").start()
    global psutil  # from here on there may be processes to end
    import psutil


def leave_to_finish(code: int) -> None:
    """Ignore signals from now on: all is done, only the interpreter is to be closed, and to end with this exit code."""
    _codes.append(code)
    for number in SIGNALS if _rung else ():
        signal.signal(number, signal.SIG_IGN)


def _leave() -> None:
    """Leave when threads have ended and libraries have done what they do at exit: to unload them takes 50 ms."""
    if _codes:
        leave_at_once(_codes[-1])


def leave_at_once(code: int = 0) -> None:
    """End without closing libraries, which may take seconds: all is done and written."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    _end_children()
    os._exit(code)


@contextmanager
def last_words(said: str) -> Iterator[None]:
    """Say this if the process is interrupted meanwhile."""
    _last_words.append(said)
    try:
        yield
    finally:
        _last_words.pop()


def _end(number: int, _: "FrameType | None" = None) -> None:
    if not _ending.acquire(blocking=False):
        time.sleep(60)  # the other thread is at it
    _end_children()
    unfinished = sys.modules.get("common.storage.unfinished")
    if unfinished is not None:
        unfinished.remove_unfinished()
    shown_again = "\x1b[?25h\n" if os.isatty(2) else ""  # the cursor, which bars hide
    with suppress(OSError):  # nobody reads any more
        if not _is_worker():
            os.write(2, f"{shown_again}tripillar: {_last_words[-1]}\n".encode())
    os._exit(128 + number)


def _watch(heard: int) -> None:
    """End the process where its main thread does not come to it, unless a session has taken the signal."""
    known = 0  # signals taken by sessions, this thread being quicker or slower than they are
    while True:
        number = os.read(heard, 1)[0]
        if number not in SIGNALS:
            continue
        handler: object = signal.getsignal(number)
        end_s = time.monotonic() + GRACE_S
        while hasattr(handler, "before") and time.monotonic() < end_s:  # held back
            time.sleep(0.02)
            handler = signal.getsignal(number)
        while hasattr(handler, "before"):
            handler = handler.before
        session = sys.modules.get("hardware.session")
        if handler is not _end:
            known += 1
        elif session is not None and session.noted_signals[0] > known:
            known = session.noted_signals[0]
        else:
            _end(number)


def _is_worker() -> bool:
    """Whether another of our processes started this one, and prints the last words."""
    multiprocessing = sys.modules.get("multiprocessing.process")
    return multiprocessing is not None and multiprocessing.parent_process() is not None


def _end_children() -> None:
    """End what this process started; remove what Intel's OpenMP keeps of each in shared memory.

    Nothing may be imported here: the main thread may be in the middle of it, and wait.
    """
    if "psutil" not in globals():  # interrupted before it was loaded, when nothing had been started
        return
    children = [child for child in psutil.Process().children(recursive=True) if not _tidies_up(child)]
    for child in children:
        with suppress(psutil.Error):
            child.terminate()
    for child in psutil.wait_procs(children, timeout=TIDY_S)[1]:
        with suppress(psutil.Error):
            child.kill()
    if sys.platform == "linux":
        for number in (os.getpid(), *(child.pid for child in children)):
            with suppress(OSError):
                os.unlink(f"/dev/shm/__KMP_REGISTERED_LIB_{number}_{os.getuid()}")


def _tidies_up(child: "psutil.Process") -> bool:
    """Whether a process is the one that multiprocessing leaves to remove what killed ones had."""
    try:
        return any("resource_tracker" in word for word in child.cmdline())
    except psutil.Error:
        return False
