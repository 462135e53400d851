"""Threads on purpose: products of small matrices are slower on two than on one, far more so on a busy machine."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for linear algebra meanwhile; also a decorator of functions, ``@one_blas_thread()``."""
    with _libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _libraries(n_modules: int) -> ThreadpoolController:
    """The libraries of linear algebra that came with so many modules: to look for them takes 1 ms."""
    return ThreadpoolController()
