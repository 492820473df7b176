"""RecorderSettings: how what live sensors say is written to the disk, and when that ends."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting


class RecorderSettings(Settings):
    """Of `wheelsight record`, and of `run --live --record`."""

    longest_wait_s: float = setting(
        0.8,
        "a frame that comes while another has waited so long for the disk is dropped, and counted; under a second, so "
        "that whatever ends the program loses no more",
        CHOSEN,
        gt=0,
        le=60,
    )
    most_waiting: int = setting(
        60,
        "frames that wait at most, whatever their rate: 130 MB of 640×480",
        "reckoned from 7 bytes a pixel",
        ge=1,
        le=10_000,
    )
    writers: int = setting(
        2,
        "threads that encode and write images; a frame of 640×480 keeps one for 17 ms, and waits 18 ms for the disk",
        "measured by benchmarks.recording on two cores",
        ge=1,
        le=64,
    )
    bag_wait_s: float = setting(
        0.4,
        "likewise of a frame on its way into a bag: readers put messages in order within half a second "
        "(recording.bag.order_s), and would leave out what comes later still",
        CHOSEN,
        gt=0,
        le=60,
    )
    bag_flush_s: float = setting(
        0.5,
        "how often a bag is made readable up to there, seconds: with bag_wait_s under a second, so that whatever ends "
        "the program loses no more. Each time is a chunk of MCAP, of which a reader's index has a line",
        CHOSEN,
        gt=0,
        le=60,
    )
    least_free_mb: float = setting(
        200.0,
        "recording ends when so little room is left on the disk, MB, before other programs fail for want of it",
        CHOSEN,
        ge=0,
        le=1e6,
    )
    watch_s: float = setting(
        0.5, "seconds between two looks at the camera, the disk and the rates", CHOSEN, gt=0, le=60
    )
    rate_span_s: float = setting(3.0, "seconds over which rates are told", CHOSEN, gt=0, le=3600)
