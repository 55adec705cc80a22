"""Pictures of ``heaved page`` by a headless Chromium, to look at: by day and by night, lying and standing.

    tools/page_shots.py http://127.0.0.1:8570/ -o shots

The page must be served already, of a demo for example. What the browser can say of the page besides, tests ask it with
:class:`Browser`.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import shutil
import tempfile
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import aiohttp

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

CHROMIUM: Final = shutil.which("chromium") or shutil.which("chromium-browser")
SHOTS: Final = (
    ("day", 1280, 800),
    ("night", 1280, 800),
    ("contrast", 1280, 800),
    ("day", 800, 1280),
    ("night", 800, 1280),
)
_START_S: Final = 30.0
_ANSWER_S: Final = 20.0
_SETTLE_S: Final = 1.5


class Browser:
    """One tab of a headless Chromium, driven over the DevTools protocol."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._asked = 0

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Ask, and wait for the answer; events meanwhile are passed over.

        Raises:
            RuntimeError: the browser refuses.
        """
        self._asked += 1
        await self._socket.send_json({"id": self._asked, "method": method, "params": params})
        async with asyncio.timeout(_ANSWER_S):
            while (answer := await self._socket.receive_json()).get("id") != self._asked:
                pass
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return dict(answer["result"])

    async def evaluate(self, script: str) -> Any:
        """The value of an expression, a promise awaited.

        Raises:
            RuntimeError: it throws.
        """
        done = await self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in done:
            raise RuntimeError(f"{script}: {done['exceptionDetails']}")
        return done["result"].get("value")

    async def until(self, script: str) -> Any:
        """Wait for an expression to be truthy; the last value that it had."""
        async with asyncio.timeout(_ANSWER_S):
            while not (value := await self.evaluate(script)):  # noqa: ASYNC110  # The page tells nothing by itself.
                await asyncio.sleep(0.05)
        return value

    async def show(self, address: str, width: int, height: int) -> None:
        """Open a page in a window of this size."""
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        await self.call("Page.navigate", url=address)
        await self.until("document.readyState === 'complete'")

    async def picture(self) -> bytes:
        """What is shown, as a PNG."""
        shot = await self.call("Page.captureScreenshot", format="png")
        return base64.b64decode(shot["data"])


@asynccontextmanager
async def browser() -> AsyncIterator[Browser]:
    """A Chromium that has never been used before, and is gone at the end.

    Raises:
        FileNotFoundError: there is none on this machine.
    """
    if CHROMIUM is None:
        raise FileNotFoundError("chromium: not on this machine (Debian: apt install chromium)")
    with tempfile.TemporaryDirectory(prefix="heaved-page-", ignore_cleanup_errors=True) as profile:
        process = await asyncio.create_subprocess_exec(
            CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
            "--disable-component-update", "--no-first-run", "--remote-debugging-port=0",
            f"--user-data-dir={profile}", "about:blank",
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        try:
            port = await _debugging_port(Path(profile) / "DevToolsActivePort")
            async with aiohttp.ClientSession() as session:
                async with session.get(f"http://127.0.0.1:{port}/json/list") as answer:
                    tabs = await answer.json()
                tab = next(tab for tab in tabs if tab["type"] == "page")
                async with session.ws_connect(tab["webSocketDebuggerUrl"], max_msg_size=0) as socket:
                    yield Browser(socket)
        finally:
            process.terminate()
            try:
                await asyncio.wait_for(process.wait(), _ANSWER_S)
            except TimeoutError:
                process.kill()
                await process.wait()


async def _debugging_port(said: Path) -> int:
    """The port that the browser writes into a file once it listens."""

    def port() -> int | None:
        lines = said.read_text().splitlines() if said.exists() else []
        return int(lines[0]) if lines else None

    async with asyncio.timeout(_START_S):
        while (found := await asyncio.to_thread(port)) is None:  # noqa: ASYNC110  # A file has no event.
            await asyncio.sleep(0.05)
    return found


async def pictures(address: str) -> AsyncIterator[tuple[str, bytes]]:
    """(name, PNG) of each of :data:`SHOTS`."""
    async with browser() as tab:
        for theme, width, height in SHOTS:
            await tab.show(address, width, height)
            await tab.evaluate(f"localStorage.setItem('heaved-theme', '{theme}')")
            await tab.show(address, width, height)
            await tab.until("document.getElementById('where').textContent.includes(':')")
            await asyncio.sleep(_SETTLE_S)  # For the eye alone.
            yield f"{theme}-{width}x{height}.png", await tab.picture()


async def take(address: str) -> list[tuple[str, bytes]]:
    return [shot async for shot in pictures(address)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="of the page")
    parser.add_argument("-o", "--out", type=Path, default=Path("shots"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, picture in asyncio.run(take(arguments.address)):
        (arguments.out / name).write_bytes(picture)
        print(arguments.out / name)


if __name__ == "__main__":
    main()
