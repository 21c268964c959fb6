# SPDX-License-Identifier: Apache-2.0
"""The verdict on stability, on responses whose end is known: growing, lasting, dying, silent."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.oscillation import holds, late_oscillation
from waferbot_twin.response import AxisResponse

STEP = 2.5e-4
RETURN_S = 0.6


def response(vibration, end_s: float = 1.2) -> AxisResponse:
    """A step up at 0.02 s and down `RETURN_S` later, with `vibration(time since the last step)`."""
    encoder_time = np.arange(0.0, end_s, 1.0 / 9000.0)
    servo_time = np.arange(0.0, end_s, 1.0 / 2250.0)

    def up(time):
        return (time >= 0.02 - 1e-9) & (time < 0.02 + RETURN_S - 1e-9)

    last_step = np.where(encoder_time < 0.02 + RETURN_S, 0.02, 0.02 + RETURN_S)
    since = np.maximum(encoder_time - last_step, 0.0)
    position = STEP * (up(encoder_time) + vibration(since))
    nothing = np.zeros_like(servo_time)
    return AxisResponse(
        'y_linear', 'm', encoder_time, position, servo_time, STEP * up(servo_time), nothing,
        servo_time, nothing, encoder_time, np.zeros_like(encoder_time),
    )  # fmt: skip


def vibration(amplitude: float, growth_rate: float, frequency_hz: float):
    return lambda time: (
        amplitude * np.exp(growth_rate * time) * np.sin(2.0 * np.pi * frequency_hz * time)
    )


@pytest.mark.parametrize('frequency_hz', [9.0, 75.0, 420.0, 1125.0])
@pytest.mark.parametrize(
    ('amplitude', 'growth_rate', 'unstable'),
    [
        (0.01, 5.0, True),  # grows to 0.2
        (0.1, 0.0, True),  # a limit cycle
        (0.5, -2.0, False),  # still 0.15 in the end, but dying
        (0.01, 0.0, False),  # too small to be told from ripple
        (0.0, 0.0, False),
    ],
)
def test_verdict(
    amplitude: float, growth_rate: float, unstable: bool, frequency_hz: float
) -> None:
    found = late_oscillation(response(vibration(amplitude, growth_rate, frequency_hz)))
    assert found.unstable is unstable
    if amplitude > 0.05:
        assert found.frequency_hz == pytest.approx(frequency_hz, abs=4.0)
        # Half of peak to peak lies between the envelope's values at both ends of the window.
        envelope = amplitude * np.exp(growth_rate * np.array([0.45, 0.60]))
        assert 0.99 * envelope.min() < found.amplitude < 1.01 * envelope.max()


def test_instability_after_the_return_counts() -> None:
    """The thesis sees X-Rotate lose its stability only after the step down."""
    first = response(lambda time: np.zeros_like(time))
    after = response(vibration(0.1, 1.0, 50.0))
    late = first.encoder_time > 0.02 + RETURN_S
    first.position[late] = after.position[late]
    assert late_oscillation(first).unstable


def test_holds_begin_with_their_step() -> None:
    up, down = holds(response(lambda time: 0.0 * time))
    assert up[0][0] == pytest.approx(0.0, abs=1.2e-4)
    assert up[0][-1] == pytest.approx(RETURN_S, abs=5e-4)
    assert down[0][0] == pytest.approx(0.0, abs=1.2e-4)
    assert np.median(up[1]) == pytest.approx(1.0)
    assert np.median(down[1]) == pytest.approx(0.0)


def test_a_record_without_a_long_hold_has_no_verdict() -> None:
    with pytest.raises(ValueError, match='no hold'):
        late_oscillation(response(lambda time: 0.0 * time, end_s=0.3))
