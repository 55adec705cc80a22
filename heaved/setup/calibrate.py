"""``heaved calibrate``: how the sensors of a configuration are mounted, step by step, and into the configuration.

Each step makes a record, says what it shows, and asks whether it is to be kept. What was kept is on disk at once: a
calibration that was interrupted goes on where it was. The configuration is changed at the end, after the difference was
shown. With a recording in place of the devices the steps that need nobody on board are done without a question.
"""

from __future__ import annotations

import os
import re
from enum import StrEnum
from math import degrees, radians
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.config.read import ConfigError
from heaved.devices.bandwidth import bandwidth_hz, lag_ms
from heaved.devices.mounting import Vector, mounting_lines
from heaved.samples import GRAVITY_MPS2
from heaved.setup import calibrate_laser as laser
from heaved.setup import calibrate_latency as latency
from heaved.setup import calibrate_rest as rest
from heaved.setup import calibrate_signs as signs
from heaved.setup import calibrate_state as kept
from heaved.setup import calibrate_turn as turn
from heaved.setup import edit
from heaved.setup.calibrate_live import DeviceError, read_devices
from heaved.setup.calibrate_record import Record, joined
from heaved.setup.calibrate_turn import Tilted
from heaved.setup.console import Console, QuitError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec

ABOUT_VERTICAL: Final = (
    "how far it is turned about the vertical does not show at rest: as the configuration has it (the last of "
    "rotation_deg), until two tilts show it."
)
LIFT_S: Final = 10.0
SEA_S: Final = 300.0
MOST_LIST_DEG: Final = 20.0
LEAST_DEG: Final = 0.001
"""No standard error is shown smaller."""

KEEP: Final = {"": "keep and go on", "r": "repeat", "s": "skip", "q": "quit"}
BEGIN: Final = {"": "begin", "s": "skip", "q": "quit"}
WITH_MORE: Final = {"": "keep and go on", "m": "more of it", "r": "repeat", "s": "skip", "q": "quit"}
AGAIN: Final = {"": "repeat", "s": "skip", "q": "quit"}
TILTS: Final = {
    "1": "bow up", "2": "bow down", "3": "port side up", "4": "port side down", "s": "skip", "q": "quit",
}  # fmt: skip
TILTED: Final = {"1": Tilted.BOW_UP, "2": Tilted.BOW_DOWN, "3": Tilted.PORT_UP, "4": Tilted.PORT_DOWN}


class CalibrationError(Exception):
    """The calibration cannot be done, or not be written; the message says why and what to do."""


class Step(StrEnum):
    """In order."""

    REST = "rest"
    SIGNS = "signs"
    TILT = "tilt"
    LATENCY = "latency"
    LASER = "laser"


FAILURES: Final = (
    rest.RestError, signs.SignsError, turn.TiltError, latency.LatencyError, laser.LaserError, DeviceError,
)  # fmt: skip


