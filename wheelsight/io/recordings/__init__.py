"""Recordings: folders of images and readings, and bags, whatever their format, as events in order of time."""

from wheelsight.io.recordings.native import (
    MATCHES_FILE,
    TRUTH_FILES,
    RecordingWriter,
    camera_angular_velocities,
    matches_of,
    read_matches,
    write_recording,
)
from wheelsight.io.recordings.recording import (
    AssociationReport,
    HasEndStamps,
    HasMatches,
    ListedFrame,
    ListsFrames,
    ListsTopics,
    OpenOptions,
    RecordedTopic,
    Recording,
    camera_names,
    express_for,
    load_camera,
)
from wheelsight.io.recordings.registry import SAMPLE, SAMPLE_NAME, find_recordings, open_recording, reader_names

__all__ = [
    "MATCHES_FILE",
    "SAMPLE",
    "SAMPLE_NAME",
    "TRUTH_FILES",
    "AssociationReport",
    "HasEndStamps",
    "HasMatches",
    "ListedFrame",
    "ListsFrames",
    "ListsTopics",
    "OpenOptions",
    "RecordedTopic",
    "Recording",
    "RecordingWriter",
    "camera_angular_velocities",
    "camera_names",
    "express_for",
    "find_recordings",
    "load_camera",
    "matches_of",
    "open_recording",
    "read_matches",
    "reader_names",
    "write_recording",
]
