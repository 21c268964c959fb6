# SPDX-License-Identifier: Apache-2.0
"""
Every effect of the library, on every axis of the machine.

Truth is the machine without the effect: neutral values must leave it as it is to the last bit,
typical ones must be felt, well above the noise of a real log. An effect that nothing reads, that is
there when it should not be, or that needs another machine to be compiled, fails here.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import home_mass_matrix_and_weight
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import find_description
from waferbot_pmac.experiments import load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects import effects_page, find, library, places
from waferbot_twin.effects.effect import Values
from waferbot_twin.effects.load import load_of
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.problem import Cause, apply_all

TIMING = Timing()
TICKS = TIMING.ticks(0.65)
MOTION = """
name: all_axes_at_once
description: Every axis fast enough for every effect to be felt.
duration_s: 1.2
program:
  - {rapid: {y_linear_m: 0.06, x_rotate_rad: -0.4, y_rotate_rad: 0.6}}
  - {dwell_s: 0.4}
"""

NOISE = {'counts': 1.0 / 3.0, 'current': 0.003, 'command': 0.003, 'voltage': 0.3}
"""What the signals of a good machine are uncertain by: counts, A, A, V."""

PLAIN = 3.0
"""Largest change over that noise from which an effect counts as plainly seen."""

FAINT = frozenset({('bus_sag', 'y_rotate')})
"""Effects that are felt, but not plainly: this motor takes little power."""

DEPENDENT = (
    {'notch', 'wrong_proportional_gain'},  # both in Ixx30, which is rounded
    {'cable_slack', 'cable_second_mode'},  # both let a rigid cable give, not equally stiff
    {'wafer', 'wrong_inertia'},  # what is scaled includes the wafer, or not
    {'wafer', 'centre_of_gravity'},  # what is shifted includes the wafer, or not
    {'load', 'wrong_inertia'},  # what is scaled includes the other load, or not
)


@functools.cache
def nominal(name: str = 'rigid') -> Variant:
    """Return a machine with room for every effect."""
    return Variant.of(load_model(name))


def every(name: str = 'rigid') -> list[tuple[str, str]]:
    """Return every effect with every axis that it is on."""
    variant = nominal(name)
    return [(one.name, axis) for one in library().values() for axis in one.axes(variant)]


def neutral(name: str, variant: Variant, axis: str) -> Values:
    """Return the values at which an effect is not there."""
    return {
        item.name: item.typical if item.shape else item.neutral
        for item in find(name).parameters(variant, axis)
    }


def twin(variant: Variant) -> Twin:
    return Twin.of(variant.model(), TIMING, load_experiment(MOTION))


@functools.cache
def nominal_signals(name: str = 'rigid') -> Signals:
    return twin(nominal(name)).advance(TICKS)


def settings(variant: Variant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all that plant, controller and amplifiers know: the same arrays are the same run."""
    return (
        variant.build(TIMING).parameters(),
        servo_parameters(variant.pmac),
        amplifier_parameters(variant.copley, TIMING),
    )


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


def same_signals(one: Signals, other: Signals) -> bool:
    """Tell whether two runs gave the same signals, to the last bit."""
    return all(
        np.array_equal(value, getattr(other, name))
        for name, value in vars(one).items()
        if isinstance(value, np.ndarray)
    )


def change(one: Signals, other: Signals, axis: str) -> float:
    """Return the largest RMS change of a signal of an axis, over the noise that it usually has."""
    place = AXES.index(axis)
    own = [row for row, encoder in enumerate(ENCODERS) if encoder.startswith(axis)]
    differences = {
        'counts': one.counts[:, own] - other.counts[:, own],
        'current': (one.line_current - other.line_current)[:, 2 * place : 2 * place + 2],
        'command': (one.current_command - other.current_command)[:, place],
        'voltage': (one.voltage - other.voltage)[:, 3 * place : 3 * place + 3],
    }
    return max(
        float(np.sqrt(np.mean(np.square(values))).max()) / NOISE[name]
        for name, values in differences.items()
    )


def test_library() -> None:
    """At least 45 effects; what they say of themselves is complete."""
    assert len(library()) >= 45
    for effect in library().values():
        assert effect.summary
        assert effect.equation


