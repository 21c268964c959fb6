# SPDX-License-Identifier: Apache-2.0
"""What the reader of a diagnosis must know beside its causes, one sentence each, in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from waferbot_twin.diagnosis.wording import metres_per_count, title
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.plain_values import significant, with_prefix
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.residuals.record import Record

ONE_LOG = 'one log only: the gain is that in its last part, which was not used for the fit'

NO_CONTROLLER = (
    'the controller was not looked at: that takes a recording with servo_state and '
    'current_command, and a model that has a controller'
)

LOSES = (
    'in closed loop the extended model is further from the logs than the nominal one, and none of '
    'its causes alone is to blame: something is missing that these depend on'
)


def no_gain(log: str) -> str:
    """Say that no stretch of a validation log is long enough to predict its motion."""
    return (
        f'{log}: there is no gain to tell; it has times without a position everywhere, and between '
        'two of them it is too short to predict its motion'
    )


def refuted(nominal: Variant, cause: Cause) -> str:
    """Say that the validation data refute a cause, as the estimation data predict them."""
    return (
        f'{title(nominal, cause)} was withdrawn: by what the estimation data predict, '
        'the validation data refute it'
    )


def worse_with(nominal: Variant, cause: Cause) -> str:
    """Say that the extended model is better in closed loop without a cause."""
    better = 'in closed loop the extended model is nearer to the logs without it'
    return f'{title(nominal, cause)} was withdrawn: {better}'


def against_the_forces(axis: str, log: str, nominal: float, extended: float) -> str:
    """Say that the extended model tells the forces of a log worse than the nominal one; both shares."""
    of_extended, of_nominal = (f'{100.0 * one:.0f} %' for one in (extended, nominal))
    return (
        f'the forces of {axis} in {log} speak against what was found there: by inverse dynamics the '
        f'extended model leaves {of_extended} of them, the nominal one {of_nominal}'
    )


def not_exact(nominal: Variant, block: str, axis: str) -> str:
    """Say that a block without noise leaves something over, so that nothing found there is sure."""
    return (
        f'the {block} of {nominal.titles[axis]} follows from its input to the last bit, and something '
        'is left over: what was found there alone may stand for what is not in the library, and has no '
        'name'
    )


def in_windows(
    record: Record,
    spans_s: Sequence[tuple[float, float]],
    nominal: Variant,
    errors: Mapping[str, tuple[float, float]],
) -> str:
    """
    Say which windows of a log were used, and what the extended model leaves over there and elsewhere.

    `errors` are RMS values in counts, by encoder, in these windows and in the rest.
    """
    used_s, whole_s = sum(last - first for first, last in spans_s), record.duration_s
    spans = ', '.join(f'{first:.1f} to {last:.1f}' for first, last in spans_s)
    said = (
        f'{record.name} is longer than needed: of its {whole_s:.1f} s those {used_s:.1f} s were used '
        f'that tell most of its motion ({spans} s)'
    )
    for channel, both in errors.items():
        axis = record.layout.axis_of(channel)
        per_count, unit = metres_per_count(nominal, axis)
        factor, unit = with_prefix(max(both) * per_count, unit)
        inside, outside = (significant(factor * per_count * value, 3) for value in both)
        said += (
            f'; the extended model leaves over {inside} {unit} RMS there on {nominal.titles[axis]}, '
            f'and {outside} {unit} in the rest'
        )
    return said


def stands_for(variant: Variant, name: str, axis: str, same_as: Sequence[str]) -> str:
    """Say which effects together do exactly what another effect does on an axis of this model."""
    both = ' and '.join(find(one).title for one in same_as)
    verb = 'stands' if len(same_as) == 1 else 'together stand'
    same = f'{find(name).title} does the same on {variant.titles[axis]}'
    return f'in this model {same}: {both} {verb} for it, too'


def not_what_it_was(what: str, origin: str, apart: float) -> str:
    """Say that a value is not that of earlier logs, `origin`; both are so many standard errors apart."""
    return (
        f'{what.replace("_", " ")} is not what it was ({origin}): these logs and those before differ by '
        f'{apart:.1f} standard errors, so what was known is left out'
    )
