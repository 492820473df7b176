"""FramedChip: what all simulated controllers have alike, since they speak in the same frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from wheelsight.io.devices.wire_formats import (
    Ack,
    Counts,
    FrameDecoder,
    LinkCommand,
    Message,
    Nearby,
    Version,
    encode_command,
)


class FramedChip(ABC):
    """A running chip, whose line is read and written in frames."""

    def __init__(self) -> None:
        self._decoder, self._sequence = FrameDecoder(), 0

    @abstractmethod
    def run(self, seconds: float) -> None:
        """Let the chip's time pass."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Put bytes on the line to the chip, at its pace."""

    @abstractmethod
    def sent(self) -> Sequence[tuple[float, int]]:
        """The bytes that the chip has sent since last asked, each with when it began."""

    def command(self, command: int, body: bytes = b"") -> int:
        """Send a command's frame; its sequence."""
        self._sequence = (self._sequence + 1) & 0xFF
        self.send(encode_command(command, self._sequence, body))  # type: ignore[arg-type]
        return self._sequence

    def messages(self) -> list[Message]:
        """What the chip has sent since last asked."""
        return self._decoder.feed(bytes(byte for _, byte in self.sent()))

    def counts(self) -> list[Counts]:
        """Of the messages, the counts."""
        return [message for message in self.messages() if isinstance(message, Counts)]

    def nearby(self) -> list[Nearby]:
        """Of the messages, those of bumpers and rangers."""
        return [message for message in self.messages() if isinstance(message, Nearby)]

    def acks(self) -> list[Ack]:
        """Of the messages, the answers."""
        return [message for message in self.messages() if isinstance(message, Ack)]

    def version(self) -> Version:
        """Ask for the version."""
        self.messages()
        self.command(LinkCommand.GET_VERSION)
        self.run(0.01)
        (version,) = (message for message in self.messages() if isinstance(message, Version))
        return version

    @property
    def lost_frames(self) -> int:
        """Frames that did not come, or damaged."""
        statistics = self._decoder.statistics
        return statistics.lost + statistics.malformed + statistics.crc_errors
