"""What a worker process of this machine does first; Dask loads it in each of them, those begun anew as well."""

import os
import signal
import sys
from typing import Any

LOG = "TRIPILLAR_SWEEP_LOG"  #: environment variable: file for what the worker prints


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that started the worker, and the terminal as well; load what takes seconds."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    log = os.open(os.environ[LOG], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        os.dup2(log, stream.fileno())
    os.close(log)
    import studies.sweep.judge  # noqa: F401
