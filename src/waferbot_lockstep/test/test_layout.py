# SPDX-License-Identifier: Apache-2.0
"""Axes and encoders by name and place."""

import pytest

from waferbot_lockstep.contract import ENCODERS_TOPIC, PHASE_CURRENTS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import MOST_AXES, SHIPPED, Layout, layout_of

ARM = layout_of(('lift', 'elbow', 'wrist'), ('wrist', 'elbow_motor', 'elbow_load'))


def test_places_follow_the_axes_and_the_load_comes_before_the_motor():
    assert ARM.axes == ('lift', 'elbow', 'wrist')
    assert ARM.encoders == (
        'lift',
        'elbow_load',
        'elbow_motor',
        'wrist',
    )  # lift has none, but a place
    assert [ARM.place(axis) for axis in ARM.axes] == [0, 1, 2]
    assert ARM.encoders_of('elbow') == ('elbow_load', 'elbow_motor')
    assert {name: ARM.axis_of(name) for name in ARM.encoders} == {
        'lift': 'lift', 'elbow_load': 'elbow', 'elbow_motor': 'elbow', 'wrist': 'wrist'
    }  # fmt: skip


def test_masks_have_a_bit_for_each():
    assert (ARM.all_axes, ARM.all_encoders) == (0b111, 0b1111)
    assert ARM.mask(['wrist', 'lift', 'wrist']) == 0b101
    assert PHASE_CURRENTS.names_of(0b110, ARM) == 'elbow, wrist'
    assert ENCODERS_TOPIC.names_of(0b110, ARM) == 'elbow_load, elbow_motor'
    assert ENCODERS_TOPIC.all_places(ARM) == 0b1111
    with pytest.raises(ValueError, match='not in tuple'):
        ARM.mask(['knee'])


@pytest.mark.parametrize(
    ('axes', 'encoders'),
    [
        ((), ()),
        (('x_rotate', 'y_linear'), ('x_rotate',)),
        (('y_rotate',), ('y_rotate_motor', 'y_rotate_load')),
    ],
)
def test_what_the_shipped_machine_has_all_of_has_its_places(axes, encoders):
    assert layout_of(axes, encoders) is SHIPPED


@pytest.mark.parametrize(
    ('axes', 'encoders'),
    [(('y_linear', 'z_rotate'), ()), (('y_linear',), ('y_linear_motor',)), (('x',), ('x',))],
)
def test_any_other_has_its_own(axes, encoders):
    own = layout_of(axes, encoders)
    assert own.axes == axes
    assert set(encoders) <= set(own.encoders)


def test_as_many_axes_as_bits():
    axes = tuple(f'axis_{place}' for place in range(MOST_AXES))
    encoders = tuple(f'{axis}{side}' for axis in axes for side in ('_load', '_motor'))
    largest = layout_of(axes, encoders)
    assert (largest.all_axes, largest.all_encoders) == (0xFF, 0xFFFF)


@pytest.mark.parametrize(
    ('axes', 'encoders', 'words'),
    [
        ((), ('lift',), '0 axes'),
        (tuple(f'a{place}' for place in range(9)), (), '9 axes; a machine has 1 to 8'),
        (('Lift',), (), "'Lift' cannot be a name"),
        (('lift', 'lift'), (), 'lift comes twice'),
        (('lift_motor',), (), 'lift_motor cannot be a name'),
        (('lift',), ('elbow',), 'elbow is on no axis'),
        (('lift',), ('lift_other',), 'lift_other is on no axis'),
    ],
)
def test_names_that_cannot_be_are_refused_in_words(axes, encoders, words):
    with pytest.raises(UserError, match=words):
        layout_of(axes, encoders)


def test_a_layout_is_a_value():
    assert Layout(ARM.axes, ARM.encoders) == ARM
    assert len({ARM, Layout(ARM.axes, ARM.encoders), SHIPPED}) == 2
