"""Compiled code that may crash, or does not let Ctrl-C through, in a process of its own."""

import ctypes
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

from geometry.errors import GeometryError

T = TypeVar("T")
PR_SET_PDEATHSIG = 1  #: of Linux's prctl


def apart(function: Callable[..., T], *arguments: Any, name: str) -> T:
    """What a function gives that is run in a copy of this process.

    On Windows there is no such copy, and in a thread locks of other threads might stay closed in it: there it is run in
    this process.

    Parameters
    ----------
    function : callable
        Must give what can be pickled, and use no threads that run already.
    name : str
        What it is, for the message of its failure.

    Raises
    ------
    GeometryError
        If the copy crashed, or was ended for want of memory.
    """
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        return function(*arguments)
    reader, writer = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12, about locks of other threads
        child = os.fork()
    if child == 0:
        _answer(function, arguments, writer)
    os.close(writer)
    try:
        with open(reader, "rb") as answers:
            answer = answers.read()
    except BaseException:  # Ctrl-C
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        _, status = os.waitpid(child, 0)
    if not answer:
        why = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"exit code {os.WEXITSTATUS(status)}"
        raise GeometryError(f"{name} crashed ({why}): is there enough memory and room on the disk?")
    given, error = pickle.loads(answer)
    if error is not None:
        raise error
    return given


def _answer(function: Callable[..., Any], arguments: tuple[Any, ...], writer: int) -> NoReturn:
    """In the copy: leave Ctrl-C to the original, hand over what came out, and end without any tidying up."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # it ends with the original, however that is killed
    code = 1
    try:
        try:
            answer = pickle.dumps((function(*arguments), None), pickle.HIGHEST_PROTOCOL)
        except Exception as error:
            answer = pickle.dumps((None, error))
        with open(writer, "wb") as answers:
            answers.write(answer)
        code = 0
    finally:
        os._exit(code)
