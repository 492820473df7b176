"""BatchSettings: what a batch goes by, with the reasons for the defaults."""

from __future__ import annotations

from wheelsight.settings import CHOSEN, Settings, setting


class BatchSettings(Settings):
    """How recordings are told apart, and when a figure is worse than before.

    Of a batch, not of a run: nothing here changes what a run finds, so it is no part of `Config`.
    """

    whole_bytes: int = setting(
        1 << 20,
        "files up to so many bytes are read whole to tell whether they changed: images and lists are smaller, and a "
        "run reads them anyway",
        CHOSEN,
        ge=1,
        le=1 << 40,
    )
    piece_bytes: int = setting(
        1 << 16,
        "of a larger one, such as a bag, its beginning, middle and end of so many bytes are, with its size and when it "
        "was written",
        CHOSEN,
        ge=1,
        le=1 << 30,
    )
    tries: int = setting(
        2,
        "a job whose process was killed is run so many times in all: memory may have been short by chance",
        CHOSEN,
        ge=1,
        le=10,
    )
    tolerance: float = setting(
        0.1, "share by which a figure may be worse than the baseline's", "asked for by issue 34", ge=0, le=100
    )
    least_error: float = setting(
        1e-4,
        "an error that grew by less is not worse, metres or degrees: two versions of a library differ so",
        CHOSEN,
        ge=0,
        le=1,
    )
    least_share: float = setting(
        0.005, "likewise, of the share of frames with a pose: a frame or two of a short recording", CHOSEN, ge=0, le=1
    )
    connect_s: float = setting(10.0, "how long a scheduler may take to answer, seconds", CHOSEN, gt=0, le=3600)