class Outcome(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What ``--json`` prints."""

    device: str
    found: kept.Found
    changes: dict[str, dict[str, Any]]
    """By table: the keys that change."""
    written: bool
    notes: tuple[str, ...] = ()
    """Steps of which nothing came, and why; and what is doubtful."""


class Calibration:
    """One configuration on its way. Attributes: ``found`` is what is known, ``notes`` what is to be told."""

    def __init__(self, path: Path, config: Config, console: Console, *, text: str) -> None:
        """``text``: of the configuration as it was read.

        Raises:
            CalibrationError: it has no IMU, or is written in a way in which it could not be changed in the end.
        """
        self.path, self.config, self.console, self.text = path, config, console, text
        numbers = [i for i, device in enumerate(config.device) if device.role == "imu"]
        if not numbers:
            raise CalibrationError(f'{path}: there is no device of role "imu" to calibrate')
        self.number = numbers[0]
        self.device: DeviceSpec = config.device[self.number]
        self.found = kept.Found(device=self.device.name, fingerprint=kept.fingerprint(self.device))
        try:
            edit.with_keys(text, "device", {"rotation_deg": self.device.rotation_deg}, index=self.number)
        except edit.EditError as error:
            raise CalibrationError(f"{path}: {error}") from error
        self.notes: list[str] = []

    # ---- what records say --------------------------------------------------------------------------------------------

    def take_rest(self, record: Record, list_deg: tuple[float, float]) -> None:
        """What a record at rest says.

        Raises:
            RestError: nothing.
        """
        found = rest.rest_of(record)
        roll, pitch = list_deg
        turned = turn.by_rest(
            found.up, found.up_std_rad, z_deg=self.device.rotation_deg[2], roll_rad=radians(roll),
            pitch_rad=radians(pitch),
        )  # fmt: skip
        self.found = msgspec.structs.replace(
            self.found, rest=found, list_deg=list_deg, turned=turned, tilt=None, tilted=None
        )

    def take_tilt(self, record: Record, tilted: Tilted) -> None:
        """What a second record says, with something lifted.

        Raises:
            RestError, TiltError: nothing.
        """
        first = self.found.rest
        if first is None:
            raise turn.TiltError("it is held against the rest before it: do that step first")
        second = rest.rest_of(record)
        if first.has_attitude is not second.has_attitude:
            raise turn.TiltError("one of the two records has angles and the other has none: repeat the rest")
        roll, pitch = self.found.list_deg
        turned = turn.by_two(
            first.up, second.up, max(first.up_std_rad, second.up_std_rad), tilted, roll_rad=radians(roll),
            pitch_rad=radians(pitch),
        )  # fmt: skip
        self.found = msgspec.structs.replace(self.found, tilt=second, tilted=tilted, turned=turned)

    def take_latency(self, record: Record) -> None:
        """What a record in motion says.

        Raises:
            LatencyError: nothing.
        """
        if wrong := signs.judge_motion(record):
            raise latency.LatencyError("; ".join(wrong))
        hertz = bandwidth_hz(self.device)
        found = latency.latency_of(record, lag_ms(hertz) * 1e-3 if hertz else 0.0)
        self.found = msgspec.structs.replace(self.found, latency=found)

    def take_laser(self, record: Record) -> None:
        """Likewise of the laser.

        Raises:
            LaserError: nothing.
        """
        mounting = kept.mounting_deg(self.found) or self.device.rotation_deg
        bias = self.device.bias_mps2 if self.found.rest is None else self.found.rest.bias_mps2
        late_s = self.device.attitude_latency_ms * 1e-3
        if self.found.latency is not None:
            late_s = self.found.latency.late_s
        motion = laser.motion_of(record, rotation_deg=mounting, bias_mps2=bias, attitude_late_s=late_s)
        found = laser.geometry_of(record, motion, self.config.laser.geometry)
        self.found = msgspec.structs.replace(self.found, laser=found, laser_by_rates=record.has_rates)

    # ---- in words ----------------------------------------------------------------------------------------------------

    def tell_rest(self) -> None:
        """What the rest has shown."""
        found, turned = self.found.rest, self.found.turned
        assert found is not None
        assert turned is not None
        say = self.console.say
        moved = f"it moved by {degrees(found.tilt_rms_rad):.2f} degrees and {found.force_rms_mps2:.3f} m/s2 RMS"
        say(f"{found.seconds:.0f} s; {moved}.", "  ")
        by = "its angles" if found.has_attitude else "its accelerometers, for it has no angles"
        say(f"Tilt by {by}, to {max(degrees(found.up_std_rad), LEAST_DEG):.3f} degrees:", "  ")
        self._tell_mounting(turned.rotation_deg)
        bias = ", ".join(f"{part:+.3f}" for part in found.bias_mps2)
        say(f"Bias of the accelerometers in its axes: {bias} m/s2, to {found.bias_std_mps2:.4f}.", "  ")
        for note in self.rest_notes():
            say(f"Note: {note}", "  ")

    def rest_notes(self) -> list[str]:
        """What the rest does not show."""
        found = self.found.rest
        if found is None:
            return []
        notes = [] if self.found.tilt is not None else [ABOUT_VERTICAL]
        unknown = rest.TUNING.unknown_mps2
        hidden = degrees(unknown / GRAVITY_MPS2)
        if not found.has_attitude:
            notes.append(
                "without angles only the bias along the vertical shows. What there is across it tilts the result: "
                f"{unknown:g} m/s2, as good sensors may have, by {hidden:.2f} degrees in either direction."
            )
        elif found.levels_itself:
            notes.append(
                "angles and accelerometers agree so well that the one comes from the other: a bias across the vertical "
                f"is not seen, and tilts both; {unknown:g} m/s2 would be {hidden:.2f} degrees."
            )
        if max(abs(part) for part in found.bias_mps2) > rest.TUNING.great_mps2:
            notes.append(
                "that is no bias: a sign, a unit or the scale is wrong in the profile. It will not be written; see the "
                "step signs."
            )
        return notes

    def tell_tilt(self) -> None:
        """What two tilts have shown."""
        turned = self.found.turned
        assert turned is not None
        self.console.say(f"The two tilts are {degrees(turned.apart_rad):.2f} degrees apart.", "  ")
        self.console.say(
            f"Mounting, to {max(degrees(turned.tilt_std_rad), LEAST_DEG):.3f} degrees of tilt and "
            f"{max(degrees(turned.turn_std_rad), LEAST_DEG):.3f} about the vertical:",
            "  ",
        )
        self._tell_mounting(turned.rotation_deg)
        if turned.turn_std_rad > turn.DOUBTFUL_RAD:
            self.console.say(
                f"Note: {degrees(turned.turn_std_rad):.2f} degrees about the vertical put {turned.turn_std_rad:.1%} of "
                "the roll into the pitch. A greater tilt, or longer records, show more.",
                "  ",
            )

    def tell_latency(self) -> None:
        """What motion has shown of the angles."""
        found = self.found.latency
        assert found is not None
        age = "older" if found.late_s > 0.0 else "younger"
        self.console.say(
            f"The angles are {abs(found.late_s) * 1e3:.1f} ms {age} than the body rates, to "
            f"{found.late_std_s * 1e3:.1f} ms ({found.seconds:.0f} s). They move as the rates say to "
            f"{found.explained:.1%}.",
            "  ",
        )
        if found.lean_per_s > kept.SIGNIFICANT * found.lean_std_per_s:
            self.console.say(
                f"They lean into horizontal acceleration, with a time constant of {1.0 / found.lean_per_s:.0f} s: the "
                "daemon finds that by itself.",
                "  ",
            )
        for note in self.latency_notes():
            self.console.say(f"Note: {note}", "  ")

    def latency_notes(self) -> list[str]:
        """What is doubtful of it."""
        found = self.found.latency
        if found is None or found.late_std_s <= latency.TUNING.known_s:
            return []
        if found.late_std_s > kept.LATENCY_STD_S:
            return [f"{found.late_std_s * 1e3:.0f} ms are too uncertain to be written: more motion, or more of it."]
        return ["a longer record, or more motion, makes it surer; 3 ms are good."]

    def tell_laser(self) -> None:
        """What motion has shown of the laser."""
        found = self.found.laser
        assert found is not None
        grows, ahead = "grows" if found.geometry.sign > 0 else "shrinks", found.foot_forward_m
        self.console.say(f"Its reading {grows} as the vessel rises (sign = {found.geometry.sign}).", "  ")
        self.console.say(
            f"Its beam meets the target {abs(found.foot_forward_m):.2f} m {'aft' if ahead < 0.0 else 'forward'} of the "
            f"IMU, to {found.foot_forward_std_m:.2f}, and {abs(found.foot_port_m):.2f} m to "
            f"{'starboard' if found.foot_port_m < 0.0 else 'port'}, to {found.foot_port_std_m:.2f}.",
            "  ",
        )
        for note in self.laser_notes():
            self.console.say(f"Note: {note}", "  ")

    def laser_notes(self) -> list[str]:
        """What is doubtful of it."""
        if (found := self.found.laser) is None:
            return []
        notes = []
        worst = max(found.foot_forward_std_m, found.foot_port_std_m)
        if worst > kept.PLACE_STD_M:
            notes.append("that is too uncertain to be written, but for the sign: more motion, or more of it.")
        elif worst > laser.TUNING.good_m:
            notes.append("a longer record, or more motion, makes it surer; 0.1 m is good.")
        if not self.found.laser_by_rates:
            notes.append(
                "the sensor has no body rates: if its angles lean into sway and surge, as those of cheap sensors do, "
                "the place is wrong by metres."
            )
        if not found.is_lean_found:
            notes.append(
                "motion tells where the beam ends, hardly where it begins: forward_m and port_m go with the beam that "
                "the configuration has. If it leans, measure that, write beam, and do this step again."
            )
        if not found.is_up_found:
            notes.append("how high it is over the IMU is not found: write up_m by tape.")
        return notes

    def _tell_mounting(self, rotation_deg: Vector) -> None:
        self.console.say(f"rotation_deg = [{', '.join(f'{angle:.2f}' for angle in rotation_deg)}]", "    ")
        turned = msgspec.structs.replace(
            self.device, rotation_deg=rotation_deg, bias_mps2=(0.0, 0.0, 0.0), attitude_latency_ms=0.0
        )
        for line in mounting_lines(turned):
            self.console.say(line.removeprefix("mounting: "), "    ")

    # ---- into the configuration --------------------------------------------------------------------------------------

    def changes(self) -> dict[str, dict[str, Any]]:
        """The keys that change, by table."""
        tables = {
            "device": kept.device_keys(self.found, self.device, rest.TUNING.great_mps2),
            "laser": kept.laser_keys(self.found, self.config.laser),
        }
        return {name: keys for name, keys in tables.items() if keys}

    def changed_text(self, changes: dict[str, dict[str, Any]]) -> str:
        """The configuration with them.

        Raises:
            CalibrationError: it cannot be changed, or would have faults.
        """
        text = self.text
        try:
            if keys := changes.get("device"):
                text = edit.with_keys(text, "device", keys, index=self.number)
            if keys := changes.get("laser"):
                text = edit.with_keys(text, "laser", keys)
            edit.validated(self.path, text)
        except edit.EditError as error:
            raise CalibrationError(f"{self.path}: {error}; the values are {changes}") from error
        except ConfigError as error:
            raise CalibrationError(f"{error}\nnothing was written; the values are {changes}") from error
        return text

    def write(self, text: str) -> None:
        """Put it in the place of the configuration.

        Raises:
            CalibrationError: it cannot be written.
        """
        try:
            edit.write(self.path, text, before=self.text)
        except edit.EditError as error:
            raise CalibrationError(f"{error}; run the command again") from error

    def show(self, text: str) -> None:
        """The difference."""
        lines = edit.difference(self.text, text, str(self.path))
        for line in edit.coloured(lines) if self.console.is_coloured else lines:
            self.console.line(line)

    def outcome(self, changes: dict[str, dict[str, Any]], *, written: bool) -> Outcome:
        """All of it, for a program."""
        notes = (*self.notes, *self.rest_notes(), *self.latency_notes(), *self.laser_notes())
        return Outcome(device=self.device.name, found=self.found, changes=changes, written=written, notes=notes)


# ---- from a recording ------------------------------------------------------------------------------------------------


def from_recording(
    calibration: Calibration, record: Record, list_deg: tuple[float, float], *, is_sure: bool
) -> Outcome:
    """The steps that a recording is enough for, in the axes of the sensor.

    ``is_sure``: write without a question.

    Raises:
        CalibrationError: nothing can be written.
        QuitError: the person does not want it.
    """
    console = calibration.console
    steps: list[tuple[Step, Callable[[], None], Callable[[], None]]] = [
        (Step.REST, lambda: calibration.take_rest(record, list_deg), calibration.tell_rest),
        (Step.LATENCY, lambda: calibration.take_latency(record), calibration.tell_latency),
    ]
    for wrong in signs.judge_motion(record):
        calibration.notes.append(f"{Step.SIGNS}: {wrong}")
        console.say(f"{Step.SIGNS}: {wrong}")
    if record.laser_m.size:
        steps.append((Step.LASER, lambda: calibration.take_laser(record), calibration.tell_laser))
    for step, take, tell in steps:
        console.say(f"{step}:")
        try:
            take()
        except FAILURES as error:
            calibration.notes.append(f"{step}: {error}")
            console.say(f"nothing: {error}", "  ")
        else:
            tell()
    return finish(calibration, is_sure=is_sure)


def finish(calibration: Calibration, *, is_sure: bool) -> Outcome:
    """Show what changes, and write it.

    Raises:
        CalibrationError: it cannot be written.
        QuitError: the person does not want it.
    """
    console, changes = calibration.console, calibration.changes()
    if not changes:
        console.say("Nothing in the configuration changes.")
        return calibration.outcome(changes, written=False)
    text = calibration.changed_text(changes)
    console.say()
    calibration.show(text)
    console.say()
    is_wanted = is_sure or console.choose({"y": "write it", "n": "leave the file as it is"}) == "y"
    if is_wanted:
        calibration.write(text)
        console.say(
            f"{calibration.path}: written. A daemon that runs on it reads it again with SIGHUP, or as it starts."
        )
    else:
        console.say("The file is as it was.")
    return calibration.outcome(changes, written=is_wanted)


# ---- on board --------------------------------------------------------------------------------------------------------


class Guide:
    """Leads a person through the steps."""

    def __init__(
        self,
        calibration: Calibration,
        read: Callable[..., Record] = read_devices,
    ) -> None:
        self._one, self._console, self._read = calibration, calibration.console, read
        self._state = kept.state_path(calibration.path)
        wanted = [calibration.device]
        wanted += [device for device in calibration.config.device if device.role == "laser"]
        self._devices = wanted
        self._sea: Record | None = None
        """What was read for the latency serves the laser as well."""

    def run(self) -> Outcome:
        """All steps that are not done yet, and the end.

        Raises:
            QuitError: the person does not want to go on; what was found is kept.
            CalibrationError: what was found cannot be kept, or not be written.
        """
        if not os.access(self._state.parent, os.W_OK):
            raise CalibrationError(f"{self._state.parent}: you may not write there, and the result has to be: use sudo")
        self._resume()
        does = {
            Step.REST: self._rest, Step.SIGNS: self._signs, Step.TILT: self._tilt, Step.LATENCY: self._latency,
            Step.LASER: self._laser,
        }  # fmt: skip
        for number, step in enumerate(Step, start=1):
            self._console.say()
            self._console.say(f"Step {number} of {len(Step)}: {step}")
            if self._is_done(step):
                self._console.say("done already; Enter goes on to the next one.", "  ")
                if self._console.choose({"": "go on", "r": "repeat", "q": "quit"}) == "":
                    continue
            does[step]()
            self._keep()
        outcome = finish(self._one, is_sure=False)
        if outcome.written or not outcome.changes:
            kept.forget(self._state)
        else:
            self._console.say("What was found is kept: run the command again to come back to this.")
        return outcome

    # ---- progress ----------------------------------------------------------------------------------------------------

    def _resume(self) -> None:
        try:
            found = kept.load(self._state, self._one.device)
        except kept.StateError as error:
            self._console.say(f"{error}: beginning anew.")
            return
        if found is not None:
            self._one.found = found
            done = [
                f"{step} (skipped)" if step in found.skipped else step.value for step in Step if self._is_done(step)
            ]
            steps = ", ".join(done) or "nothing yet"
            self._console.say(
                f"Going on with what {self._state} has kept {kept.age(self._state)}: {steps}. If the sensor was moved "
                "since, quit, and begin anew with --anew."
            )

    def _is_done(self, step: Step) -> bool:
        found = self._one.found
        return {
            Step.REST: found.rest is not None,
            Step.SIGNS: bool(found.signs),
            Step.TILT: found.tilt is not None,
            Step.LATENCY: found.latency is not None,
            Step.LASER: found.laser is not None,
        }[step] or step.value in found.skipped

    def _keep(self) -> None:
        try:
            kept.save(self._state, self._one.found)
        except kept.StateError as error:
            raise CalibrationError(
                f"{error}: write to its directory, or copy the configuration where you may"
            ) from error

    def _skip(self, step: Step) -> None:
        found = self._one.found
        self._one.found = msgspec.structs.replace(found, skipped=tuple(dict.fromkeys((*found.skipped, step.value))))

    # ---- the steps ---------------------------------------------------------------------------------------------------

    def _attempt(
        self, step: Step, make: Callable[[], Record | None], take: Callable[[Record], None], tell: Callable[[], None],
        *, grows: bool = False,
    ) -> Record | None:  # fmt: skip
        """Make a record and take it until it is kept, or skipped: None then.

        ``make`` gives None where the person skips.
        """
        before, record, is_more = self._one.found, None, False
        while True:
            try:
                made = make()
                if made is None:
                    key = "s"
                else:
                    record = joined(record, made) if is_more and record is not None else made
                    take(record)
                    tell()
                    key = self._console.choose(WITH_MORE if grows else KEEP)
                    if key == "":
                        return record
            except FAILURES as error:
                self._console.say(f"Nothing came of it: {error}.", "  ")
                key = self._console.choose(AGAIN | {"m": "more of it"} if grows and record is not None else AGAIN)
            self._one.found = before
            if key == "s":
                self._skip(step)
                return None
            is_more = key == "m"

    def _record(self, seconds: float) -> Record:
        return self._read(
            self._devices,
            seconds,
            lambda done_s: self._console.progress(done_s, seconds),
            lambda why: self._console.say(f"It waits: {why}.", "  "),
        )

    def _resting(self) -> Record:
        """A record of the length that the motion wants."""
        record = self._record(rest.TUNING.still_s)
        if rest.is_still(record):
            return record
        more_s = rest.TUNING.moving_s - rest.TUNING.still_s
        self._console.say(f"It moves: {rest.TUNING.moving_s:.0f} s are averaged.", "  ")
        return joined(record, self._record(more_s))

    def _rest(self) -> None:
        self._console.say(
            "The vessel lies still, in harbour or moored, at an even keel, and nobody loads or ballasts. 20 s do if "
            "nothing moves, five minutes in gentle waves. If her draught marks show a list or trim, type it as "
            "ROLL,PITCH in degrees, port side up and bow up.",
            "  ",
        )
        list_deg = [(0.0, 0.0)]

        def make() -> Record | None:
            asked = self._list()
            if asked is None:
                return None
            list_deg[0] = asked
            return self._resting()

        self._attempt(Step.REST, make, lambda record: self._one.take_rest(record, list_deg[0]), self._one.tell_rest)

    def _list(self) -> tuple[float, float] | None:
        while True:
            answer = self._console.answer("[Enter begin, ROLL,PITCH list and trim, s skip, q quit] ").lower()
            if answer == "q":
                raise QuitError
            if answer == "s":
                return None
            try:
                return parse_list(answer) if answer else (0.0, 0.0)
            except ValueError as error:
                self._console.say(f"{error}.", "  ")

    def _signs(self) -> None:
        self._console.say(
            "With the sensor in your hand, before it is bolted down: lay it flat, its x axis away from you. After "
            "Enter, leave it flat for 2 s, then lift one side by 20 to 60 degrees within some seconds, and hold it "
            f"until {LIFT_S:.0f} s are over. If it is bolted down, skip this: the step latency checks what motion can "
            "show.",
            "  ",
        )
        verdicts: list[signs.Verdict] = []
        for lift, which in (
            (signs.Lift.PORT_UP, "its left side (y axis)"),
            (signs.Lift.BOW_UP, "its far side (x axis)"),
        ):
            self._console.say(f"Lift {which}.", "  ")
            seen: list[signs.Verdict] = []

            def make() -> Record | None:
                return None if self._console.choose(BEGIN) == "s" else self._record(LIFT_S)

            def take(record: Record, lift: signs.Lift = lift, seen: list[signs.Verdict] = seen) -> None:
                seen[:] = signs.judge_lift(record, lift)

            def tell(seen: list[signs.Verdict] = seen) -> None:
                for verdict in seen:
                    self._console.say(f"{verdict.quantity}: {verdict.sign}", "    ")

            if self._attempt(Step.SIGNS, make, take, tell) is None:
                return
            verdicts += seen
        self._one.found = msgspec.structs.replace(self._one.found, signs=tuple(verdicts))
        if bad := [verdict.quantity for verdict in verdicts if verdict.is_bad]:
            self._console.say(
                f"Correct {', '.join(dict.fromkeys(bad))} in the profile {self._one.device.profile.name} (sign = -1 "
                "turns one round) before anything else: the steps that follow cannot be right. Then run it again.",
                "  ",
            )
            raise QuitError

    def _tilt(self) -> None:
        if self._one.found.rest is None:
            self._console.say("It is held against the rest, which was skipped: skipped, too.", "  ")
            self._skip(Step.TILT)
            return
        self._console.say(
            f"Shows {turn.TURN}. Tilt the vessel, or the plate that the sensor is bolted to, by 5 degrees or more "
            "about one known axis of the vessel, with ballast, a crane or wedges, and let it come to rest. The angle "
            "need not be known, the axis must. Then say what was lifted.",
            "  ",
        )
        tilted = [Tilted.BOW_UP]

        def make() -> Record | None:
            key = self._console.choose(TILTS)
            if key == "s":
                return None
            tilted[0] = TILTED[key]
            return self._resting()

        self._attempt(Step.TILT, make, lambda record: self._one.take_tilt(record, tilted[0]), self._one.tell_tilt)

    def _latency(self) -> None:
        self._console.say(
            f"How old the angles are, and whether they go with the body rates: {SEA_S:.0f} s of motion, at sea or in a "
            "swell. The laser is read at the same time.",
            "  ",
        )
        record = self._attempt(Step.LATENCY, self._sailing, self._one.take_latency, self._one.tell_latency, grows=True)
        # One that shows nothing of the angles, as of a sensor without gyroscopes, may still show the laser.
        self._sea = record or self._sea

    def _laser(self) -> None:
        if len(self._devices) == 1:
            self._console.say("There is no laser in the configuration.", "  ")
            self._skip(Step.LASER)
            return
        self._console.say(
            f"Which way the laser counts and where it is, from {SEA_S:.0f} s in which the vessel heaves, rolls and "
            "pitches and the laser sees its target.",
            "  ",
        )
        ready = [self._sea]

        def make() -> Record | None:
            if (made := ready.pop() if ready else None) is not None:
                self._console.say("The record of the latency serves for it.", "  ")
                return made
            return self._sailing()

        self._attempt(Step.LASER, make, self._one.take_laser, self._one.tell_laser, grows=True)

    def _sailing(self) -> Record | None:
        if self._console.choose(BEGIN) == "s":
            return None
        self._sea = self._record(SEA_S)
        return self._sea


def parse_list(text: str) -> tuple[float, float]:
    """Read ``ROLL,PITCH`` in degrees.

    Raises:
        ValueError: it is not that, or more than a vessel lies at.
    """
    number = r"[-+]?\d+(?:\.\d+)?"
    found = re.fullmatch(rf"({number}),\s*({number})", text)
    if found is None:
        raise ValueError(
            f"{text!r} is not understood: write ROLL,PITCH in degrees, port side up and bow up, as 0.5,-0.2"
        )
    roll, pitch = float(found[1]), float(found[2])
    if max(abs(roll), abs(pitch)) > MOST_LIST_DEG:
        raise ValueError(f"{text}: no vessel is calibrated at more than {MOST_LIST_DEG:.0f} degrees")
    return roll, pitch
