# SPDX-License-Identifier: Apache-2.0
"""
Effects that are a controller's setting other than in the model.

I-variables are whole numbers. A ratio or difference is therefore rounded to the next value that
the controller can hold, and `resolution` says how far that is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from waferbot_pmac.i_variables import LARGEST_24_BIT, SMALLEST_24_BIT
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def ratio_effect(
    name: str,
    i_variable: str,
    summary: str,
    lowest: float = 0.2,
    typical: float = 0.9,
    title: str = '',
) -> Effect:
    """Return the effect of an I-variable that is `ratio` times that of the model."""

    def axes(variant: Variant) -> tuple[str, ...]:
        return tuple(
            axis
            for axis in places.controlled_axes(variant)
            if variant.i_variable(axis, i_variable) != 0.0
        )

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        step = 1.0 / abs(variant.i_variable(axis, i_variable))
        meaning = f'real {i_variable} over that of the model'
        return (Parameter('ratio', '', 1.0, typical, lowest, 3.0, meaning, resolution=step),)

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        value = round(variant.i_variable(axis, i_variable) * values['ratio'])
        return Overlay(pmac={axis: {i_variable: value}})

    equation = f'{i_variable} = ratio {i_variable} of the model'
    return Effect(
        name,
        Block.CONTROLLER,
        summary,
        axes,
        parameters,
        overlay,
        equation=equation,
        title=title,
    )


def difference_effect(
    name: str,
    i_variable: str,
    summary: str,
    typical: Callable[[Variant, str], float],
    lowest: int = SMALLEST_24_BIT,
    highest: int = LARGEST_24_BIT,
    title: str = '',
) -> Effect:
    """
    Return the effect of an I-variable that is `difference` more than in the model.

    For those that may be zero in the model. `typical` gives a value that is plainly seen, `lowest` and
    `highest` are what the controller takes.
    """

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        own = variant.i_variable(axis, i_variable)
        usual = float(round(typical(variant, axis)))
        low, high = max(-50.0 * usual, lowest - own), min(50.0 * usual, highest - own)
        meaning = f'{i_variable} more than in the model'
        return (Parameter('difference', '', 0.0, usual, low, high, meaning, resolution=1.0),)

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        value = round(variant.i_variable(axis, i_variable) + values['difference'])
        return Overlay(pmac={axis: {i_variable: value}})

    return Effect(
        name,
        Block.CONTROLLER,
        summary,
        places.controlled_axes,
        parameters,
        overlay,
        equation=f'{i_variable} = {i_variable} of the model + difference',
        title=title,
    )
