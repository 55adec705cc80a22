"""What is worth saying of a device: transitions, not polls. Pure: times are arguments, what to log is returned."""

from __future__ import annotations

from collections import Counter
from math import inf, isfinite
from typing import Literal

import msgspec

from heaved.samples import Fault

DOWN_AFTER_POLLS = 3
"""So many faults in a row, and the device is down: single lost answers are everyday life on a serial line."""
DOWN_AFTER_S = 1.0
"""It must also have lasted so long before it is said: a line that has just been opened is first brought into step."""
BACK_AFTER_S = 1.0
"""A device is back when it has held for so long ..."""
BACK_AFTER_RELAPSE_S = 60.0
"""... or for so long, if it failed again within as much: a loose plug is no reason to flood the log."""
SUMMARY_PERIOD_S = 60.0
"""Single faults of a device that is up are summed up at most this often."""
MOSTLY_FAULTS_AFTER_S = 5.0
"""... but the first time so soon, if most polls fail: with a wrong byte order a few values are plausible by chance."""
_RATE_WINDOW_S = 2.0
_RATE_FIRST_S = 0.5


class Event(msgspec.Struct, frozen=True):
    """One line for the log."""

    level: Literal["info", "warning"]
    text: str
    fields: dict[str, str | int | float]


class RateMeter:
    """Events a second, over the last seconds."""

    def __init__(self) -> None:
        self._since_s = -inf
        self._count = 0
        self._per_s = 0.0

    def count(self, t_s: float) -> None:
        """One event."""
        elapsed_s = t_s - self._since_s
        if elapsed_s >= _RATE_WINDOW_S:
            self._per_s = self._count / elapsed_s if elapsed_s < 2.0 * _RATE_WINDOW_S else 0.0
            self._since_s, self._count = t_s, 0
        self._count += 1

    def per_s(self, t_s: float) -> float:
        """0 when nothing has come for a while. Until the first window is full, what there is of it."""
        elapsed_s = t_s - self._since_s
        if elapsed_s >= 2.0 * _RATE_WINDOW_S:
            return 0.0
        if self._per_s == 0.0 and elapsed_s >= _RATE_FIRST_S:
            return (self._count - 1) / elapsed_s  # The first event opened the window.
        return self._per_s


class DeviceHealth:
    """Follows the polls of one device.

    Attributes:
        up: it gives good samples, but for single faults.
        results: polls since the start by how they ended.
        last_fault, last_fault_s, detail: the latest fault, when it was, and what it said.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self.up = False
        self.results: Counter[Fault] = Counter()
        self.last_fault: Fault | None = None
        self.last_fault_s = -inf
        self.detail = ""
        self._good = RateMeter()
        self._run = 0
        """Faults since the last good sample."""
        self._run_since_s = inf
        self._said_down = False
        self._said_up = False
        self._outage: Counter[Fault] = Counter()
        self._outage_said: set[Fault] = set()
        self._outage_since_s = -inf
        self._held_since_s = inf
        self._back_s = -inf
        self._back_after_s = BACK_AFTER_S
        self._singles: Counter[Fault] = Counter()
        self._singles_since_s = -inf
        self._singles_polls = 0
        self._summary_s = -inf

    def rate_hz(self, t_s: float) -> float:
        """Good samples a second, measured."""
        return self._good.per_s(t_s)

    def observe(self, t_s: float, fault: Fault, detail: str) -> Event | None:
        """Account for one poll; returns what to log about it, mostly nothing."""
        self.results[fault] += 1
        if fault is Fault.NONE:
            return self._good_poll(t_s)
        self.last_fault, self.last_fault_s, self.detail = fault, t_s, detail
        return self._faulty_poll(t_s, fault, detail)

    def _good_poll(self, t_s: float) -> Event | None:
        self._good.count(t_s)
        self._run = 0
        if not self.up:
            self.up, self._held_since_s = True, t_s
        if self._said_down:
            return self._back(t_s) if t_s - self._held_since_s >= self._back_after_s else None
        if not self._said_up:
            self._said_up = True
            self._singles.clear()  # A line that opened a moment after the first polls has lost nothing.
            return Event("info", "device up", {"device": self.device})
        return self._summary(t_s)

    def _faulty_poll(self, t_s: float, fault: Fault, detail: str) -> Event | None:
        if self._run == 0:
            self._run_since_s = t_s
        self._run += 1
        if self._run >= DOWN_AFTER_POLLS:
            self.up = False
        if self._said_down:
            self._outage[fault] += 1
            # A single lost answer of a device that has come back, but is not reported yet, is no news.
            return None if self.up or fault in self._outage_said else self._changed(fault, detail)
        if not self.up and t_s - self._run_since_s >= DOWN_AFTER_S:
            return self._down(t_s, fault, detail)
        if not self._singles:
            self._singles_since_s, self._singles_polls = t_s, self.results.total()
        self._singles[fault] += 1
        return None

    def _down(self, t_s: float, fault: Fault, detail: str) -> Event:
        self._said_down, self._outage_since_s = True, self._run_since_s
        self._outage = Counter({fault: self._run})
        self._outage_said, self._held_since_s = {fault}, inf
        self._singles.clear()
        fields: dict[str, str | int | float] = {"device": self.device, "fault": fault.value, "detail": detail}
        self._back_after_s = BACK_AFTER_S
        if t_s - self._back_s < BACK_AFTER_RELAPSE_S:
            self._back_after_s = BACK_AFTER_RELAPSE_S
            fields["note"] = f"failed again: reported as back only once it has held for {BACK_AFTER_RELAPSE_S:g} s"
        return Event("warning", "device down", fields)

    def _changed(self, fault: Fault, detail: str) -> Event:
        self._outage_said.add(fault)
        fields: dict[str, str | int | float] = {"device": self.device, "fault": fault.value, "detail": detail}
        state = "down again" if isfinite(self._held_since_s) else "still down"
        return Event("warning", f"device {state}, another fault", fields)

    def _back(self, t_s: float) -> Event:
        self._said_down, self._said_up, self._back_s = False, True, t_s
        outage_s = self._held_since_s - self._outage_since_s
        faults = {fault.value: count for fault, count in self._outage.items()}
        return Event("info", "device back", {"device": self.device, "away_s": round(outage_s, 3), **faults})

    def _summary(self, t_s: float) -> Event | None:
        polls = self.results.total() - self._singles_polls + 1
        is_early = 2 * self._singles.total() > polls and t_s - self._summary_s >= SUMMARY_PERIOD_S
        if not self._singles or t_s - self._singles_since_s < (MOSTLY_FAULTS_AFTER_S if is_early else SUMMARY_PERIOD_S):
            return None
        faults = {fault.value: count for fault, count in self._singles.items()}
        self._singles.clear()
        self._summary_s = t_s
        fields: dict[str, str | int | float] = {"device": self.device, "polls": polls, **faults, "detail": self.detail}
        return Event("warning", "device loses samples", fields)
