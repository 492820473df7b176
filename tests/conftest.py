"""What all tests share: reproducible examples, the real recordings, and a browser."""

from __future__ import annotations

import gc
import os
import shutil
from pathlib import Path

# Before numpy is loaded: OpenBLAS' threads wait for each other in a loop, and there is a process a core already.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import settings

PROJECT = Path(__file__).resolve().parent.parent
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")

# The same examples in every run: a hundred of an identity find no more than thirty.
settings.register_profile("wheelsight", deadline=None, derandomize=True, max_examples=30)
settings.register_profile("quick", parent=settings.get_profile("wheelsight"), max_examples=12)
settings.load_profile("wheelsight")


def pytest_configure(config: pytest.Config) -> None:
    """Without the slow tests, identities are tried by fewer examples, too."""
    if config.option.markexpr == "not slow":
        settings.load_profile("quick")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """One more than cores: a fifth of their time was left, while tests waited for programs, ports and clocks."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + 1


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Those of long_tests.txt are slow: all of them together would be half of what `make test` takes."""
    long = set((PROJECT / "tests" / "long_tests.txt").read_text(encoding="utf-8").splitlines())
    for item in items:
        if item.nodeid in long:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Ten thousand collected tests live until the end: the garbage collector need not walk them again and again."""
    gc.freeze()
    # Python's 700 let it run some ten thousand times a session, and hypothesis times each of its runs.
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session")
def project_folder() -> Path:
    """The project's root, where pyproject.toml stands."""
    return PROJECT


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings: WHEELSIGHT_DATA, else ../shared/data from the project's root."""
    folder = Path(os.environ.get("WHEELSIGHT_DATA") or PROJECT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"real recordings are not at {folder}; set WHEELSIGHT_DATA to their folder")
    return folder.resolve()


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20240817)


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a headless-capable Chromium; its absence fails where WHEELSIGHT_REQUIRE_BROWSER=1 (CI), else skips."""
    found = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if found is not None:
        return found
    message = "no Chromium found; install Debian's package chromium"
    if os.environ.get("WHEELSIGHT_REQUIRE_BROWSER") == "1":
        pytest.fail(message)
    pytest.skip(message)
