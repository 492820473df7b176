"""Recordings: folders of images and readings, and bags, whatever their format, as events in order of time."""

from wheelsight.recordings._cameras import camera_names, load_camera
from wheelsight.recordings.bodies import express_for
from wheelsight.recordings.matches_file import MATCHES_FILE, matches_of, read_matches
from wheelsight.recordings.native import camera_turns
from wheelsight.recordings.protocol import (
    AssociationReport,
    GivesMatches,
    ListedFrame,
    ListsFrames,
    ListsTopics,
    OpenOptions,
    RecordedTopic,
    Recording,
    TellsEnds,
)
from wheelsight.recordings.registry import SAMPLE, SAMPLE_NAME, find_recordings, open_recording, reader_names
from wheelsight.recordings.writer import TRUTH_FILES, RecordingWriter, write_recording

__all__ = [
    "MATCHES_FILE",
    "SAMPLE",
    "SAMPLE_NAME",
    "TRUTH_FILES",
    "AssociationReport",
    "GivesMatches",
    "ListedFrame",
    "ListsFrames",
    "ListsTopics",
    "OpenOptions",
    "RecordedTopic",
    "Recording",
    "RecordingWriter",
    "TellsEnds",
    "camera_names",
    "camera_turns",
    "express_for",
    "find_recordings",
    "load_camera",
    "matches_of",
    "open_recording",
    "read_matches",
    "reader_names",
    "write_recording",
]
