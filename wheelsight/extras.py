"""Libraries that an extra of wheelsight brings: loaded when they are needed, and named where they are missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from wheelsight.errors import ConfigError

# By the name that is imported: the library's, and all that its extra brings, by names that install from anywhere.
_EXTRAS = {
    "av": ("PyAV", "av"),
    "backports": ("backports.zstd", "rosbags"),
    "compression": ("compression.zstd", "rosbags"),
    "distributed": ("Dask", "distributed"),
    "gtsam": ("GTSAM", "gtsam"),
    "lz4": ("lz4", "rosbags"),
    "mujoco": ("MuJoCo", "mujoco matplotlib"),
    "octomap": ("octomap-python", "octomap-python"),
    "plotly": ("plotly", "plotly"),
    "rosbags": ("rosbags", "rosbags"),
    "pyrealsense2": ("pyrealsense2", "pyrealsense2"),
    "rerun": ("Rerun", "rerun-sdk"),
    "skimage": ("scikit-image", "scikit-image"),
    "sklearn": ("scikit-learn", "scikit-learn skops"),
    "starlette": ("Starlette", "starlette uvicorn websockets"),
    "uvicorn": ("uvicorn", "starlette uvicorn websockets"),
    "websockets": ("websockets", "starlette uvicorn websockets"),
    "skops": ("skops", "scikit-learn skops"),
}


def needed(module: str) -> Any:
    """A module of a library that an extra brings, such as "skops.io".

    Raises:
        ConfigError: the library is not installed; says how to install it.
    """
    library, libraries = _EXTRAS[module.partition(".")[0]]
    try:
        return import_module(module)
    except ImportError as error:
        raise ConfigError(f"{library} is missing", fix=f"pip install {libraries}") from error


def why_missing(library: str) -> str | None:
    """What to say of a library of an extra, by the name that is imported; None where it is installed."""
    try:
        needed(library)
    except ConfigError as error:
        return str(error)
    return None
