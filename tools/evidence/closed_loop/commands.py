"""tools/accuracy.py closed-loop: a hook under a winch that the stream drives."""

from __future__ import annotations

import sys

from evidence.closed_loop import loop
from evidence.commands import Command, Options, Parser, add_common, add_duration, count, positive
from evidence.heave.commands import add_observer
from evidence.results import Output, Report
from heaved.simulate.sensors import SENSORS, laser_pattern
from heaved.simulate.shaking import NONE, shake_of


def run_closed_loop(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: a sea, a laser pattern or a disturbance is not known.
    """
    laser_pattern(options.laser)
    shake_of(options.shake)
    setting = loop.Setting(
        observer=options.observer,
        sensor=options.sensor,
        laser=options.laser,
        shake=options.shake,
        seed=options.seed,
        warm_up_s=options.warm_up,
        duration_s=options.duration,
        shifted=options.shifted,
    )

    def draw(trial: loop.Trial) -> None:
        print(f"{trial.sea}: done", file=sys.stderr, flush=True)
        output.write("closed_loop", trial.rows())
        if output.figures:
            from evidence.closed_loop.figure import hook_motion

            shaken = f"_{setting.shake}" if setting.shake else ""
            hook_motion(output.folder / f"hook_{trial.sea}_{setting.sensor}{shaken}.png", trial)

    trials = loop.run(options.seas or loop.DEFAULT_SEAS, setting, options.replay, draw)
    return Report(loop.report(trials), (options.seed,))


def _closed_loop(parser: Parser) -> None:
    parser.add_argument("seas", nargs="*", metavar="SEA", help=f"default {' '.join(loop.DEFAULT_SEAS)}")
    parser.add_argument("--replay", action="store_true", help="without sockets, faster than real time")
    parser.add_argument("--sensor", default="A", choices=sorted(SENSORS), help="its errors (default A)")
    parser.add_argument("--laser", default="off", metavar="PATTERN", help="on, off (default), 50%%")
    parser.add_argument("--shake", default=NONE, metavar="NAME", help="what shakes the sensors besides")
    parser.add_argument("--seed", type=count, default=1, help="of sea and sensors")
    parser.add_argument(
        "--warm-up", type=positive, default=loop.SCORED_FROM_S, metavar="S", help="not scored (default 300)"
    )
    parser.add_argument("--shifted", action="store_true", help="a daemon with [compensation] lead_s as well; live only")
    add_duration(parser, 180.0)
    for add in (add_observer, add_common):
        add(parser)


COMMANDS = {
    "closed-loop": Command(run_closed_loop, _closed_loop, "hook motion under a winch driven by the stream"),
}
