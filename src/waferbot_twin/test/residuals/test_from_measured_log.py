# SPDX-License-Identifier: Apache-2.0
"""
Records of measured logs, and the plant block on them: motions that are formulas, forces that follow.

A sum of sines needs the torque J q'' + b q' + ... exactly, so that no integrator stands between the log
and the truth.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.cogging_orders import (
    at_orders,
    log_prior_of_orders,
    orders_of,
    with_an_order_less,
)
from waferbot_twin.diagnosis.proposals.screening import screen, signatures
from waferbot_twin.effects import find, places
from waferbot_twin.effects.cogging import with_orders
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals import plant_block
from waferbot_twin.residuals.from_measured_log import (
    aligned_record,
    aligned_records,
    record_of_measured_log,
    sized_by,
)
from waferbot_twin.residuals.load import load_record
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import Cause, Problem

INERTIA = 2.5e-4  # kg m2, of the direct-drive motor
COUNTS = 8192.0 / (2.0 * math.pi)
AXIS = 'x_rotate'

SEED = 6


@pytest.fixture(scope='module')
def motor():
    return Variant.of(load_model_or_machine('direct_drive_motor'))


class Motion:
    """A sum of sines of 0.3 to 3 Hz with a swing of some turns."""

    def __init__(self, random) -> None:
        self.wave = 2.0 * np.pi * random.uniform(0.3, 3.0, 6)
        self.phase = random.uniform(0.0, 2.0 * np.pi, 6)
        self.size = random.uniform(4.0, 8.0, 6) / self.wave

    def derivative(self, order, time_s):
        angle = np.outer(time_s, self.wave) + self.phase + order * np.pi / 2.0
        return np.sin(angle) @ (self.size * self.wave**order)


def log_of(
    random, more=lambda angle, speed: 0.0, step_s=2e-3, jitter=0.3, kind='force', share=1.0
):
    """
    Return the log of a motor with the inertia of the model and `more` torque against it.

    With a `share` of the motion.
    """
    motion = Motion(random)
    time_s = step_s * (
        np.arange(int(4.0 / step_s)) + jitter * random.uniform(size=int(4.0 / step_s))
    )
    angle, speed, rate = (share * motion.derivative(order, time_s) for order in range(3))
    torque = INERTIA * rate + more(angle, speed)
    angle = np.round(angle * COUNTS) / COUNTS
    return MeasuredLog(
        'log',
        (
            Signal('position', AXIS, 'rad', time_s, angle, 1.0 / COUNTS),
            Signal(kind, AXIS, 'Nm' if kind == 'force' else 'A', time_s, torque),
        ),
    )


def residual(variant, log):
    block = PlantBlock(record_of_measured_log(log, variant), variant)
    (found,) = block.residuals(variant)
    return found


def test_readings_stand_at_their_own_times_and_nothing_is_made_up(random, motor) -> None:
    log = log_of(random)
    position = log[AXIS, 'position']
    record = record_of_measured_log(log, motor)
    rows, places_ = np.nonzero(np.isfinite(record.reading))
    assert set(places_) == {1}
    # All samples but those for which there is no drive, or no row, at the ends.
    assert len(position.time_s) - 4 <= len(rows) <= len(position.time_s)
    delay = motor.description.encoder_delay
    time_s = (
        (rows - delay) / record.timing.encoder_hz + record.late_s[rows, 1] + position.time_s[0]
    )
    first = np.searchsorted(position.time_s, time_s[0] - 1e-9)
    expected = slice(first, first + len(rows))
    assert time_s == pytest.approx(position.time_s[expected], abs=1e-9)
    assert record.reading[rows, 1] == pytest.approx(position.value[expected] * COUNTS, abs=1e-6)
    assert not record.whole_counts
    assert record.resolution[1] == pytest.approx(1.0)
    assert np.abs(record.late_s).max() <= 0.5 / record.timing.encoder_hz + 1e-12


def test_the_right_machine_leaves_rounding_and_a_wrong_one_more(random, motor) -> None:
    log = log_of(random)
    right = residual(motor, log)
    assert np.std(right) < 0.6  # counts: rounding is 0.29, and the observer adds its own past
    heavier = find('wrong_inertia').apply(motor, AXIS, {'inertia': 2.0 * INERTIA})
    assert np.std(residual(heavier, log)) > 1.4 * np.std(right)


def test_currents_forces_and_commands_drive_alike(random, motor) -> None:
    log = log_of(random, jitter=0.0)
    force = log[AXIS, 'force']
    constant = places.force_per_ampere(motor, AXIS)
    one = residual(motor, log)
    for kind in ('current', 'current_command'):
        signal = Signal(kind, AXIS, 'A', force.time_s, force.value / constant)
        other = residual(motor, MeasuredLog('log', (log[AXIS, 'position'], signal)))
        same = kind == 'current'
        assert (np.abs(one - other).max() < 1e-6) == same  # a command is held between its samples


def test_a_gap_is_left_out_of_the_residual(random, motor) -> None:
    log = log_of(random)
    whole = residual(motor, log)
    keep = [(signal.time_s < 1.5) | (signal.time_s > 1.8) for signal in log.signals]
    gappy = MeasuredLog(
        'log',
        tuple(
            replace(signal, time_s=signal.time_s[mask], value=signal.value[mask])
            for signal, mask in zip(log.signals, keep, strict=True)
        ),
    )
    found = residual(motor, gappy)
    assert len(found) < len(whole) - 150
    assert np.abs(found).max() < 3.0 * np.abs(whole).max()


def test_orders_of_cogging_come_out_of_the_residual(random, motor) -> None:
    orders = {7: 0.02, 12: 0.012, 36: 0.01}

    def cogging(angle, speed):
        held = [size * np.cos(order * angle + order) for order, size in orders.items()]
        return sum(held) + 0.01 * np.sign(speed)

    log = log_of(random, cogging, step_s=1e-3)
    block = PlantBlock(record_of_measured_log(log, motor), motor)
    assert orders_of(motor, [block]) == {AXIS: tuple(orders)}


@pytest.mark.parametrize('share', [1.0, 0.02])
def test_orders_of_a_motor_without_described_poles_are_any_that_its_log_shows(
    share, random, tmp_path
) -> None:
    """Of its gear, too: 120 waves a turn, over some turns and over a part of one."""
    file = tmp_path / 'motor.yaml'
    file.write_text(
        'name: motor\n'
        'bodies:\n'
        '  rotor: {mass_kg: 0.6, centre_of_gravity_m: [0, 0, 0],'
        f' inertia_kg_m2: {{xx: 2.0e-4, yy: 2.0e-4, zz: {INERTIA}}}}}\n'
        'joints:\n'
        '  bearing: {parent: base, child: rotor, at_m: [0, 0, 0],'
        ' freedoms: {rotor_angle: {type: revolute, axis: [0, 0, 1]}}}\n'
        f'axes: {{{AXIS}: rotor_angle}}\n'
        f'motors: {{{AXIS}: {{coordinate: rotor_angle, torque_per_ampere_nm_a: 0.055}}}}\n'
        f'encoders: {{{AXIS}: {{coordinate: rotor_angle, counts_per_revolution: 8192}}}}\n'
    )
    unknown = Variant.of(load_model_or_machine(file))
    assert not places.has_poles(unknown, AXIS)
    order = 120

    def ripple(angle, speed):
        return 0.02 * np.cos(order * angle + 1.0) + 0.01 * np.sign(speed)

    log = log_of(random, ripple, step_s=5e-4, share=share)
    block = PlantBlock(record_of_measured_log(log, unknown), unknown)
    (found, *_) = orders_of(unknown, [block])[AXIS]
    travel = np.ptp(log[AXIS, 'position'].value) / (2.0 * math.pi)
    assert found == pytest.approx(order, abs=0.6 / travel)


def test_what_comes_once_a_turn_is_no_cogging(random, motor) -> None:
    """An imbalance is something else, and is not taken along by the orders beside it."""
    log = log_of(
        random, lambda angle, speed: 0.05 * np.cos(angle) + 0.02 * np.cos(7 * angle), 1e-3
    )
    block = PlantBlock(record_of_measured_log(log, motor), motor)
    assert 1 not in orders_of(motor, [block]).get(AXIS, ())


def test_orders_are_sought_beside_what_is_known(random, motor) -> None:
    """Friction that falls with speed hides the weaker lines as long as nobody knows it."""
    orders = {7: 0.02, 12: 0.006, 36: 0.004}

    def forces(angle, speed):
        held = [size * np.cos(order * angle + order) for order, size in orders.items()]
        return sum(held) + 0.15 * np.sign(speed) * np.exp(-((speed / 3.0) ** 2))

    problem = Problem(motor, [record_of_measured_log(log_of(random, forces, 1e-3), motor)])
    friction = Cause(find('stribeck_friction'), AXIS, {'breakaway': 0.15, 'speed': 3.0})
    found = []
    for causes in ((), (friction,)):
        tuned = at_orders(problem, evaluate(problem, causes), {AXIS})
        found.append([{int(name.split('_')[1]) for name in one.values} for one in tuned])
    assert set(orders) not in found[0]
    # The strongest alone, then with the next, then all.
    assert [len(some) for some in found[1]] == [1, 2, 3]
    assert found[1][0] == {7}
    assert found[1][-1] == set(orders)
    assert at_orders(problem, evaluate(problem, ()), set()) == []


def test_no_orders_are_worth_choosing_without_cogging(random, motor) -> None:
    """Friction and rounding feign a weak line now and then: too weak for an order that was chosen."""
    for _ in range(8):
        log = log_of(random, lambda angle, speed: 0.02 * np.sign(speed) + 1e-4 * speed)
        noise = 2e-4 * random.standard_normal(len(log[AXIS, 'force'].value))
        force = replace(log[AXIS, 'force'], value=log[AXIS, 'force'].value + noise)
        noisy = MeasuredLog('log', (log[AXIS, 'position'], force))
        problem = Problem(motor, [record_of_measured_log(noisy, motor)])
        base = evaluate(problem, ())
        tuned = at_orders(problem, base, {AXIS})
        changes = signatures(problem, base, tuned, 1, lambda stage, done, total: None)
        for item in screen(problem, base, tuned, changes, [], Settings().prior_scales):
            assert item.likelihood + log_prior_of_orders(motor, item.cause) < 0.0


def test_a_cause_without_each_of_its_orders_the_strongest_first(motor) -> None:
    effect = with_orders({AXIS: (7, 12, 84)})
    values = dict.fromkeys(effect.typical(motor, AXIS), 0.0)
    values |= {'cosine_7': 1.0, 'sine_12': -3.0, 'cosine_84': 1.5, 'sine_84': 2.0}
    without_12, without_84, without_7 = with_an_order_less(Cause(effect, AXIS, values))
    assert without_12.values == {name: values[name] for name in values if '12' not in name}
    for one, orders in ((without_12, (7, 84)), (without_84, (7, 12)), (without_7, (12, 84))):
        names = [f'{wave}_{order}' for order in orders for wave in ('cosine', 'sine')]
        assert [item.name for item in one.effect.parameters(motor, AXIS)] == names
        assert one.values.keys() == set(names)


def test_nothing_is_left_of_a_cause_without_its_only_order(motor) -> None:
    effect = with_orders({AXIS: (7,)})
    of_library = find('cogging')
    assert with_an_order_less(Cause(effect, AXIS, effect.typical(motor, AXIS))) == []
    assert with_an_order_less(Cause(of_library, AXIS, of_library.typical(motor, AXIS))) == []


def test_any_orders_of_so_many_are_as_probable_as_others(motor) -> None:
    """16 orders for each of 7 pole pairs: one of 112, two of 112 * 111 / 2; the library's are given."""

    def cogging(*orders):
        effect = with_orders({AXIS: orders})
        return Cause(effect, AXIS, effect.typical(motor, AXIS))

    assert log_prior_of_orders(motor, cogging(7)) == pytest.approx(-math.log(112.0))
    assert log_prior_of_orders(motor, cogging(7, 12)) == pytest.approx(-math.log(6216.0))
    of_library = Cause(find('cogging'), AXIS, find('cogging').typical(motor, AXIS))
    assert log_prior_of_orders(motor, of_library) == 0.0


