"""Keyframes as maps of before 2026-11-27 have them: images as PNG, keypoints where they are as float32."""

from __future__ import annotations

import struct

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.keyframes import Keyframe, KeyframeFeatures
from wheelsight.slam.sessions import images
from wheelsight.slam.sessions.images import DepthSteps
from wheelsight.slam.sessions.keypoints import inflated

_DAMAGED = "use another copy of the map"
# Stamp, intrinsics, both numbers of the steps of depth; bytes of both images, of the code, keypoints (-1: none are
# known) and bytes of where they are.
_KEYFRAME = struct.Struct("<d4ddd5i4x")
_ORB_BYTES, _KEYPOINT_BYTES = 32, 5 * 4
_MOST_KEYPOINTS = 100_000


def unpack_keyframe(content: bytes, most_px: images.Size = images.LARGEST_PX) -> Keyframe:
    """What such a map holds of a keyframe. Raises MapError for what is none, or of images larger than `most_px`."""
    try:
        stamp_s, fx, fy, cx, cy, step_m, growth, *sizes = _KEYFRAME.unpack_from(content)
    except struct.error as error:
        raise MapError("is no keyframe", fix=_DAMAGED) from error
    depth_bytes, grey_bytes, code_bytes, count, place_bytes = sizes
    descriptor_bytes = max(count, 0) * _ORB_BYTES
    lengths = (depth_bytes, grey_bytes, code_bytes, place_bytes, descriptor_bytes)
    numbers = np.array([stamp_s, fx, fy, cx, cy, step_m, growth])
    is_sound = np.isfinite(numbers).all() and min(fx, fy, step_m, growth) > 0 and -1 <= count <= _MOST_KEYPOINTS
    if not is_sound or min(lengths) < 0 or _KEYFRAME.size + 1 + sum(lengths) != len(content) or code_bytes % 8:
        raise MapError("is no keyframe", fix=_DAMAGED)
    parts, at = [], _KEYFRAME.size + 1
    for length in lengths:
        parts.append(content[at : at + length])
        at += length
    depth = images.unpacked_png(parts[0], np.uint16, most_px)
    grey = images.unpacked_png(parts[1], np.uint8, most_px)
    if depth.shape != grey.shape:
        raise MapError("its images are of two sizes", fix=_DAMAGED)
    features = None if count < 0 else _features(count, parts[3], parts[4])
    straight = DepthSteps(step_m, growth).depth_m(depth), images.grey_of(grey, content[_KEYFRAME.size])
    made = Keyframe.of_images(stamp_s, np.array([fx, fy, cx, cy]), *straight, features)
    if not code_bytes:
        return made
    code = np.frombuffer(parts[2], "<f8").astype(float)
    return Keyframe(stamp_s, made.intrinsics, made.depth_png, made.grey_png, features, code)


def _features(count: int, places: bytes, descriptors: bytes) -> KeyframeFeatures:
    rows = np.frombuffer(inflated(places, count * _KEYPOINT_BYTES), "<f4").reshape(5, count).T.astype(float)
    if not np.isfinite(rows).all():
        raise MapError("its keypoints are nowhere", fix=_DAMAGED)
    orb = np.frombuffer(descriptors, "<u8").reshape(count, 4).astype(np.uint64)
    return KeyframeFeatures(rows[:, :2].copy(), rows[:, 2:].copy(), orb)


def unpack_descriptors(content: bytes) -> UInt64Array:
    """Descriptors (N, 4) alone. Raises MapError for what is none."""
    try:
        count = max(_KEYFRAME.unpack_from(content)[-2], 0)
    except struct.error as error:
        raise MapError("is no keyframe", fix=_DAMAGED) from error
    if count * _ORB_BYTES > len(content) - _KEYFRAME.size:
        raise MapError("is no keyframe", fix=_DAMAGED)
    return np.frombuffer(content, "<u8", 4 * count, len(content) - count * _ORB_BYTES).reshape(-1, 4).astype(np.uint64)
