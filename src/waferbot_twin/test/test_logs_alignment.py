# SPDX-License-Identifier: Apache-2.0
"""Skew and clocks of logs whose motion is a formula, so that the drive follows without an integrator."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.logs.alignment import clock_ratio, common_skew, skew
from waferbot_twin.logs.measured import Signal

J, B, C, G = 0.02, 0.05, 0.15, 0.4  # kg m2, Nm s/rad, Nm, Nm: inertia, damping, friction, gravity

SEED = 11


class Motion:
    """A sum of sines of 0.5 to 6 Hz, and the torque that a pendulum with friction needs for it."""

    def __init__(self, random) -> None:
        self.wave = 2.0 * np.pi * random.uniform(0.5, 6.0, 8)
        self.phase = random.uniform(0.0, 2.0 * np.pi, 8)
        self.size = random.uniform(0.5, 1.0, 8) / self.wave

    def derivative(self, order, time_s):
        angle = np.outer(time_s, self.wave) + self.phase + order * np.pi / 2.0
        return np.sin(angle) @ (self.size * self.wave**order)

    def torque(self, time_s):
        speed = self.derivative(1, time_s)
        inertia = J * self.derivative(2, time_s) + B * speed + C * np.sign(speed)
        return inertia + G * np.sin(self.derivative(0, time_s))


def signals(motion, random, step_s, late_s, jitter=0.0):
    """Position with steps of 0.1 mrad and torque that stands late, at uneven times of their own."""
    count = int(8.0 / step_s)
    time_s, drive_s = (
        np.arange(count) * step_s + step_s * jitter * random.uniform(0.0, 1.0, count)
        for _ in range(2)
    )
    position = 1e-4 * np.round(motion.derivative(0, time_s) / 1e-4)
    return (
        Signal('position', 'x_rotate', 'rad', time_s, position),
        Signal('force', 'x_rotate', 'Nm', drive_s, motion.torque(drive_s - late_s)),
    )


@pytest.mark.parametrize('jitter', [0.0, 0.5])
@pytest.mark.parametrize('late_steps', [-3.3, -0.5, 0.5, 2.0])
def test_skew_is_found_to_a_fraction_of_a_sample(random, late_steps, jitter) -> None:
    step_s = 2e-3
    found = skew(*signals(Motion(random), random, step_s, late_steps * step_s, jitter))
    assert found is not None
    assert found.significant
    assert found.late_s == pytest.approx(late_steps * step_s, abs=0.15 * step_s)
    assert found.standard_error_s < 0.1 * step_s


def test_several_logs_tell_one_skew_and_better(random) -> None:
    """The logger is late by the same in each; the mean is nearer to it than they usually are."""
    step_s, late_s = 2e-3, 1.4e-3
    pairs = [signals(Motion(random), random, step_s, late_s, 0.5) for _ in range(6)]
    single = [skew(*pair) for pair in pairs]
    found = common_skew(pairs)
    assert found is not None
    assert found.significant
    assert found.late_s == pytest.approx(late_s, abs=0.15 * step_s)
    assert found.standard_error_s < min(one.standard_error_s for one in single)
    assert str(found).startswith(f'{1e3 * found.late_s:.2f} ± ')


def test_a_log_that_shows_no_skew_does_not_count(random) -> None:
    time_s = np.arange(0.0, 4.0, 2e-3)
    still = (
        Signal('position', 'x_rotate', 'rad', time_s, np.zeros(len(time_s))),
        Signal('force', 'x_rotate', 'Nm', time_s, random.standard_normal(len(time_s))),
    )
    moving = signals(Motion(random), random, 2e-3, 2e-3)
    assert common_skew([still]) is None
    both, alone = common_skew([still, moving]), common_skew([moving])
    assert both == alone == skew(*moving)


def test_logs_that_contradict_each_other_widen_the_error(random) -> None:
    pairs = [signals(Motion(random), random, 2e-3, late_s) for late_s in (-4e-3, 4e-3, 0.0)]
    found = common_skew(pairs)
    assert found is not None
    assert not found.significant
    assert found.standard_error_s > 1e-3


def test_no_skew_is_not_significant(random) -> None:
    found = [skew(*signals(Motion(random), random, 2e-3, 0.0)) for _ in range(20)]
    assert not any(one is None or one.significant for one in found)


def test_drag_that_changes_along_the_way_is_no_time(random) -> None:
    """A slow swing under gravity, as a joint of a robot makes it: a time would do nearly the same."""
    shown = []
    for _ in range(10):
        motion = Motion(random)
        motion.wave = 2.0 * np.pi * np.array([0.1, 0.1, 0.3, 0.3, 1.0, 1.0, 2.0, 2.0])
        motion.size = np.array([1.2, 0.3, 0.05, 0.05, 0.05, 0.05, 0.01, 0.01])
        time_s = np.arange(0.0, 30.0, 0.01)
        way, speed = motion.derivative(0, time_s), motion.derivative(1, time_s)
        uneven = 2.0 * B * (0.8 * way + 0.5 * way**2) * speed - B * speed * np.abs(speed)
        position = 1e-4 * np.round(way / 1e-4)
        found = skew(
            Signal('position', 'x_rotate', 'rad', time_s, position),
            Signal('force', 'x_rotate', 'Nm', time_s, motion.torque(time_s) + uneven),
        )
        shown += [found] if found is not None else []
    assert len(shown) >= 8
    assert not any(one.significant for one in shown)


def test_a_rest_tells_no_time(random) -> None:
    """There dry friction is whatever holds the axis: here it stays what moved it."""
    time_s, late_s = np.arange(0.0, 12.0, 1e-3), []
    for _ in range(10):
        way, torque = np.zeros_like(time_s), np.zeros_like(time_s)
        for begin in np.arange(0.5, 11.0, 1.0):
            size, length = random.uniform(0.1, 0.5), random.uniform(0.1, 0.2)
            size *= random.choice([-1.0, 1.0])
            x = np.clip((time_s - begin) / length, 0.0, 1.0)
            way += size * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
            speed = size / length * 30.0 * x**2 * (1.0 - x) ** 2
            bend = size / length**2 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
            torque += J * bend + B * speed + C * np.sign(speed)
            rests = (time_s >= begin + length) & (time_s < begin + 1.0)
            torque += np.where(rests, C * np.sign(size), 0.0)
        found = skew(
            Signal('position', 'x_rotate', 'm', time_s, 1e-4 * np.round(way / 1e-4)),
            Signal('force', 'x_rotate', 'N', time_s, torque),
        )
        late_s += [found.late_s] if found is not None else []
    assert len(late_s) >= 8
    assert np.median(np.abs(late_s)) < 0.06e-3


@pytest.mark.parametrize('late_steps', [0.0, 1.5])
def test_a_motor_that_cogs_seems_not_late(random, late_steps) -> None:
    """Strong cogging on a slide, six periods of it: as large a force as all acceleration."""
    step_s, cycle = 2e-3, 0.2
    for _ in range(10):
        motion = Motion(random)
        time_s = np.arange(0.0, 3.0, step_s)
        position = motion.derivative(0, time_s)

        def force(at_s, motion=motion):
            inertia = J * motion.derivative(2, at_s) + C * np.sign(motion.derivative(1, at_s))
            angle = 2.0 * np.pi / cycle * motion.derivative(0, at_s)
            return inertia + 0.5 * np.sin(angle) + 0.3 * np.cos(3.0 * angle)

        found = skew(
            Signal('position', 'y_linear', 'm', time_s, 1e-5 * np.round(position / 1e-5)),
            Signal('current', 'y_linear', 'A', time_s, force(time_s - late_steps * step_s)),
            cycle,
        )
        assert found is not None
        assert found.late_s == pytest.approx(late_steps * step_s, abs=0.3 * step_s)
        assert found.significant == (late_steps > 0.0)


def test_commands_that_are_held_need_no_correction(random) -> None:
    """A torque that is held for 4 ms, and logged when it was set, is not late."""
    time_s = np.arange(0.0, 8.0, 4e-4)
    command_s = np.arange(0.0, 8.0, 4e-3)
    steps = np.cumsum(random.standard_normal(len(command_s)) * 0.05)
    steps -= 0.05 * np.cumsum(steps) * 4e-3
    torque = steps[np.minimum((time_s / 4e-3 + 1e-6).astype(int), len(steps) - 1)]
    # Exact motion of a free inertia under steps, in closed form from step to step.
    h = 4e-4
    speed = np.concatenate([[0.0], np.cumsum(torque[:-1] * h / J)])
    position = np.concatenate([[0.0], np.cumsum(speed[:-1] * h + 0.5 * torque[:-1] * h * h / J)])
    found = skew(
        Signal('position', 'y_linear', 'm', time_s, position),
        Signal('current_command', 'y_linear', 'A', command_s, steps),
    )
    assert found is not None
    assert abs(found.late_s) < 0.02 * 4e-3


def test_an_axis_that_rests_shows_no_skew(random) -> None:
    time_s = np.arange(0.0, 5.0, 2e-3)
    noise = 1e-4 * random.integers(-1, 2, len(time_s))
    force = random.standard_normal(len(time_s))
    found = skew(
        Signal('position', 'x_rotate', 'rad', time_s, noise.astype(float)),
        Signal('force', 'x_rotate', 'Nm', time_s, force),
    )
    assert found is None or not found.significant


@pytest.mark.parametrize('ratio', [0.9, 1.0, 1.11])
def test_clock_of_the_commands(random, ratio) -> None:
    motion = Motion(random)
    time_s = np.arange(0.0, 4.0, 3e-3)
    command_s = np.arange(0.0, 6.0, 3e-3)
    lag = 0.01 * random.standard_normal(len(time_s))
    position = motion.derivative(0, time_s * ratio - 0.03) + lag
    found = clock_ratio(
        Signal('position', 'x_rotate', 'rad', time_s, position),
        Signal(
            'commanded_position', 'x_rotate', 'rad', command_s, motion.derivative(0, command_s)
        ),
    )
    if ratio == 1.0:
        assert found is None
    else:
        assert found == pytest.approx(ratio, abs=2e-3)
