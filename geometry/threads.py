"""Threads on purpose: products of small matrices are slower on two than on one, far more so on a busy machine."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController

BRINGING = ("scipy.linalg", "torch", "pypardiso")  #: packages with libraries of linear algebra of their own


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for linear algebra meanwhile; also a decorator of functions, ``@one_blas_thread()``."""
    with _libraries(*(name in sys.modules for name in BRINGING)).limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _libraries(*loaded: bool) -> ThreadpoolController:
    """The libraries of linear algebra that were there with these packages: to look for them takes 1 ms."""
    return ThreadpoolController()
