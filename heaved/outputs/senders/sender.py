"""What every link does with the bytes of an output, and how often it is tried when it fails."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from heaved.links import SerialLink, TcpLink, explain_open_failure

if TYPE_CHECKING:
    from heaved.links import AnyLink

DOWN: Final = "down"
"""Why a message is lost: the link is down; or who reads it does not keep up, so that it gave way to a newer one."""
SLOW: Final = "slow"

FIRST_PAUSE_S: Final = 0.25
LONGEST_PAUSE_S: Final = 2.0
"""Between attempts to open a link; it grows from the one to the other, and stays there for ever."""
LOOK_UP_S: Final = 2.0
"""What a name server may take for one attempt."""
STUCK_S: Final = 10.0
"""How long who reads may take nothing at all, while something waits."""


class Sender(Protocol):
    """A link that is kept open for one output, and tells its health."""

    @property
    def has_reader(self) -> bool:
        """Whether it makes sense to send: there is somebody, or one cannot know."""

    def send(self, data: bytes) -> None:
        """Send a whole message now or never; never waits."""

    async def run(self) -> None:
        """Keep it open, for ever; when cancelled, close it."""


def longer(pause_s: float) -> float:
    """The pause after one that was in vain."""
    return min(2.0 * pause_s, LONGEST_PAUSE_S)


def explain(link: AnyLink, error: BaseException) -> str:
    """Why nothing goes out, and what to do about it."""
    if isinstance(link, SerialLink):
        return explain_open_failure(link, error)
    if isinstance(error, ConnectionRefusedError):
        return f"nobody reads {link}, the machine is there: start the program that reads it, or correct the port"
    if isinstance(error, ConnectionError):
        return f"{link} has ended the connection ({error.strerror or error}): connecting anew"
    if isinstance(error, TimeoutError):
        return (
            f"nobody answers at {link}: check power, cable, address, and firewalls between, IPAddressAllow of the unit"
        )
    if isinstance(error, PermissionError):
        return f"the system does not let us send to {link}: allow its network in the firewall, or in the systemd unit"
    explained = explain_open_failure(TcpLink(link.host, link.port), error)
    return f"{explained} ({link})"
