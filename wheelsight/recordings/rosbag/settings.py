"""By what a bag's messages are put in order, and when what they say of themselves is not believed."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting


class BagSettings(Settings):
    """Thresholds of the reader of bags; see docs/bags.md."""

    order_s: float = setting(
        0.5,
        "how long a message waits for older ones of its own topic, by the time of receipt, seconds; it waits longer "
        "until the other topics' stamps have come as far. What is later still is left out and counted",
        CHOSEN,
        gt=0,
        le=10,
    )
    slowest_wheels_s: float = setting(
        5.0,
        "how long frames wait for the wheels' next reading, at most, by stamps, seconds: an increment is known only "
        "once the next reading comes",
        CHOSEN,
        ge=0,
        le=60,
    )
    most_apart_s: float = setting(
        10.0,
        "how far all headers may be from the time of receipt, seconds; beyond, it is said that a replay was recorded, "
        "or that receipt is not believed",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    gravity_s: float = setting(
        2.0,
        "over how many first seconds accelerations are averaged, to know which way is up for the gyroscope: longer "
        "than a start or a bump, shorter than a slope",
        CHOSEN,
        gt=0,
        le=60,
    )
    gravity_share: float = setting(
        0.2,
        "the share by which that average may differ from 9.81 m/s² and be gravity: robots speed up by 2 m/s² at most",
        "2 / 9.81",
        gt=0,
        lt=1,
    )
    gravity_apart_rad: float = setting(
        0.35,
        "how far tf and gravity may disagree on the gyroscope's axis, radians (20°): slopes are less; beyond, tf is "
        "wrong and gravity is believed",
        CHOSEN,
        gt=0,
        le=1.6,
    )
    tf_messages: int = setting(
        400,
        "how many messages of /tf are read for mounts, 4 to 8 s of a robot's: nobody mounts a camera later",
        CHOSEN,
        ge=1,
        le=100_000,
    )
    tf_apart_m: float = setting(
        0.002,
        "by how much two transforms of one mount may differ, metres; beyond, it moves, or tf contradicts itself",
        CHOSEN,
        gt=0,
        le=1,
    )
    tf_apart_rad: float = setting(0.002, "likewise, of their rotations, radians", CHOSEN, gt=0, le=1)
    lens_px: float = setting(
        0.5,
        "how far five coefficients may miss a lens that is described by more, pixels, worst over the image; beyond, it "
        "is said",
        CHOSEN,
        gt=0,
        le=100,
    )
    first_frames_s: float = setting(
        5.0,
        "in how many first seconds of camera images a usable frame must be found for the bag to be opened",
        CHOSEN,
        gt=0,
        le=600,
    )
