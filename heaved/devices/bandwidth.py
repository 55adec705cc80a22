"""What folds into the waves when a sensor is polled too slowly for its bandwidth, and what to do about it. Pure.

Polled ``rate_hz`` times a second, a motion of frequency f cannot be told from one of ``|f - k rate_hz|``, for any whole
k: vibration near a multiple of the rate reads as waves, and nothing that comes after the sensor can take it out. What
keeps it away is the low-pass within the sensor, if its corner, the bandwidth, is well below the rate.
"""

from __future__ import annotations

from math import floor, inf
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from heaved.devices.profile import BandwidthRegister, DeviceSpec

WAVES_HZ: Final = 0.6
"""Highest frequency of waves that vessels follow."""
PASSES: Final = 2.0
"""Times its bandwidth up to which a low-pass lets through what matters: a second-order one a quarter of it there."""
LAG: Final = 0.2
"""Times the reciprocal of its bandwidth by which a low-pass lags: 1/(2 pi) = 0.16 one of the first order,
sqrt(2)/(2 pi) = 0.23 one of the second (group delay of a Butterworth filter at frequency 0)."""
MOST_BANDS: Final = 3
"""Named of those that fold."""


def bandwidth_hz(device: DeviceSpec) -> float:
    """Of the sensor, as the device has it, else as its profile; 0: nobody has said."""
    return device.bandwidth_hz or device.profile.bandwidth_hz


def lag_ms(bandwidth_hz: float) -> float:
    """By which the sensor's low-pass lags, about."""
    return 1e3 * LAG / bandwidth_hz


def folding_bands_hz(rate_hz: float, bandwidth_hz: float) -> list[tuple[float, float]]:
    """Vibration (lowest and highest frequency) that passes the sensor's low-pass and reads as waves; none at twice the
    bandwidth or faster.
    """
    if rate_hz >= PASSES * bandwidth_hz:
        return []
    multiples = range(1, floor(PASSES * bandwidth_hz / rate_hz) + 1)
    return [(k * rate_hz - WAVES_HZ, k * rate_hz + WAVES_HZ) for k in multiples]


def folding(rate_hz: float, bandwidth_hz: float) -> str:
    """The same in words; empty: none."""
    bands = folding_bands_hz(rate_hz, bandwidth_hz)
    if not bands:
        return ""
    named = ", ".join(f"{low:.4g}-{high:.4g}" for low, high in bands[:MOST_BANDS])
    more = f" and so on to {bands[-1][1]:.4g}" if len(bands) > MOST_BANDS else ""
    return (
        f"at {rate_hz:g} Hz, less than twice its bandwidth of {bandwidth_hz:g} Hz, vibration of {named}{more} Hz "
        "folds into the waves, and nothing can tell it from them"
    )


def remedy(rate_hz: float, bandwidth_hz: float, register: BandwidthRegister | None, most_hz: float = inf) -> str:
    """What to set where :func:`folding` has something to say, and what that costs. ``register``: that sets the
    bandwidth; None: it is not known. ``most_hz``: polls a second that the line can carry.
    """
    wanted_hz = PASSES * bandwidth_hz
    faster = f"poll at {wanted_hz:g} Hz or more"
    if most_hz < wanted_hz:
        faster += f" (the line carries {most_hz:g}: raise its baud rate first)"
    choices = () if register is None else register.choices_hz
    fitting = [(choice, value) for value, choice in enumerate(choices) if PASSES * choice <= rate_hz]
    if register is None:
        low = f"{rate_hz / PASSES:g} Hz or less"
        return f"{faster}, or set the low-pass of the sensor to {low} and say so as bandwidth_hz"
    if not fitting:
        return f"{faster}; no bandwidth that register 0x{register.address:02X} can set is low enough"
    low_hz, value = max(fitting)
    return (
        f"{faster}, or set register 0x{register.address:02X} of the sensor to {value} ({low_hz:g} Hz) and bandwidth_hz "
        f"to {low_hz:g}; it then lags by about {lag_ms(low_hz):.0f} ms instead of {lag_ms(bandwidth_hz):.0f}: take the "
        "difference from latency_ms"
    )
