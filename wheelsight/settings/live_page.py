"""LivePageSettings: what the page of `wheelsight serve` shows, how often, and what it takes from whom."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting


class LivePageSettings(Settings):
    """Of `wheelsight serve`."""

    updates_hz: float = setting(10.0, "updates a second to each page", "issue 34", gt=0, le=50)
    images_hz: float = setting(
        2.0, "images of the camera, the map and the costmap a second, at most: a phone's network", CHOSEN, gt=0, le=30
    )
    image_px: int = setting(320, "width of the camera's image, at most, pixels", CHOSEN, ge=32, le=1920)
    jpeg_quality: int = setting(60, "of the camera's image, of 100: about 10 kB", CHOSEN, ge=5, le=100)
    way_points: int = setting(
        300, "points of the way driven that a page is sent, the newest, 0.1 m apart", CHOSEN, ge=2, le=5000
    )
    old_s: float = setting(
        1.0, "a page without an update for so long says so, and shows its plan in grey", "issue 34", ge=0.2, le=10
    )
    stops_without_driver: bool = setting(
        True, "whether the robot stops where the page of whoever drives it is gone while it drives", CHOSEN
    )
    driver_silent_s: float = setting(
        2.0,
        "a driver's page that says nothing for so long is gone: it says so twice a second, once where a browser has it "
        "in the background; a network that is lost closes no connection",
        CHOSEN,
        ge=0.6,
        le=60,
    )
    switch_s: float = setting(
        0.001,
        "for which a thread keeps Python to itself while others wait, of 0.005 else: STOP passes from thread to thread",
        "python -m benchmarks.live_page: worst of 100 stops 50 ms after the press with 0.005",
        ge=0.0001,
        le=0.1,
    )
    most_viewers: int = setting(8, "pages at once", CHOSEN, ge=1, le=200)
    most_connections: int = setting(
        64, "connections at once, with those that fetch images: a browser opens six", CHOSEN, ge=8, le=2000
    )
    most_bytes: int = setting(
        2048, "of a message from a page; the longest that one sends has 200", CHOSEN, ge=256, le=1_000_000
    )
    messages_a_s: float = setting(
        20.0,
        "messages a second from a page, after a burst of twice as many: clicks, and twice a second that it is there",
        CHOSEN,
        gt=2,
        le=1000,
    )
    most_bad: int = setting(10, "messages that make no sense before a page is sent away", CHOSEN, ge=1, le=1000)
    send_s: float = setting(
        2.0, "a page that takes nothing for so long, with its buffer full, is sent away", CHOSEN, gt=0, le=60
    )