def one_axis_each() -> list[tuple[str, str]]:
    """Return every effect with one axis, now this, now that."""
    axes = [(name, [axis for one, axis in every() if one == name]) for name in library()]
    return [(name, own[place % len(own)]) for place, (name, own) in enumerate(axes) if own]


def only_simplified() -> list[tuple[str, str]]:
    """Return the effects that make sense only where something gives or rubs already."""
    rigid = {name for name, _ in every()}
    return [(name, axis) for name, axis in every('simplified') if name not in rigid]


def check_neutral(model: str, name: str, axis: str) -> None:
    variant = find(name).apply(nominal(model), axis, neutral(name, nominal(model), axis))
    found, reference = settings(variant), settings(nominal(model))
    if not all(same_bits(one, other) for one, other in zip(found, reference, strict=True)):
        assert found[0].dtype == reference[0].dtype
        assert same_signals(twin(variant).advance(TICKS), nominal_signals(model))


def check_typical(model: str, name: str, axis: str) -> None:
    found = twin(find(name).apply(nominal(model), axis, {}))
    assert found.plant_parameters.dtype == settings(nominal(model))[0].dtype  # compiled already
    least = 0.0 if (name, axis) in FAINT else PLAIN
    assert change(found.advance(TICKS), nominal_signals(model), axis) > least


@pytest.mark.parametrize(('name', 'axis'), one_axis_each())
def test_neutral_is_no_effect(name: str, axis: str) -> None:
    check_neutral('rigid', name, axis)


@pytest.mark.parametrize(('name', 'axis'), one_axis_each())
def test_typical_is_felt(name: str, axis: str) -> None:
    check_typical('rigid', name, axis)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'axis'), every())
def test_neutral_is_no_effect_on_every_axis(name: str, axis: str) -> None:
    check_neutral('rigid', name, axis)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'axis'), every())
def test_typical_is_felt_on_every_axis(name: str, axis: str) -> None:
    check_typical('rigid', name, axis)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'axis'), only_simplified())
def test_effects_of_flexible_models(name: str, axis: str) -> None:
    check_neutral('simplified', name, axis)
    check_typical('simplified', name, axis)


@pytest.mark.parametrize('model', ['rigid', 'simplified'])
def test_parameters_are_in_order(model: str) -> None:
    variant = nominal(model)
    for name, axis in every(model):
        for item in find(name).parameters(variant, axis):
            assert item.low <= item.neutral <= item.high, (name, axis, item)
            assert item.low <= item.typical <= item.high, (name, axis, item)
            assert item.low < item.high, (name, axis, item)
            assert item.shape or item.typical != item.neutral or 'cosine_3' in item.name
        for trial in find(name).trials(variant, axis):
            find(name).complete(variant, axis, trial)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'axis'), every())
def test_bounds_are_a_model(name: str, axis: str) -> None:
    """What is within the bounds is a machine that can be built, wherever it is."""
    parameters = find(name).parameters(nominal(), axis)
    for item in parameters:
        for value in (item.low, item.high):
            variant = find(name).apply(nominal(), axis, {item.name: value})
            twin(variant).advance(1)


@pytest.mark.parametrize('model', ['rigid', 'simplified'])
def test_effects_on_a_whole_machine(model: str) -> None:
    """Neutral and typical values give descriptions that load, and differ."""
    check_whole_library(Variant.of(load_model(model)))


@pytest.mark.parametrize('name', ['direct_drive_motor', 'geared_pendulum', 'two_mass_drive'])
def test_effects_on_other_machines(name: str) -> None:
    """Descriptions of one axis, without a controller and an amplifier that are known."""
    text = whole_text(find_description(name))
    variant = Variant(name, yaml.safe_load(text), 'improved', {}, {})
    assert check_whole_library(variant) >= 20


def check_whole_library(variant: Variant) -> int:
    """Apply every effect on every axis; return how many there are."""
    count = 0
    for effect in library().values():
        for axis in effect.axes(variant):
            without = effect.apply(variant, axis, neutral(effect.name, variant, axis))
            with_it = effect.apply(variant, axis, {})
            pairs = zip(settings(without), settings(with_it), strict=True)
            assert not all(same_bits(one, other) for one, other in pairs), (effect.name, axis)
            count += 1
    return count


