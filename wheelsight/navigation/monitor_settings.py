"""MonitorSettings: what the collision monitor goes by."""

from __future__ import annotations

from wheelsight.settings import CHOSEN, Settings, setting


class MonitorSettings(Settings):
    """When a robot goes slower than it is told, and when it stands."""

    margin_m: float = setting(
        0.04, "nearer than this nothing may come; depth at half a metre errs by less", CHOSEN, ge=0, le=1
    )
    reaction_s: float = setting(
        0.3, "from a thing's being seen to the brakes: a frame, a period, the link, the base's lag", CHOSEN, ge=0, le=3
    )
    braking_share: float = setting(
        0.8, "of the limits' braking that is reckoned with; floors are wet, batteries low", CHOSEN, gt=0, le=1
    )
    slow_zone_m: float = setting(0.2, "distance within which things make it slower", CHOSEN, ge=0, le=3)
    slow_m_s: float = setting(0.35, "speed beside things within the slow-down zone", CHOSEN, gt=0, le=3)
    slow_rad_s: float = setting(0.5, "turn beside them", CHOSEN, gt=0, le=4)
    inside_m: float = setting(
        0.1, "a point deeper than this within the outline contradicts it, and nothing moves", CHOSEN, ge=0, le=1
    )
    coasting_m_s: float = setting(0.35, "speed while wheels alone lead", "docs/fusion.md: slows down", gt=0, le=3)
    coasting_rad_s: float = setting(0.5, "turn while wheels alone lead", "docs/fusion.md: slows down", gt=0, le=4)
    frame_age_s: float = setting(
        0.3, "age of the newest usable frame beyond which it stands: 3 frames of 10 a second", CHOSEN, gt=0, le=5
    )
    frame_way_m: float = setting(
        0.24,
        "way driven since the newest usable frame beyond which it stands: at 1 m/s a control period adds 0.05 m, and "
        "0.3 m may be driven blind",
        "issue 32",
        gt=0,
        le=5,
    )
    encoder_age_s: float = setting(
        0.15, "age of the newest wheel reading beyond which it stands: 3 of 20 a second", CHOSEN, gt=0, le=5
    )
    ahead_s: float = setting(0.05, "by which a stamp may lie ahead of now; clocks err by less", CHOSEN, ge=0, le=1)
    seen_share: float = setting(
        0.3,
        "share of bearings that must show something, for a frame to be usable: a hand leaves none",
        CHOSEN,
        ge=0,
        le=1,
    )
    blind_m_s: float = setting(0.2, "speed onto floor that was not seen lately, and backward", CHOSEN, gt=0, le=1)
    blind_rad_s: float = setting(0.5, "turn over floor that was not seen lately", CHOSEN, gt=0, le=4)
    blind_m: float = setting(
        0.3, "how far the outline may reach into floor that was never seen", "issue 32", ge=0, le=2
    )
    lead_m: float = setting(
        0.1,
        "how deep the front may be in floor never seen, for what it passes over to count as seen: a corner leads the "
        "view of 60° by 0.04 m in a turn",
        "reckoned",
        ge=0,
        le=1,
    )
    air_m: float = setting(
        0.5,
        "from the camera, how near it looks over floor that it does not see: what stands up into its lowest ray there "
        "would show. A Kinect measures nothing nearer",
        CHOSEN,
        ge=0,
        le=5,
    )
    fresh_s: float = setting(
        12.0,
        "time for which floor counts as seen; who comes later is seen coming. A chair whose camera sees the floor from "
        "2.3 m on takes 7.5 s at 0.2 m/s until its front is there, and longer where it waits: docs/decisions/0129",
        CHOSEN,
        gt=0,
        le=600,
    )
    remember_s: float = setting(
        600.0,
        "time for which a thing out of sight counts, however little was driven; what has gone is seen through sooner",
        CHOSEN,
        gt=0,
        le=3600,
    )
    remember_m: float = setting(
        10.0,
        "way that the farthest corner may go until then: wheels err by 1 % of it, which is 0.1 m, as inside_m",
        "reckoned",
        gt=0,
        le=1000,
    )
    cell_m: float = setting(0.03, "side of the cells by which floor is remembered", CHOSEN, gt=0.005, le=0.2)
    window_m: float = setting(
        6.0, "side of the square about the robot that is remembered; twice what a stop needs", "reckoned", gt=1, le=40
    )
    history_s: float = setting(
        1.0, "time for which poses by wheels are kept, for frames that come late", CHOSEN, gt=0, le=10
    )
    gap_s: float = setting(
        0.5, "gap between wheel readings after which nobody knows where remembered things are", CHOSEN, gt=0, le=10
    )
    step_m: float = setting(
        0.02, "way of the outline between two poses of an arc that are judged", CHOSEN, gt=0.002, le=0.2
    )


class WheelCheckSettings(Settings):
    """Whether a base does what it is told."""

    off_m_s: float = setting(
        0.15, "speed beyond what acceleration explains: a wheel that hangs is off by half the speed", CHOSEN, gt=0, le=2
    )
    off_rad_s: float = setting(0.3, "turn beyond that likewise", CHOSEN, gt=0, le=4)
    off_s: float = setting(0.3, "for so long", "issue 32", gt=0, le=5)
    lag_s: float = setting(0.3, "the latest that a base answers a command", CHOSEN, ge=0, le=2)
    held_s: float = setting(
        0.2,
        "for which a base keeps a command at least, before it stands by itself",
        "as wheel_control.hold_s",
        gt=0,
        le=5,
    )
    watchdog_s: float = setting(0.25, "and at most", "the firmware's watchdog: docs/serial-link.md", gt=0, le=5)
    slow_share: float = setting(0.5, "of the limits' accelerations that the slowest base still has", CHOSEN, gt=0, le=1)
    fast_share: float = setting(1.5, "of them that the quickest has", CHOSEN, ge=1, le=10)


class ViewSettings(Settings):
    """What a collision monitor is told of a depth image."""

    columns: int = setting(
        64,
        "bearings that the view is cut into, at most one for two pixels of a row: each is 0.9° of a Kinect's",
        CHOSEN,
        ge=8,
        le=1024,
    )
    cell_m: float = setting(0.05, "side of a cell in which pixels are one thing", CHOSEN, gt=0.005, le=0.5)
    pixels: int = setting(
        3, "least pixels of a thing in a cell: at edges single ones lie where nothing is", CHOSEN, ge=1, le=100
    )
    bin_m: float = setting(0.1, "of distance, in which floor was seen or not", CHOSEN, gt=0.01, le=1)
    gap_m: float = setting(
        0.3,
        "without a floor, behind which floor is seen no more: nothing lower than the chair's step hides so little",
        CHOSEN,
        gt=0,
        le=2,
    )