@settings(deadline=None)  # the first one compiles
@given(
    st.floats(1.0, 500.0),
    st.floats(1e-5, 0.3),
)
def test_observer_forgets_as_fast_as_it_says_at_any_rate_of_readings(frequency, time_s) -> None:
    """The error of a double integrator has the poles exp(-(z +- i sqrt(1 - z^2)) w h)."""
    gains = np.zeros(2)
    plant_block._observer_gains(frequency, time_s, gains)
    moves = np.array([[1.0, time_s], [0.0, 1.0]])
    corrected = np.array([[1.0 - gains[0], 0.0], [-gains[1], 1.0]])
    from_reading_to_reading = moves @ corrected
    damping = plant_block.OBSERVER_DAMPING
    pole = np.exp(complex(-damping, math.sqrt(1.0 - damping**2)) * frequency * time_s)
    assert np.linalg.det(from_reading_to_reading) == pytest.approx(abs(pole) ** 2, abs=1e-12)
    assert np.trace(from_reading_to_reading) == pytest.approx(2.0 * pole.real, abs=1e-12)


def test_a_slow_log_says_what_it_cannot_show(random, motor) -> None:
    record = aligned_record(log_of(random, step_s=1.0 / 150.0, jitter=0.0), motor)
    assert any('above 25 Hz' in note for note in record.notes)
    assert any('x_rotate.force against its position' in note for note in record.notes)