def same_data(one: Any, other: Any) -> bool:
    """Tell whether two descriptions say the same, numbers to rounding; order of keys aside."""
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(same_data(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same_data, one, other))
    if isinstance(one, float) or isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-15)
    return bool(one == other)


def test_bearings_that_follow_their_charts_are_asked_how_soft_and_not_how_they_stiffen() -> None:
    data = yaml.safe_load(whole_text(find_description('flexible')))
    names = [name for name in data['connections'] if 'bearing' in name]
    for name in names:
        data['connections'][name]['stiffness_by'] = 'chart'
    variant = Variant('by charts', data, 'improved', {}, {})
    stiffens = find('load_dependent_bearing_stiffness')
    assert stiffens.axes(nominal('flexible'))
    assert stiffens.axes(variant) == ()
    asked = 0
    for effect in library().values():
        for axis in effect.axes(variant) if effect.name.endswith('compliance') else ():
            softer = effect.apply(variant, axis, {}).description.connections
            for name in names:
                before = variant.description.connections[name]
                if softer[name].curve != before.curve:
                    asked += 1
                    ratio = softer[name].stiffness / before.stiffness
                    assert softer[name].curve.slope(0.0) < before.curve.slope(0.0)
                    assert 0.5 < ratio < 0.9
    assert asked >= 2


def test_independent_effects_commute() -> None:
    """Pairs drawn at random, on any axes: the order in which they are laid over does not matter."""
    seed = int(np.random.default_rng().integers(2**31))
    random = np.random.default_rng(seed)
    pairs = list(itertools.combinations(every('simplified'), 2))
    variant = nominal('simplified')
    for place in random.choice(len(pairs), 60, replace=False):
        (one, axis), (other, other_axis) = pairs[int(place)]
        if one == other or {one, other} in DEPENDENT:
            continue
        forth = find(other).apply(find(one).apply(variant, axis, {}), other_axis, {})
        back = find(one).apply(find(other).apply(variant, other_axis, {}), axis, {})
        what = f'seed {seed}: {one}:{axis} and {other}:{other_axis}'
        assert same_data(forth.machine, back.machine), what
        assert same_data(forth.pmac, back.pmac), what
        assert same_data(forth.copley, back.copley), what


@pytest.mark.parametrize(
    ('compliance', 'carried'),
    [
        ('gearbox_compliance', 'backlash'),
        ('gearbox_compliance', 'transmission_error'),
        ('belt_compliance', 'belt_slip'),
        ('cable_compliance', 'cable_slack'),
    ],
)
def test_a_part_that_gives_by_itself_carries_what_else_it_does(
    compliance: str, carried: str
) -> None:
    """In either order: its stiffness and loss are its own, not those of a part that only carries."""
    (axis,) = set(find(compliance).axes(nominal())) & set(find(carried).axes(nominal()))
    alone = find(compliance).apply(nominal(), axis, {})
    first = find(carried).apply(alone, axis, {})
    last = find(compliance).apply(find(carried).apply(nominal(), axis, {}), axis, {})
    assert same_data(first.machine, last.machine)
    ((name, part),) = (
        (name, part) for name, part in alone.description.connections.items() if part.flexible
    )
    for variant in (first, last):
        assert variant.description.connections[name].stiffness == pytest.approx(part.stiffness)
        assert variant.description.connections[name].loss_factor == part.loss_factor


def test_what_only_carries_an_error_of_the_teeth_does_not_ring() -> None:
    """With the loss of the gear, none, the loop made it swing by hundreds of counts at 500 Hz."""
    effect = find('transmission_error')
    typical = effect.typical(nominal(), 'y_rotate')
    little = {**typical, 'cosine': 0.01 * typical['cosine'], 'sine': 0.01 * typical['sine']}
    with_error = effect.apply(nominal(), 'y_rotate', little)
    moved, as_usual = (twin(variant).advance(18000).counts for variant in (with_error, nominal()))
    assert np.max(np.abs(moved - as_usual)) < 20


