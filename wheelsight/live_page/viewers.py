"""Viewers: the pages that are open, which of them drives, and what each may still say."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable
from itertools import count

from wheelsight.errors import ArgumentError
from wheelsight.live_page.messages import Alive, Leave, Message, ShowCostmap, Take, parsed, says_stop
from wheelsight.live_page.session import Session
from wheelsight.settings import LivePageSettings

# How many refusals wait for a page that reads slowly.
_REFUSALS = 4
GONE = "the page of whoever drives it is gone"


class SentAwayError(Exception):
    """A page that is not listened to any more.

    Attributes:
        code: of the websocket's close.
    """

    def __init__(self, code: int, why: str) -> None:
        super().__init__(why)
        self.code = code


class Viewer:
    """One page: what waits to be sent to it, of which the newest state wins, and what it said.

    Args:
        number: by which it is known.
        settings: how much it may say.
        now_s: the clock.
    """

    def __init__(self, number: int, settings: LivePageSettings, now_s: Callable[[], float]) -> None:
        self.number, self._settings, self._now_s = number, settings, now_s
        self.heard_s = self._filled_s = now_s()
        self.shows_costmap = False
        self._left, self._bad = 2 * settings.messages_a_s, 0
        self._newest: str | None = None
        self._refusals: deque[str] = deque(maxlen=_REFUSALS)
        self._wake = asyncio.Event()

    def tell(self, text: str) -> None:
        """Send it, in place of what has not gone out yet."""
        self._newest = text
        self._wake.set()

    def refuse(self, text: str) -> None:
        """Send it a line, why what it asked is not done."""
        self._refusals.append(text)
        self._wake.set()

    async def waiting(self) -> list[str]:
        """What is to be sent now; waits for it. JSON."""
        await self._wake.wait()
        self._wake.clear()
        found = [json.dumps({"refused": text}) for text in self._refusals]
        self._refusals.clear()
        newest, self._newest = self._newest, None
        return found if newest is None else [*found, newest]

    def count_message(self) -> None:
        """It said something. Raises SentAwayError: too often."""
        now_s, s = self._now_s(), self._settings
        self._left = min(self._left + (now_s - self._filled_s) * s.messages_a_s, 2 * s.messages_a_s) - 1
        self._filled_s = self.heard_s = now_s
        if self._left < 0:
            raise SentAwayError(1008, "too many messages")

    def count_bad(self) -> None:
        """It said what makes no sense. Raises SentAwayError: too often."""
        self._bad += 1
        if self._bad >= self._settings.most_bad:
            raise SentAwayError(1008, "too many messages that make no sense")


class Viewers:
    """All of them; lives in one event loop.

    Args:
        session: that they see and ask.
        settings: of the page.
        on_refusal: told in a line who was refused, and why.
        now_s: the clock.
    """

    def __init__(
        self,
        session: Session,
        settings: LivePageSettings,
        on_refusal: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session, self._settings, self._on_refusal, self._now_s = session, settings, on_refusal, now_s
        self._viewers: dict[int, Viewer] = {}
        self._numbers = count(1)
        self._driver: Viewer | None = None

    def __len__(self) -> int:
        return len(self._viewers)

    @property
    def driver(self) -> int | None:
        """The number of the page that drives."""
        return None if self._driver is None else self._driver.number

    def join(self) -> Viewer:
        """One more. Raises SentAwayError: there are too many."""
        if len(self._viewers) >= self._settings.most_viewers:
            raise SentAwayError(1013, f"too many pages are open: {self._settings.most_viewers}")
        viewer = Viewer(next(self._numbers), self._settings, self._now_s)
        self._viewers[viewer.number] = viewer
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """It is gone; a robot that it drives stops."""
        self._viewers.pop(viewer.number, None)
        self._look_for_costmap()
        if viewer is self._driver:
            self._lose_driver()

    def hear(self, viewer: Viewer, message: str | bytes | None) -> None:
        """Do what a page says. Raises SentAwayError: it is to go."""
        if isinstance(message, str) and len(message) <= self._settings.most_bytes and says_stop(message):
            # Before all else, and counted after: who is in need presses often.
            self._session.stop("somebody pressed STOP")
            viewer.count_message()
            return
        viewer.count_message()
        if not isinstance(message, str):
            raise SentAwayError(1003, "a message that is no text")
        if len(message.encode("utf-8", "replace")) > self._settings.most_bytes:
            raise SentAwayError(1009, f"a message of more than {self._settings.most_bytes} bytes")
        try:
            asked = parsed(message)
        except ArgumentError as error:
            viewer.refuse(str(error))
            self._on_refusal(f"refused page {viewer.number}: {error}")
            viewer.count_bad()
            return
        self._do(viewer, asked)

    def tell_all(self) -> None:
        """The newest state to each, as one text; and look whether the driver is still there."""
        driver = self._driver
        if driver is not None and self._now_s() - driver.heard_s > self._settings.driver_silent_s:
            self._lose_driver()
        if not self._viewers:
            return
        snapshot = self._session.latest
        age_s = time.monotonic() - snapshot.made_s
        about = f'"age_s":{age_s:.2f},"driver":{self.driver or "null"},"viewers":{len(self)}'
        text = f'{{{about},"robot":{snapshot.text}}}'
        for viewer in self._viewers.values():
            viewer.tell(text)

    def _do(self, viewer: Viewer, asked: Message) -> None:
        if isinstance(asked, Alive):
            return
        if isinstance(asked, ShowCostmap):
            viewer.shows_costmap = asked.shown
            self._look_for_costmap()
        elif isinstance(asked, Take):
            self._driver = viewer
        elif isinstance(asked, Leave):
            if viewer is self._driver:
                self._lose_driver()
        elif self._driver not in (None, viewer):
            viewer.refuse("another page drives: take control first")
        else:
            # Who asks first drives.
            self._driver = viewer
            refused = self._session.ask(asked)
            if refused:
                viewer.refuse(refused)

    def _lose_driver(self) -> None:
        self._driver = None
        if self._settings.stops_without_driver and self._session.latest.is_driving:
            self._session.stop(GONE)

    def _look_for_costmap(self) -> None:
        self._session.wants_costmap = any(viewer.shows_costmap for viewer in self._viewers.values())