def test_a_skew_is_taken_out(random, motor) -> None:
    log = log_of(random, lambda angle, speed: 0.01 * np.sign(speed), jitter=0.0)
    force = log[AXIS, 'force']
    late = MeasuredLog('log', (log[AXIS, 'position'], replace(force, time_s=force.time_s + 5e-3)))
    record = aligned_record(late, motor)
    assert any('moved by that' in note for note in record.notes)
    residuals = [
        np.std(PlantBlock(one, motor).residuals(motor)[0])
        for one in (record, record_of_measured_log(late, motor))
    ]
    assert residuals[0] < residuals[1]


def late_log(random, late_s):
    """Return the log of a motor whose drive stands late in it, and the one in time."""
    log = log_of(random, jitter=0.0)
    force = log[AXIS, 'force']
    late = replace(force, time_s=force.time_s + late_s)
    return MeasuredLog('log', (log[AXIS, 'position'], late)), log


def test_a_skew_is_left_to_whoever_looks_for_causes(random, motor) -> None:
    late, _ = late_log(random, 5e-3)
    (record,) = aligned_records([late], motor, moved=False)
    assert record.current.tobytes() == record_of_measured_log(late, motor).current.tobytes()
    assert not any('against its position' in note for note in record.notes)
    sized, without = (
        sized_by([one], motor) for one in (record, replace(record, skew_spread_s=(0.0,) * 3))
    )
    # What a drive does between two samples stays open, and that alone.
    assert record.skew_spread_s[AXES.index(AXIS)] == pytest.approx(2e-3 / math.sqrt(12.0))
    effect = find('skew')
    assert effect.axes(sized) == (AXIS,)
    assert effect.axes(without) == effect.axes(motor) == ()