def test_sizes_do_not_change_with_other_effects() -> None:
    weaker = find('force_constant').apply(nominal(), 'x_rotate', {'ratio': 0.5})
    for effect in library().values():
        for axis in effect.axes(nominal()):
            values = {item.name: item.high for item in effect.parameters(nominal(), axis)}
            assert effect.complete(weaker, axis, values) == values


def test_what_an_effect_does_not_know_is_said() -> None:
    with pytest.raises(UserError, match=r"no effect 'coulomb_frictio'.*coulomb_friction"):
        find('coulomb_frictio')
    effect = find('backlash')
    with pytest.raises(UserError, match='backlash is not on axis'):
        effect.complete(nominal(), 'x_rotate', {})
    with pytest.raises(UserError, match=r"no parameter 'gab'.*gap"):
        effect.complete(nominal(), 'y_rotate', {'gab': 0.001})
    with pytest.raises(UserError, match='gap = 5 rad is out of range'):
        effect.complete(nominal(), 'y_rotate', {'gap': 5.0})


def test_compliance_is_what_was_asked_for() -> None:
    """Through the data of its part, for every group: stiffness of the connection is 1 / compliance."""
    variant = nominal()
    for name, axis in every():
        if not name.endswith('_compliance'):
            continue
        (item,) = find(name).parameters(variant, axis)
        connection = item.meaning.removeprefix('1 / stiffness of ')
        found = find(name).apply(variant, axis, {'compliance': 2.5 * item.typical})
        part = found.description.connections[connection]
        assert part.flexible
        assert part.stiffness == pytest.approx(0.4 / item.typical, rel=1e-9)


def test_wafer_is_two_bodies() -> None:
    """By its own energy: inertia about the joint is that of the arm and that of the disc there."""
    mass, radius = 0.5, 0.15
    arm = nominal().description.bodies['y_rotate_load']
    tip = 2.0 * (arm.centre_of_gravity[2] - 0.0)
    changed = find('wafer').apply(nominal(), 'y_rotate', {'mass': mass})
    more = places.moving_inertia(changed_base(changed), 'y_rotate') - places.moving_inertia(
        nominal(), 'y_rotate'
    )
    assert more == pytest.approx(mass * (radius**2 / 2.0 + tip**2), rel=1e-9)


def changed_base(variant: Variant) -> Variant:
    """Return a variant as if it were the model."""
    return replace(variant, origin=None)


def test_a_load_is_of_a_body_that_can_be() -> None:
    """Inertia by second moments of mass, J_xx = S_yy + S_zz; what a variant has is read back."""
    variant = nominal()
    values = {
        'mass': 3.0, 'offset_x': 0.01, 'offset_y': -0.02, 'offset_z': 0.03,
        'moment_x': 0.05, 'moment_y': 0.2, 'moment_z': 0.3,
    }  # fmt: skip
    changed = find('load').apply(variant, 'x_rotate', values)
    name = places.carried_body(variant, 'x_rotate').name
    before, after = (one.description.bodies[name] for one in (variant, changed))
    assert after.mass - before.mass == pytest.approx(3.0)
    assert after.centre_of_gravity - before.centre_of_gravity == pytest.approx([0.01, -0.02, 0.03])
    assert np.diag(after.inertia - before.inertia) == pytest.approx([0.5, 0.35, 0.25])
    assert load_of(variant, changed, 'x_rotate') == pytest.approx(values, abs=1e-12)
    emptied = {item.name: item.low for item in find('load').parameters(variant, 'x_rotate')}
    least = find('load').apply(variant, 'x_rotate', emptied).description.bodies[name].inertia
    moments = np.sort(np.linalg.eigvalsh(least))
    assert 0.0 < moments[2] < moments[0] + moments[1]


def test_a_load_is_asked_for_where_another_axis_carries_it() -> None:
    """On a single axis inertia and centre of gravity say all that is felt of one."""
    assert find('load').axes(nominal()) == ('x_rotate', 'y_rotate')
    pendulum = Variant.of(load_model_or_machine('geared_pendulum'))
    assert find('load').axes(pendulum) == ()


