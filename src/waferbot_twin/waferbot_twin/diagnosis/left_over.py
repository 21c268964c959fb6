# SPDX-License-Identifier: Apache-2.0
"""
What the causes leave unexplained, and where.

Thirteen kinds of evidence, none of which names a cause: the plant still moves as no noise would make it;
a block whose output follows from its input to the last bit still does something else; what is left
follows the command (`following`); it has the same tone in all logs (`periodogram`), the same line in its
spectrum (`spectral_lines`), or comes back along the way of an encoder (`encoder_orders`); an encoder
shows fewer values than the model's (`coarseness`); the logs want different values of a cause
(`agreement`); a cause seems larger in one place than in another (`steadiness`); none of its parts is
told, or not that it fades (`undetermined`); it is said to repeat where no log goes so far
(`repetition`); it makes the machine ring, which still rings (`still_ringing`); or a table of force over
speed or position explains it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from waferbot_lockstep.contract import AXIS_OF
from waferbot_twin.diagnosis.agreement import Disagreement, disagreements
from waferbot_twin.diagnosis.following import axes_that_follow
from waferbot_twin.diagnosis.nonparametric import tables
from waferbot_twin.diagnosis.proposals.coarseness import coarser_steps
from waferbot_twin.diagnosis.proposals.encoder_orders import lasting_periods
from waferbot_twin.diagnosis.proposals.periodogram import lasting_tones
from waferbot_twin.diagnosis.proposals.repetition import Unrepeated, unrepeated
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.diagnosis.proposals.spectral_lines import lasting_lines
from waferbot_twin.diagnosis.screening_rounds import Rounds
from waferbot_twin.diagnosis.search import search
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.steadiness import Unsteady, unsteady
from waferbot_twin.diagnosis.still_ringing import StillRinging, still_ringing
from waferbot_twin.diagnosis.together import far_channels
from waferbot_twin.diagnosis.undetermined import Undetermined, undetermined
from waferbot_twin.effects.places import motor_axes, moves_with
from waferbot_twin.residuals.problem import PLAIN, PLANT, Cause, Problem, apply_all

Doubt = Unsteady | Undetermined | Unrepeated | StillRinging
"""Why one cause may stand in for something else."""


@dataclass(frozen=True)
class LeftOver:
    """
    What the causes leave unexplained.

    Axes on which the plant is `moving` as no noise would make it, and on which something is `following`
    the command; by axis the frequency, Hz, of a tone or line (`sounding`); by encoder the period, in its
    counts, after which something is `repeating`; by axis the step, counts, of an encoder that is
    `coarser`; by block those with something `different`; causes on which the logs are `disagreeing`, and
    those in doubt for other reasons; `tables` of force that explain it.
    """

    moving: Sequence[str] = ()
    following: Sequence[str] = ()
    sounding: Mapping[str, float] = field(default_factory=dict)
    repeating: Mapping[str, float] = field(default_factory=dict)
    coarser: Mapping[str, float] = field(default_factory=dict)
    different: Mapping[str, Sequence[str]] = field(default_factory=dict)
    disagreeing: Sequence[Disagreement] = ()
    doubts: Sequence[Doubt] = ()
    tables: Sequence[Cause] = ()
    notes: Sequence[str] = ()

    @property
    def axes(self) -> list[str]:
        """All axes on which something is left unexplained, each once."""
        every = [cause.axis for cause in self.tables]
        every += [*self.moving, *self.following, *self.sounding, *self.coarser]
        every += [AXIS_OF[encoder] for encoder in self.repeating]
        every += [axis for axes in self.different.values() for axis in axes]
        every += [axis for item in self.disagreeing for axis in item.axes]
        every += [item.cause.axis for item in self.doubts]
        return list(dict.fromkeys(every))

    @property
    def contradicted(self) -> bool:
        """Whether the logs want different values of a cause, or more of it in one place."""
        return bool(self.disagreeing) or any(isinstance(item, Unsteady) for item in self.doubts)

    def in_doubt(self, cause: Cause, problem: Problem) -> bool:
        """
        Return whether there is reason to doubt a cause.

        The logs disagree on its values, one of `doubts` says so, or it acts in exact blocks alone, one
        of which still does something else.
        """
        if any(item.cause.name == cause.name for item in (*self.disagreeing, *self.doubts)):
            return True
        touched = problem.touched(cause.effect, cause.axis)
        return all(block in self.different for block in touched) and any(
            cause.axis in self.different[block] for block in touched
        )


def left_over(
    problem: Problem, judge: Problem, found: Search, progress: Progress, workers: int
) -> LeftOver:
    """Ask for all kinds of evidence; for tables only where the plant is near the machine."""
    moving = axes_that_move(problem, found)
    following = axes_that_follow(problem, judge, found)
    both = problem, found.found, judge, found.judged
    sounding = lasting_lines(*both) | lasting_tones(*both)
    repeating = lasting_periods(*both)
    coarser = coarser_steps(
        apply_all(problem.nominal, found.found.causes), (*problem.records, *judge.records)
    )
    different = axes_that_differ(problem, judge, found)
    disagreeing = [] if moving else disagreements(problem, judge, found)
    doubts = [] if moving else _doubts(problem, judge, found, sounding)
    tables_found = [] if moving else _tables(problem, judge, found, progress, workers)
    notes = [
        f'the {block} of {axis} still does something else than the model: causes in it are in doubt'
        for block, axes in different.items()
        for axis in axes
    ]
    notes += [str(item) for item in (*disagreeing, *doubts)]
    if following:
        notes.append(
            f'what is left over on {", ".join(following)} follows the command: it is no noise'
        )
    notes += [
        f'what is left over on {axis} has a tone of {frequency_hz:.1f} Hz in all logs'
        for axis, frequency_hz in sounding.items()
    ]
    notes += [
        f'what is left over of the encoder {encoder} comes back every {period:.1f} of its counts in all '
        'logs'
        for encoder, period in repeating.items()
    ]
    notes += [
        f'what {axis} shows are multiples of {step:g} counts, more than of the encoder of the model'
        for axis, step in coarser.items()
    ]
    if moving and found.found.causes:
        notes.append(
            f'what is left over on {", ".join(moving)} is no noise: the machine differs in more than '
            'the causes found, and their values are those that stand in for it best'
        )
    return LeftOver(
        moving=moving,
        following=following,
        sounding=sounding,
        repeating=repeating,
        coarser=coarser,
        different=different,
        disagreeing=disagreeing,
        doubts=doubts,
        tables=tables_found,
        notes=notes,
    )


def _doubts(
    problem: Problem, judge: Problem, found: Search, sounding: Mapping[str, float]
) -> list[Doubt]:
    return [
        *unsteady(problem, judge, found),
        *undetermined(problem, found.found),
        *unrepeated(found.found.causes, problem, judge),
        *still_ringing(problem, found.found, sounding),
    ]


def _tables(
    problem: Problem, judge: Problem, found: Search, progress: Progress, workers: int
) -> list[Cause]:
    """Return force tables that explain what the causes leave, if they are confirmed."""
    with_causes = Problem(apply_all(problem.nominal, found.found.causes), problem.records)
    judge_with = Problem(with_causes.nominal, judge.records)
    every = tables(problem.nominal, problem.records)
    rest = search(Rounds(with_causes, every, progress, workers), judge_with)
    return list(rest.found.causes)


def axes_that_move(problem: Problem, found: Search) -> list[str]:
    """Return the axes on which the plant with all causes still moves as no noise would make it."""
    variant = problem.nominal
    coordinates = {
        variant.description.encoders[name].coordinate
        for name, is_far in zip(
            problem.channel_names(PLANT), far_channels(found.found), strict=True
        )
        if is_far
    }
    return [
        axis
        for axis in motor_axes(variant)
        if any(moves_with(variant, axis, name) for name in coordinates)
    ]


def axes_that_differ(problem: Problem, judge: Problem, found: Search) -> dict[str, list[str]]:
    """
    Return for each exact block the axes on which it does something else than the model with the causes.

    What is left over in all logs together is plain. Right causes leave next to nothing, whatever their
    size: single bits, where a value is found to parts of a million.
    """
    axes: dict[str, list[str]] = {}
    for block in problem.exact_blocks:
        left = [
            logs.less_likely_than_nothing(block, hypothesis.residuals.get(block, []))
            for logs, hypothesis in ((problem, found.found), (judge, found.judged))
        ]
        axes[block] = [
            axis for axis in left[0] if sum(item.get(axis, 0.0) for item in left) > PLAIN
        ]
    return axes