@pytest.mark.parametrize('late_ms', [2.0, 7.7])
def test_an_effect_moves_the_drive_to_where_it_belongs(random, motor, late_ms) -> None:
    late, in_time = late_log(random, 1e-3 * late_ms)
    own, moved = (record_of_measured_log(log, motor) for log in (in_time, late))
    sized = replace(motor, brought_in=frozenset({AXIS}))
    skewed = find('skew').apply(sized, AXIS, {'late': late_ms})

    def left_over(record, variant):
        # A slow observer shows a force that comes late as many counts.
        (found,) = PlantBlock(record, variant, observer_hz=10.0).residuals(variant)
        return float(np.std(found))

    assert left_over(moved, skewed) == pytest.approx(left_over(own, motor), rel=0.05)
    assert left_over(moved, motor) > 2.0 * left_over(own, motor)
    assert skewed.machine == sized.machine
    with_more = find('skew').apply(skewed, AXIS, {'late': 1.0})
    assert with_more.skew_s[AXIS] == pytest.approx(1e-3 * (late_ms + 1.0))


@pytest.mark.parametrize('late_ms', [2.0, 4.0, 5.5])
def test_a_late_encoder_leaves_the_observer_as_it_is(random, motor, late_ms) -> None:
    """
    What is late in a model and as late in the log cancels, noise and all.

    A delay of a fraction of a reading is a straight line between two of them.
    """
    log = log_of(random, jitter=0.0)
    position = log[AXIS, 'position']
    noisy = position.value + 3.0 / COUNTS * random.standard_normal(len(position.value))
    record = record_of_measured_log(log.with_signal(replace(position, value=noisy)), motor)
    sized = replace(motor, brought_in=frozenset({AXIS}))
    skewed = find('skew').apply(sized, AXIS, {'late': late_ms})
    late = find('encoder_delay').apply(skewed, AXIS, {'delay': late_ms})
    (wanted,), (found,), (without,) = (
        PlantBlock(record, variant).residuals(variant) for variant in (motor, late, skewed)
    )
    inside = slice(20, -20)
    error = np.std(found[inside] - wanted[inside])
    assert error < 0.005 * np.std(wanted)
    assert error < 0.1 * np.std(without[inside] - wanted[inside])