def test_centre_of_gravity_turns_the_axis() -> None:
    """m g x offset of the bias that holds the axis, against the weight on its coordinate."""
    offset = 0.01
    changed = find('centre_of_gravity').apply(
        nominal(), 'x_rotate', {'offset_y': 0.0, 'offset_z': offset}
    )
    weights = []
    for variant in (nominal(), changed):
        assembly = variant.rigid
        _, weight = home_mass_matrix_and_weight(
            list(assembly.links),
            assembly.placing,
            len(assembly.coordinates),
            variant.description.gravity,
        )
        weights.append(weight[assembly.coordinates.index('x_rotate')])
    mass = nominal().description.bodies['x_rotate_load'].mass
    assert weights[1] - weights[0] == pytest.approx(mass * 9.81 * offset, rel=1e-9)


def test_a_delay_is_a_time_and_long_only_where_nobody_knows_what_lies_between():
    effect, cycles_per_ms = find('encoder_delay'), 9.0
    (known,) = effect.parameters(nominal(), 'x_rotate')
    assert known.unit == 'ms'
    assert known.high == pytest.approx(14.0 / cycles_per_ms)
    late = effect.apply(nominal(), 'x_rotate', {'delay': 1.2})
    parameters = late.build(TIMING).parameters()[0]
    place = ENCODERS.index('x_rotate')
    found = parameters['encoder_delay'][place] + parameters['delay_fraction'][place]
    assert found == pytest.approx(1.0 + 1.2 * cycles_per_ms)

    text = whole_text(find_description('single_mass'))
    alone = Variant('single_mass', yaml.safe_load(text), 'improved', {}, {})
    (free,) = effect.parameters(alone, 'y_linear')
    assert free.high == 20.0
    slow = Timing(8000, 1, 1)
    parameters = effect.apply(alone, 'y_linear', {'delay': 20.0}).build(slow).parameters()[0]
    assert parameters['encoder_delay'][ENCODERS.index('y_linear')] == 1 + 160
    command = find('command_delay')
    (item,) = command.parameters(nominal(), 'x_rotate')
    assert (item.unit, item.high) == ('ms', pytest.approx(8.0 / 2.25))
    for interrupts in range(9):
        machine = command.apply(nominal(), 'x_rotate', {'delay': interrupts * item.resolution})
        assert machine.pmac['x_rotate']['command_delay'] == interrupts


def test_of_a_logged_force_nobody_asks_what_the_motor_makes_of_its_current():
    forced = replace(nominal(), force_driven=frozenset({'x_rotate'}))
    later = find('coulomb_friction').apply(forced, 'x_rotate', {})
    for name in ('motor_saturation', 'torque_ripple', 'winding_imbalance'):
        assert 'x_rotate' in find(name).axes(nominal())
        for variant in (forced, later):
            assert 'x_rotate' not in find(name).axes(variant)
            assert 'y_rotate' in find(name).axes(variant)
    for name in ('force_constant', 'cogging'):  # of the force itself
        assert 'x_rotate' in find(name).axes(forced)


def test_page_is_up_to_date() -> None:
    """If this fails: python -m waferbot_twin.effects.effects_page docs/effects.md."""
    page = (Path(__file__).parents[3] / 'docs' / 'effects.md').read_text('utf-8')
    assert effects_page.renewed(page) == page


def test_the_readme_says_how_many_effects_there_are():
    readme = (Path(__file__).parents[3] / 'README.md').read_text('utf-8')
    assert f'[{len(library())}](docs/effects.md)' in readme


def test_there_is_one_floor_and_each_direction_of_it_has_one_name():
    nominal = Variant.of(load_model('rigid'))
    effect = find('floor_vibration')
    directions = []
    for axis in effect.axes(nominal):
        machine = effect.overlay(nominal, axis, effect.typical(nominal, axis)).machine
        acceleration = np.array(machine['vibration']['acceleration_m_s2'])
        directions.append(acceleration / np.linalg.norm(acceleration))
    assert len(directions) >= 2
    cosines = np.abs(np.array(directions) @ np.array(directions).T)
    assert np.max(cosines - np.eye(len(directions))) < 0.9


