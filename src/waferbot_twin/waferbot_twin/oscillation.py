# SPDX-License-Identifier: Apache-2.0
"""
Oscillation of a response: late, which is the verdict on stability, and early, in a band.

The verdict is whether a loop still oscillates when its step should long have settled. It is taken
from the response alone, within the holds after the steps up and down. A decaying vibration is none
of an unstable loop however long it lasts, so the amplitude is looked at twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from waferbot_twin.response import AxisResponse

OSCILLATING = 0.02
"""Amplitude late in a hold, in steps, above which a loop may be unstable."""

SUSTAINED = 0.98
"""Least ratio of that amplitude to the one `BETWEEN_S` before for which it is."""

WINDOW_S = 0.12
"""Length of the windows: more than a period of the slowest loop, 9 Hz."""

BETWEEN_S = 0.2
"""From the earlier window to the late one."""

VIBRATION_BAND_HZ = (65.0, 90.0)
"""Around the 75 Hz that the thesis sees in the measured Y-Linear response (Figs. 4.4 to 4.6)."""

HIGHER_BAND_HZ = (300.0, 600.0)
"""Where the loop is nearest to instability, and its vibration not in the thesis."""


@dataclass(frozen=True)
class Oscillation:
    """
    What an axis does at the end of a hold.

    `amplitude`: half of the peak-to-peak motion in the last `WINDOW_S`, in steps; `before`: the
    same, `BETWEEN_S` earlier; `frequency_hz`: where the spectrum of the motion is highest;
    `farthest`: the largest distance from the origin of the record, in steps.
    """

    amplitude: float
    before: float
    frequency_hz: float
    farthest: float

    @property
    def unstable(self) -> bool:
        """Whether the axis oscillates and that does not die away."""
        return self.amplitude > OSCILLATING and self.amplitude >= SUSTAINED * self.before


BLOWN_UP = Oscillation(float('inf'), float('inf'), float('nan'), float('inf'))
"""What a response ends in whose plant blew up."""


def late_oscillation(response: AxisResponse) -> Oscillation:
    """
    Return what the axis does late in the hold after the step up or down, where it moves more.

    The thesis sees X-Rotate lose its stability only after the step down. A hold that is shorter
    than `BETWEEN_S` and two windows is passed over; raises `ValueError` if there is none left.
    """
    long_enough = [
        hold for hold in holds(response) if np.ptp(hold[0]) >= BETWEEN_S + 2.0 * WINDOW_S
    ]
    if not long_enough:
        raise ValueError('the response has no hold that is long enough')
    found = [_at_the_end(time, position) for time, position in long_enough]
    return max(found, key=lambda oscillation: oscillation.amplitude)


def holds(response: AxisResponse) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return, per hold, times from its step (s) and positions (in heights of the first step)."""
    step = response.step()
    if step is None:
        return []
    time, position = response.since_start()
    jumps = np.flatnonzero(np.diff(response.commanded)) + 1
    starts = response.servo_time[jumps] - step[0]
    ends = [*starts[1:], np.inf]
    return [
        (time[part] - start, position[part] / step[1])
        for start, end in zip(starts, ends, strict=True)
        for part in [(time >= start) & (time < end)]
    ]


def vibration_amplitude(response: AxisResponse, band_hz: tuple[float, float]) -> float:
    """
    Return the amplitude of the position within a band of frequencies after the step, m or rad.

    That of the highest line in the spectrum of the first 0.25 s; a vibration that dies within them
    was larger by the ratio of these times.
    """
    time_s, position = holds(response)[0]
    step = response.step()
    assert step is not None  # there is a hold
    early = position[time_s < 0.25] * abs(step[1])
    interval = time_s[1] - time_s[0]
    window = np.hanning(len(early))
    spectrum = np.abs(np.fft.rfft((early - early[-1]) * window, 4 * len(early)))
    frequencies = np.fft.rfftfreq(4 * len(early), interval)
    low, high = band_hz
    band = (frequencies >= low) & (frequencies <= high)
    return float(2.0 * spectrum[band].max() / window.sum())


def _at_the_end(time: np.ndarray, position: np.ndarray) -> Oscillation:
    last = _window(time, position, time[-1] - WINDOW_S)
    before = _window(time, position, time[-1] - WINDOW_S - BETWEEN_S)
    spectrum = np.abs(np.fft.rfft((last - last.mean()) * np.hanning(len(last)), 8 * len(last)))
    frequency = np.fft.rfftfreq(8 * len(last), time[1] - time[0])
    return Oscillation(
        float(np.ptp(last)) / 2.0,
        float(np.ptp(before)) / 2.0,
        float(frequency[np.argmax(spectrum)]),
        float(np.max(np.abs(position))),
    )


def _window(time: np.ndarray, position: np.ndarray, start: float) -> np.ndarray:
    return position[(time >= start) & (time < start + WINDOW_S)]
