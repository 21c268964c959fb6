# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a name, where it acts, its parameters, and how it changes a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.effects.variant import Overlay, Variant

Values = dict[str, float]


class Block(Enum):
    """The block of the loop that an effect is in; what is replayed alone to find it."""

    PLANT = 'plant'
    MOTOR = 'motor'
    AMPLIFIER = 'amplifier'
    CONTROLLER = 'controller'
    SENSOR = 'sensor'
    ENVIRONMENT = 'environment'


@dataclass(frozen=True)
class Parameter:
    """
    A parameter of an effect.

    `neutral` is the value at which the effect is not there, `typical` one that is plainly seen on a
    real machine (the first trial of a fit), `low` and `high` bound what is physically possible.
    A `shape` parameter has no effect of its own (a phase, a frequency, a time constant): it only
    says how the others act. A `fixed` one is given by how the machine was made (teeth, poles, a
    turn): it is one of the trials, unless logs say plainly that it is none of them. It is `guessed`
    where the description does not have it, and the trials are what other machines have. What is held in
    whole numbers changes only in steps of `resolution`: a difference quotient must not be taken over
    less. 0 is continuous. `spread` is the standard deviation that it usually has about `neutral`: a
    prior that is part of the fit (`residuals.prior_block`); 0 where there is none.
    """

    name: str
    unit: str
    neutral: float
    typical: float
    low: float
    high: float
    meaning: str
    shape: bool = False
    resolution: float = 0.0
    fixed: bool = False
    guessed: bool = False
    spread: float = 0.0


Trials = Callable[[Variant, str], tuple[Values, ...]]
Length = Callable[[Variant, str, Mapping[str, float]], float]


def always(variant: Variant, axis: str) -> bool:
    """Tell an effect from every other one, in any model."""
    return True


def nowhere(variant: Variant, axis: str) -> bool:
    """Tell an effect from every other one in no model."""
    return False


def one_trial(variant: Variant, axis: str) -> tuple[Values, ...]:
    """Return the one trial of an effect whose typical shape parameters will do."""
    return ({},)


def several_trials(name: str, *values: float) -> Trials:
    """Return the trials of an effect with one shape parameter that is worth several beginnings."""
    return lambda variant, axis: tuple({name: value} for value in values)


def never(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
    """Return 0: the effect does not repeat along the way."""
    return 0.0


@dataclass(frozen=True)
class Effect:
    """
    A physical cause.

    `title` is the noun phrase that an engineer would say: the name in words if none is given.
    `parameters(variant, axis)` gives the parameters with values that fit the machine (a friction is
    measured by the motor's force, a compliance by what hangs on it), in a fixed order; `axes(variant)`
    the axes on which it makes sense; `overlay(variant, axis, values)` what it changes in a model that
    has none of it; `trials` other sets of shape parameters to begin a fit from; `equation` is for the
    documentation. An effect with a `threshold` (a limit, a gap) changes nothing while it is small: its
    signature must be sought at typical values, not near the neutral ones. A little of one that `rings`
    makes the machine ring, the higher the less there is of it. Where the model has none of an effect,
    it is `tried_at` so many times its typical size, if a little of it says nothing of more; one that
    grows in proportion, but only once a part has let go, `begins_at` a share of its typical size.
    `tone` is the shape parameter that is a frequency, if the effect is there at this one and nowhere
    else; `cycle` is that which is a period of the axis' encoder, in counts or its unit. One whose name
    says that it repeats along the way `repeats_after` a length, m or rad of its axis (0: never). Of a
    `usual` one every machine has some. One that is `evident` stands in the readings themselves, and no
    noise feigns it. Where one is not `distinct` in a model, the effects `same_as` together do exactly
    the same and stand for it.
    """

    name: str
    block: Block
    summary: str
    axes: Callable[[Variant], tuple[str, ...]]
    parameters: Callable[[Variant, str], tuple[Parameter, ...]]
    overlay: Callable[[Variant, str, Mapping[str, float]], Overlay]
    trials: Trials = one_trial
    equation: str = ''
    threshold: bool = False
    usual: bool = False
    rings: bool = False
    tried_at: tuple[float, ...] = ()
    begins_at: float = 0.0
    evident: bool = False
    tone: str = ''
    cycle: str = ''
    repeats_after: Length = never
    same_as: tuple[str, ...] = ()
    distinct: Callable[[Variant, str], bool] = always
    title: str = ''

    def __post_init__(self) -> None:
        """Make a title of the name where none is given."""
        if not self.title:
            object.__setattr__(self, 'title', self.name.replace('_', ' '))

    def distinct_axes(self, variant: Variant) -> tuple[str, ...]:
        """Return the axes on which the effect makes sense and no other one does exactly the same."""
        return tuple(axis for axis in self.axes(variant) if self.distinct(variant, axis))

    def typical(self, variant: Variant, axis: str) -> Values:
        """Return the typical value of every parameter."""
        return {item.name: item.typical for item in self.parameters(variant, axis)}

    def complete(self, variant: Variant, axis: str, values: Mapping[str, float]) -> Values:
        """
        Return `values` with typical ones for what they leave out.

        Sizes and bounds are those of the model before any effect, so that they do not change with what
        else is laid over it. Raises `UserError` for an axis or parameter that the effect does not
        have, and for a value out of bounds.
        """
        variant = variant.base
        axes = self.axes(variant)
        if axis not in axes:
            raise UserError(
                f'effect {self.name} is not on axis {axis!r}{did_you_mean(axis, axes)} '
                f'(axes: {", ".join(axes) or "none in this model"})'
            )
        parameters = {item.name: item for item in self.parameters(variant, axis)}
        for name, value in values.items():
            if name not in parameters:
                raise UserError(
                    f'effect {self.name} has no parameter {name!r}{did_you_mean(name, parameters)} '
                    f'(parameters: {", ".join(parameters)})'
                )
            item = parameters[name]
            if not item.low <= value <= item.high:
                raise UserError(
                    f'effect {self.name}:{axis}: {name} = {value:g} {item.unit} is out of range '
                    f'({item.low:g} to {item.high:g} {item.unit})'
                )
        return {name: float(values.get(name, item.typical)) for name, item in parameters.items()}

    def apply(self, variant: Variant, axis: str, values: Mapping[str, float]) -> Variant:
        """Return the variant with the effect; raises `UserError`."""
        return variant.with_overlay(
            self.overlay(variant, axis, self.complete(variant, axis, values))
        )