@pytest.mark.parametrize('axis', ['y_linear', 'x_rotate', 'y_rotate'])
def test_friction_that_differs_with_direction_is_coulomb_friction_and_a_constant_force(axis):
    nominal = Variant.of(load_model('rigid'))
    effect = find('direction_dependent_friction')
    assert axis in effect.axes(nominal)
    assert effect.distinct_axes(nominal) == ()
    forward, backward = effect.typical(nominal, axis).values()
    one = effect.apply(nominal, axis, {'forward': forward, 'backward': backward})
    other = nominal
    for name, value in zip(
        effect.same_as, (0.5 * (forward + backward), 0.5 * (backward - forward)), strict=True
    ):
        (parameter,) = find(name).parameters(nominal, axis)
        other = find(name).apply(other, axis, {parameter.name: value})
    moved = [twin(variant).advance(3000).counts for variant in (one, other)]
    assert np.max(np.abs(moved[0] - moved[1])) <= 1
    assert np.max(np.abs(moved[0] - twin(nominal).advance(3000).counts)) > 10


@pytest.mark.parametrize(
    ('name', 'axis', 'power'),
    [
        ('counterweight_friction', 'y_linear', 1),
        ('gearbox_friction', 'y_rotate', 1),
        ('gearbox_damping', 'y_rotate', 2),  # the speed of the motor is larger by the ratio, too
        ('motor_inertia', 'y_rotate', 2),
    ],
)
def test_what_is_behind_what_may_give_is_told_from_the_same_at_the_axis_only_if_it_does(
    name, axis, power
):
    effect = find(name)
    rigid, flexible = (Variant.of(load_model(model)) for model in ('rigid', 'flexible'))
    assert effect.axes(rigid) == effect.axes(flexible) == (axis,)
    assert effect.distinct_axes(rigid) == ()
    assert effect.distinct_axes(flexible) == (axis,)
    # In the rigid model the same force at the axis moves it in the same way.
    ratio = places.motor_ratio(rigid, axis)
    same = find(*effect.same_as)
    value = next(iter(effect.typical(rigid, axis).values()))
    (behind,), (of_axis,) = (item.parameters(rigid, axis) for item in (effect, same))
    one = effect.apply(rigid, axis, {behind.name: value})
    other = same.apply(rigid, axis, {of_axis.name: value * ratio**power})
    moved = [twin(variant).advance(600).counts for variant in (one, other)]
    assert np.max(np.abs(moved[0] - moved[1])) <= 1
    assert np.max(np.abs(moved[0] - nominal_signals().counts[: len(moved[0])])) > 1


@pytest.mark.parametrize(
    ('example', 'axis', 'least', 'most'),
    [
        # its output is bolted to a table of 2e4 kg m2, and the gear between them gives
        ('locked_cycloidal_drive', 'x_rotate', 0.02, 0.021),
        ('rigid', 'y_linear', 30.0, 300.0),
    ],
)
def test_an_inertia_error_is_a_share_of_what_is_one_with_the_axis(example, axis, least, most):
    nominal = Variant.of(load_model_or_machine(example))
    (item,) = find('wrong_inertia').parameters(nominal, axis)
    assert least <= item.typical / 0.05 <= most


@pytest.mark.parametrize(
    ('example', 'axis', 'unit'),
    [
        ('locked_cycloidal_drive', 'x_rotate', 'rad'),
        ('ball_screw_stage', 'y_linear', 'm'),
        ('rigid', 'y_rotate', 'rad'),
    ],
)
def test_couplings_and_screws_have_play_like_gears(example, axis, unit):
    nominal = Variant.of(load_model_or_machine(example))
    effect = find('backlash')
    assert axis in effect.axes(nominal)
    (item,) = effect.parameters(nominal, axis)
    assert item.unit == unit
    variant = apply_all(nominal, [Cause(effect, axis, {'gap': item.typical})])
    gaps = {part.gap for part in variant.description.connections.values()} - {0.0}
    assert gaps == {item.typical}


@pytest.mark.parametrize(
    ('example', 'axes'),
    [('emps', ('y_linear',)), ('direct_drive_motor', ()), ('geared_pendulum', ())],
)
def test_the_scale_of_a_disc_is_exact(example, axes) -> None:
    """After a turn it shows what it did before, so only a length can be measured too long."""
    nominal = Variant.of(load_model_or_machine(example))
    assert find('encoder_scale').axes(nominal) == axes
