"""`kernel` compiles functions with numba and caches them on disk until a file that they depend on changes.

Numba's own cache follows only the function's file, although functions and constants of other files are compiled into
it. This one follows all files of the same package that the file imports, directly or not. If several processes need a
kernel at once, one compiles it and the others wait, because compiling all kernels takes minutes.
"""

from __future__ import annotations

import fcntl
import gc
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
# Only at the begin of a line: imports within TYPE_CHECKING or functions do not affect a kernel.
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
    """Compile a function at its first call, without Python's lock, and cache it on disk; `options` are of `numba.njit`.

    Its arguments are arrays, scalars and NamedTuples of them. With NUMBA_DISABLE_JIT it stays as it is.
    """
    if function is None:
        return lambda given: kernel(given, **options)
    options["no_cfunc_wrapper"] = True  # no kernel is called back from C: that would be a twentieth of the compiling
    compiled = njit(nogil=True, **options)(function)
    if isinstance(compiled, Dispatcher):
        # As `Dispatcher.enable_caching`, which has no parameter for the class.
        cache = _Cache(function)
        compile_: Any = compiled.compile
        template_of: Any = compiled.get_call_template
        plain: Callable[[Any], Any] = types.unliteral
        compiled._cache = cache  # type: ignore[attr-defined]  # noqa: SLF001

        def compile_alone(signature: Any) -> Any:
            # Numba's lock first: threads that compile take both, and a kernel compiles the kernels that it calls.
            with global_compiler_lock, _locked(cache.lock_path):
                was_enabled = gc.isenabled()
                gc.disable()  # numba's objects are millions, and stay: each collection would visit all
                try:
                    return compile_(signature)
                finally:
                    if was_enabled:
                        gc.enable()

        def template_without_literals(args: Any, kws: Any) -> Any:
            # Numba compiles a called kernel once for each literal number.
            return template_of(tuple(map(plain, args)), {name: plain(arg) for name, arg in kws.items()})

        compiled.compile = compile_alone  # type: ignore[method-assign, assignment]
        compiled.get_call_template = template_without_literals  # type: ignore[method-assign]
    return compiled


class _Index(IndexDataCacheFile):
    """Numba's index, empty if it cannot be read.

    Numba unpickles an index before it compares stamps: a renamed class or a truncated file would raise at each call of
    the kernel.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError, EOFError, ValueError, pickle.UnpicklingError):
            return {}


class _Cache(FunctionCache):
    """Numba's cache, in its folder, with a stamp of all files that a function depends on."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        digests = sorted([_read(name).digest for name in made_of(function.__module__)])
        stamp = hashlib.sha256("".join(digests).encode()).hexdigest()
        self._cache_file = _Index(  # type: ignore[no-untyped-call]
            cache_path=self.cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), stamp),
        )
        self.lock_path = Path(self.cache_path) / f"{self._impl.filename_base}.lock"


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file that one process has at a time; the system releases it if the process dies.

    If the file cannot be written, no kernel is cached either, and no process waits.
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
    """Return the modules of its package that a loaded module imports, directly or not, and itself."""
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += _read(name).imports
    return found


@dataclass(frozen=True, slots=True)
class _ModuleText:
    """Digest of a loaded module's text, and the modules of its package and of ours that it imports."""

    spec: ModuleSpec | None
    digest: str
    imports: tuple[str, ...]


# Read once each time a module is loaded, so that the stamp is of the running text.
_texts: dict[str, _ModuleText] = {}


def _read(name: str) -> _ModuleText:
    """Return the text of a loaded module; empty without file.

    A program frozen into one file has no texts: numba itself follows that file.
    """
    module = sys.modules.get(name)
    spec = getattr(module, "__spec__", None)
    known = _texts.get(name)
    if known is not None and known.spec is spec:
        return known
    path = getattr(module, "__file__", None)
    text = Path(path).read_bytes() if path is not None and Path(path).is_file() else b""
    packages, imports = {name.partition(".")[0], __name__.partition(".")[0]}, list[str]()
    for found in _IMPORT.finditer(text.decode()):
        origin = found["module"] or found["origin"]
        if origin.partition(".")[0] not in packages:
            continue
        names = _NAME.findall(_COMMENT.sub("", found["names"] or ""))
        modules = [one for one in names if isinstance(getattr(sys.modules[origin], one, None), ModuleType)]
        imports += [f"{origin}.{one}" for one in modules]
        if not names or len(modules) < len(names):
            imports.append(origin)
    _texts[name] = _ModuleText(spec, hashlib.sha256(text).hexdigest(), tuple(imports))
    return _texts[name]
