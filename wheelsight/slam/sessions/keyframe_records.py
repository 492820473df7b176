"""What the record of a keyframe holds, as bytes and back.

Plain numbers in little-endian order and compressed images, and nothing that could do something. What is kept of a
keyframe is what another drive needs of it: images in steps that noise hides, and the keypoints that have depth.
"""

from __future__ import annotations

import struct

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.keyframes import Keyframe, KeyframeFeatures
from wheelsight.slam.sessions import images, keypoints
from wheelsight.slam.sessions.images import DepthSteps
from wheelsight.slam.sessions.settings import SessionSettings

_DAMAGED = "use another copy of the map"
# Stamp, intrinsics, both numbers of the steps of depth; bytes of both images, of the code, keypoints (-1: none are
# known) and bytes of where they are; the step of grey. Descriptors come last: they are found without the rest.
_HEAD = struct.Struct("<d4ddd5iB")
_ORB_BYTES = 32
_MOST_KEYPOINTS = 100_000


def pack_keyframe(keyframe: Keyframe, steps: DepthSteps, settings: SessionSettings) -> bytes:
    """A keyframe; `unpack_keyframe` gives back all but what steps, width and too many keypoints make less."""
    level = images.halved(keyframe, settings.width_px)
    depth = images.packed_depth(steps.numbers(level.depth_m))
    grey = images.packed_grey(images.grey_numbers(level.grey, settings.grey_step))
    code = b"" if keyframe.code is None else np.ascontiguousarray(keyframe.code, "<f8").tobytes()
    room = 1000 * settings.most_kb - _HEAD.size - len(depth) - len(grey) - len(code)
    count, places, descriptors = _packed_features(keyframe.features, _MOST_KEYPOINTS)
    while (taken := len(places) + len(descriptors)) > room and count > settings.least_keypoints:
        most = max(min(room * count // taken, count - 1), settings.least_keypoints)
        count, places, descriptors = _packed_features(keyframe.features, most)
    sizes = (len(depth), len(grey), len(code), count, len(places))
    head = _HEAD.pack(keyframe.stamp_s, *level.intrinsics, steps.step_m, steps.growth, *sizes, settings.grey_step)
    return b"".join([head, depth, grey, code, places, descriptors])


def unpack_keyframe(content: bytes, most_px: images.Size = images.LARGEST_PX) -> Keyframe:
    """What `pack_keyframe` made. Raises MapError for what is none, or has images wider or higher than `most_px`."""
    numbers, lengths, count = _told(content)
    stamp_s, *intrinsics, step_m, growth, grey_step = numbers
    parts, at = [], _HEAD.size
    for length in lengths:
        parts.append(content[at : at + length])
        at += length
    depth, grey = images.unpacked_depth(parts[0], most_px), images.unpacked_grey(parts[1], most_px)
    if depth.shape != grey.shape:
        raise MapError("its images are of two sizes", fix=_DAMAGED)
    features = None
    if count >= 0:
        features = KeyframeFeatures(*keypoints.unpacked(parts[3], count), _descriptors(parts[4]))
    straight = DepthSteps(step_m, growth).depth_m(depth), images.grey_of(grey, int(grey_step))
    made = Keyframe.of_images(stamp_s, np.array(intrinsics), *straight, features)
    if not parts[2]:
        return made
    code = np.frombuffer(parts[2], "<f8").astype(float)
    return Keyframe(stamp_s, made.intrinsics, made.depth_png, made.grey_png, features, code)


def unpack_descriptors(content: bytes) -> UInt64Array:
    """The descriptors (N, 4) alone of what `pack_keyframe` made. Raises MapError for what is none."""
    *_, length = _told(content)[1]
    return _descriptors(content[len(content) - length :])


def _told(content: bytes) -> tuple[tuple[float, ...], tuple[int, ...], int]:
    """Numbers of the head, the lengths of the five parts behind it, and how many keypoints. Raises MapError."""
    try:
        *told, grey_step = _HEAD.unpack_from(content)
    except struct.error as error:
        raise MapError("is no keyframe", fix=_DAMAGED) from error
    numbers, (*images_and_code, count, places) = (*told[:7], grey_step), told[7:]
    lengths = (*images_and_code, places, max(count, 0) * _ORB_BYTES)
    _, fx, fy, _, _, step_m, growth, _ = numbers
    is_sound = np.isfinite(numbers).all() and min(fx, fy, step_m, growth) > 0 and -1 <= count <= _MOST_KEYPOINTS
    if not is_sound or min(lengths) < 0 or _HEAD.size + sum(lengths) != len(content) or lengths[2] % 8:
        raise MapError("is no keyframe", fix=_DAMAGED)
    return numbers, lengths, count


def _packed_features(features: KeyframeFeatures | None, most: int) -> tuple[int, bytes, bytes]:
    """How many keypoints are kept, -1 for None; where they are; and their descriptors."""
    if features is None:
        return -1, b"", b""
    kept = np.flatnonzero(features.points[:, 2] > 0)  # without depth they tell no relative pose
    if len(kept) > most:
        kept = kept[np.linspace(0, len(kept) - 1, most).astype(np.int64)]
    order, places = keypoints.packed(features.px[kept], features.points[kept])
    return len(kept), places, np.ascontiguousarray(features.descriptors[kept][order], "<u8").tobytes()


def _descriptors(data: bytes) -> UInt64Array:
    return np.frombuffer(data, "<u8").reshape(-1, 4).astype(np.uint64)
