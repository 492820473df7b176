"""Kernels: functions that numba compiles and keeps on the disk until any file that they are made of changes.

Numba by itself keeps a compiled function until the text of its own file changes, although functions and constants of
other files are compiled into it. Here it is kept until the text of any file changes which its file imports from the
same package, or which those import. Of processes that need the same kernel at once, one compiles it and the others
wait: compiling all of them takes minutes of a processor.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar, overload

from numba import njit, types
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

_Function = TypeVar("_Function", bound=Callable[..., Any])
# What stands at the beginning of a line alone: an import within TYPE_CHECKING or a function gives a kernel nothing.
_IMPORT = re.compile(r"^(?:import (?P<module>[\w.]+)|from (?P<origin>[\w.]+) import (?P<names>\([^)]*\)|.*))", re.M)
_NAME = re.compile(r"(\w+)(?: as \w+)?")
_COMMENT = re.compile(r"#.*")


@overload
def kernel(function: _Function) -> _Function: ...


@overload
def kernel(
    *,
    error_model: Literal["python", "numpy"] = ...,
    inline: Literal["never", "always"] = ...,
    fastmath: bool | set[str] = ...,
) -> Callable[[_Function], _Function]: ...


def kernel(function: Any = None, **options: Any) -> Any:
    """Compile a function at its first call, let it run beside other threads, and keep it on the disk.

    Args:
        function: written for numba; its arguments are arrays, scalars and NamedTuples of them.
        options: of `numba.njit`.

    Returns:
        Its compiled form; the function itself where numba is told not to compile (NUMBA_DISABLE_JIT).
    """
    if function is None:
        return lambda given: kernel(given, **options)
    compiled = njit(nogil=True, **options)(function)
    if isinstance(compiled, Dispatcher):
        # As `Dispatcher.enable_caching` does, which asks for no class.
        cache = _Cache(function)
        compiled._cache = cache  # type: ignore[attr-defined]  # noqa: SLF001
        compiled.compile = _one_process_at_a_time(compiled.compile, cache.lock_path)  # type: ignore[method-assign]
        compiled.get_call_template = _whatever_the_number(compiled.get_call_template)  # type: ignore[method-assign]
    return compiled


def _whatever_the_number(template_of: Callable[..., Any]) -> Callable[..., Any]:
    """To be called by kernels without regard to the numbers they write out: numba compiles once for each of them."""

    def unliteral(args: Any, kws: Any) -> Any:
        plain: Callable[[Any], Any] = types.unliteral
        return template_of(tuple(map(plain, args)), {name: plain(arg) for name, arg in kws.items()})

    return unliteral


class _Index(IndexDataCacheFile):
    """Numba's own; one that cannot be read is as none.

    Numba unpickles an index before it compares stamps: a class that was renamed since, or a write that was cut off,
    would raise at each call of the kernel.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError, EOFError, ValueError, pickle.UnpicklingError):
            return {}


class _Cache(FunctionCache):
    """Numba's own, in the place that numba chooses, with a stamp of all files that a function is made of."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file = _Index(  # type: ignore[no-untyped-call]
            cache_path=self.cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), _stamp(function.__module__)),
        )
        self.lock_path = Path(self.cache_path) / f"{self._impl.filename_base}.lock"


def _one_process_at_a_time(compile_: Callable[..., Any], path: Path) -> Callable[..., Any]:
    """To compile or load a kernel so that no other process does: it finds what this one has kept."""

    def alone(signature: Any) -> Any:
        # Numba's lock first, as threads that compile take both, and a kernel is compiled while one is that calls it.
        with global_compiler_lock, _held(path):
            return compile_(signature)

    return alone


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """With a file that one process holds at a time; the system lets go of it where that process dies.

    Where no file can be written there nothing is kept either, and nobody waits.
    """
    descriptor = -1
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def made_of(module: str) -> set[str]:
    """Names of the modules of its package that a loaded module imports, those that they import in turn, and itself."""
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += _read(name).imports
    return found


def _stamp(module: str) -> str:
    """A digest of all that a module of kernels is made of."""
    digests = sorted([_read(name).digest for name in made_of(module)])
    return hashlib.sha256("".join(digests).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class _Source:
    """A loaded module's text: its digest, and the modules of its package and of ours that it imports."""

    spec: ModuleSpec | None
    digest: str
    imports: tuple[str, ...]


# Read once each time a module is loaded, so that the stamp is of the text that runs, whatever is written since.
_sources: dict[str, _Source] = {}


def _read(name: str) -> _Source:
    """The text of a loaded module; an empty one, where there is none.

    A program frozen into one file has no texts: numba itself looks whether that file has changed.
    """
    module = sys.modules.get(name)
    spec = getattr(module, "__spec__", None)
    known = _sources.get(name)
    if known is not None and known.spec is spec:
        return known
    path = getattr(module, "__file__", None)
    text = Path(path).read_bytes() if path is not None and Path(path).is_file() else b""
    imports = tuple(_imports({name.partition(".")[0], __name__.partition(".")[0]}, text.decode()))
    _sources[name] = _Source(spec, hashlib.sha256(text).hexdigest(), imports)
    return _sources[name]


def _imports(packages: set[str], text: str) -> Iterator[str]:
    """The loaded modules of some packages that a text imports, or from which it imports something."""
    for found in _IMPORT.finditer(text):
        origin = found["module"] or found["origin"]
        if origin.partition(".")[0] not in packages:
            continue
        names = _NAME.findall(_COMMENT.sub("", found["names"] or ""))
        modules = [name for name in names if isinstance(getattr(sys.modules[origin], name, None), ModuleType)]
        yield from (f"{origin}.{name}" for name in modules)
        if not names or len(modules) < len(names):
            yield origin