def test_effects_are_sized_by_what_the_log_used(random, motor) -> None:
    log = log_of(random)
    sized = sized_by([record_of_measured_log(log, motor)], motor)
    force = log[AXIS, 'force'].value
    assert places.rated_force(sized, AXIS) == pytest.approx(
        float(np.sqrt(np.mean(force**2))), rel=0.02
    )


@pytest.mark.parametrize('step_s', [5e-4, 2e-3, 2e-2])
def test_a_brisk_speed_is_the_largest_in_the_logs(random, motor, step_s) -> None:
    """Not what the force of the logs would reach: an axis may be fast with little of it."""
    log = log_of(random, step_s=step_s, jitter=0.0)
    sized = sized_by([record_of_measured_log(log, motor)], motor)
    time_s, angle = log[AXIS, 'position'].time_s, log[AXIS, 'position'].value
    fastest = float(np.max(np.abs(np.gradient(angle, time_s))))
    assert places.rated_speed(sized, AXIS) == pytest.approx(fastest, rel=0.1)
    assert places.rated_speed(motor, AXIS) != places.rated_speed(sized, AXIS)
    (_, speed) = find('stribeck_friction').parameters(sized, AXIS)
    assert speed.high > 0.1 * fastest


def test_where_a_described_controller_has_a_limit_effects_are_sized_by_that(random, motor) -> None:
    controller = {
        'kind': 'p', 'rate_hz': 1000, 'output': 'A', 'proportional_gain_per_rad': 4.0,
        'output_limit': 20.0,
    }  # fmt: skip
    machine = {**motor.machine, 'controllers': {AXIS: controller}}
    described = replace(motor, machine=machine)
    sized = sized_by([record_of_measured_log(log_of(random), motor)], described)
    per_ampere = places.force_per_ampere(described, AXIS)
    assert places.rated_force(sized, AXIS) == pytest.approx(0.1 * 20.0 * per_ampere)
    assert not sized.usual_current


