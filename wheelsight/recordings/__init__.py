"""Recordings: folders of images and readings, whatever their format, as events in order of time."""

from wheelsight.recordings._cameras import camera_names, load_camera
from wheelsight.recordings.bodies import express_for
from wheelsight.recordings.protocol import AssociationReport, ListedFrame, ListsFrames, OpenOptions, Recording
from wheelsight.recordings.registry import find_recordings, open_recording, reader_names
from wheelsight.recordings.writer import TRUTH_FILES, RecordingWriter, write_recording

__all__ = [
    "TRUTH_FILES",
    "AssociationReport",
    "ListedFrame",
    "ListsFrames",
    "OpenOptions",
    "Recording",
    "RecordingWriter",
    "camera_names",
    "express_for",
    "find_recordings",
    "load_camera",
    "open_recording",
    "reader_names",
    "write_recording",
]
