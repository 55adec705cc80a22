"""Measuring how sensors are mounted, and writing it down."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heaved.cli.common import EX_CONFIG, EX_UNAVAILABLE, fail, load, say


def calibrate(
    config: Annotated[Path, typer.Option(help="Whose sensors to calibrate; it is changed at the end, if you agree.")],
    recording: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="In place of the sensors: recorded with this very configuration."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="With a recording: write without a question.")] = False,
    list_: Annotated[
        str, typer.Option("--list", metavar="ROLL,PITCH", help="With a recording: list and trim meanwhile, degrees.")
    ] = "0,0",
    anew: Annotated[bool, typer.Option("--anew", help="Forget what an interrupted calibration has found.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON; all else goes to standard error.")
    ] = False,
) -> None:
    """Measure how the sensors are mounted, step by step, and write it into the configuration. Stop the daemon first."""
    import msgspec

    from heaved.devices.recording import RecordingError
    from heaved.setup import calibrate as calibrating
    from heaved.setup import calibrate_state, edit
    from heaved.setup.calibrate_live import busy
    from heaved.setup.calibrate_record import read_record
    from heaved.setup.console import QuitError, terminal

    if yes and recording is None:
        fail("--yes: without a recording somebody has to be there; give one with --recording FILE.csv", 1)
    try:
        lies_deg = calibrating.parse_list(list_)
    except ValueError as error:
        fail(f"--list: {error}", 1)
    loaded, state = load(config), calibrate_state.state_path(config)
    if anew:
        calibrate_state.forget(state)
    try:
        calibration = calibrating.Calibration(config, loaded, terminal(to_stderr=json), text=edit.read_text(config))
        if recording is not None:
            device = calibration.device
            outcome = calibrating.from_recording(
                calibration,
                read_record(recording, device.rotation_deg, device.bias_mps2),
                lies_deg,
                is_sure=yes,
            )
        else:
            if reason := busy(loaded):
                fail(reason, EX_UNAVAILABLE)
            outcome = calibrating.Guide(calibration).run()
    except (calibrating.CalibrationError, edit.EditError) as error:
        fail(str(error), EX_CONFIG)
    except RecordingError as error:
        fail(str(error), 1)
    except (QuitError, KeyboardInterrupt) as error:
        kept = "nothing was kept yet"
        if state.exists():
            kept = f"what was found so far is kept in {state}: run the command again to go on"
        say(f"\nstopped; {kept}; the configuration is as it was", err=True)
        raise typer.Exit(0 if isinstance(error, QuitError) else 130) from error
    if json:
        say(msgspec.json.encode(outcome).decode())