def test_where_the_motor_has_a_peak_current_effects_are_sized_by_that(random, motor) -> None:
    rated = {**motor.machine['motors'][AXIS], 'peak_current_a': 12.0}
    described = replace(motor, machine={**motor.machine, 'motors': {AXIS: rated}})
    sized = sized_by([record_of_measured_log(log_of(random), motor)], described)
    per_ampere = places.force_per_ampere(described, AXIS)
    assert places.rated_force(sized, AXIS) == pytest.approx(0.1 * 12.0 * per_ampere)
    assert not sized.usual_current


@pytest.mark.parametrize(
    ('name', 'by_log'),
    [('coulomb_friction', True), ('cogging', True), ('force_constant', False)],
)
def test_what_the_log_used_tells_no_rating(random, motor, name, by_log) -> None:
    """The size of a force is then a guess, that of a ratio is not."""
    records = [record_of_measured_log(log_of(random), motor)]
    effect = find(name)
    assert Problem(sized_by(records, motor), records).sized_by_log(effect, AXIS) is by_log
    assert not Problem(motor, records).sized_by_log(effect, AXIS)


def test_what_cannot_be_used_is_said(random, motor, tmp_path) -> None:
    log = log_of(random)
    pendulum = Variant.of(load_model_or_machine('geared_pendulum'))
    with pytest.raises(UserError, match=r'x_rotate.*motors on y_rotate'):
        record_of_measured_log(log, pendulum)
    slides = MeasuredLog(
        'log', tuple(replace(s, unit={'rad': 'm', 'Nm': 'N'}[s.unit]) for s in log.signals)
    )
    with pytest.raises(UserError, match=r'slides.*turns'):
        record_of_measured_log(slides, motor)
    machine = {**motor.machine, 'encoders': {}}
    with pytest.raises(UserError, match='no encoder x_rotate'):
        record_of_measured_log(log, replace(motor, machine=machine))
    share = Signal(
        'drive_command', AXIS, '1', *(getattr(log[AXIS, 'force'], k) for k in ('time_s', 'value'))
    )
    with pytest.raises(UserError, match='peak current of an amplifier'):
        record_of_measured_log(MeasuredLog('log', (log[AXIS, 'position'], share)), motor)
    later = replace(log[AXIS, 'force'], time_s=log[AXIS, 'force'].time_s + 100.0)
    with pytest.raises(UserError, match='never known at once'):
        record_of_measured_log(MeasuredLog('log', (log[AXIS, 'position'], later)), motor)
    text = tmp_path / 'log.csv'
    text.write_text('time,angle\n', 'utf-8')
    with pytest.raises(UserError, match='waferbot import'):
        load_record(text, motor)


def test_an_imported_folder_is_a_log(random, motor, tmp_path) -> None:
    log = log_of(random)
    write_archive(log, tmp_path / 'imported')
    one, other = load_record(tmp_path / 'imported', motor), aligned_record(log, motor)
    assert one.reading.tobytes() == other.reading.tobytes()
    assert one.current.tobytes() == other.current.tobytes()


def test_a_machine_alone_has_no_controller(motor) -> None:
    assert motor.is_machine_alone
    assert places.controlled_axes(motor) == places.amplified_axes(motor) == ()
    rigid = Variant.of(load_model_or_machine('rigid'))
    assert not rigid.is_machine_alone
    assert 'ros__parameters' in rigid.text
    assert 'ros__parameters' not in motor.text
    assert 'bodies:' in motor.text
    with pytest.raises(UserError, match='there is no model'):
        load_model_or_machine('nowhere')
