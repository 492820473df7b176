"""Compiled kernels as the plain Python they were written in."""

from __future__ import annotations

from types import FunctionType, ModuleType, SimpleNamespace

import numpy as np
from numba.core.dispatcher import Dispatcher


def plain(module: ModuleType) -> SimpleNamespace:
    """A module's kernels uncompiled, all the way down, with numpy counting bits."""
    names = dict(vars(module))
    for imported in [kernel for kernel in names.values() if isinstance(kernel, Dispatcher)]:
        names = imported.py_func.__globals__ | names
    names["count_bits"] = lambda word: int(np.bitwise_count(word))
    kernels = {name: kernel.py_func for name, kernel in names.items() if isinstance(kernel, Dispatcher)}
    names |= {name: FunctionType(f.__code__, names, name, f.__defaults__) for name, f in kernels.items()}
    return SimpleNamespace(**{name: names[name] for name in kernels})
