# SPDX-License-Identifier: Apache-2.0
"""
The numbers that decide what is named: arguments of a diagnosis, written into its report.

Where a fit begins, how finely grids are and when a fit ends is with the code that does it.
"""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_lockstep.errors import UserError


@dataclass(frozen=True)
class Settings:
    """
    What decides which causes are named.

    expected_causes    how many causes a machine has, before its logs are seen: a candidate has the
                       prior probability expected_causes / number of candidates
    prior_scales       standard deviations of an effect's size, in its typical size; each equally
                       probable (a normal scale mixture: heavy tails, much mass near zero)
    unrated_scales     further ones where nobody says what a drive can do, so that the typical size
                       follows from the currents of the logs
    spread_of_masses, spread_of_force_constants, spread_of_frictions
                       standard deviations, as shares, by which every machine's parameters differ from
                       its model's (`nuisance`)
    spread_of_dampings standard deviation of the natural logarithm of the damping of what gives: within
                       a factor of 20 of the model's (two of them), as the thesis had to raise it
    included_from      inclusion probability from which on an effect is in the model of the search: with
                       1/2 that is the one of all models that predicts best (M. Barbieri, J. Berger,
                       Annals of Statistics 32, 2004: median probability model)
    named_from         inclusion probability from which on a cause is named, and in the extended model:
                       10/11 where a wrong name costs ten times as much as a name that is not given
    credible_level     probability that a credible set holds at least
    most_causes        how many causes are looked for at most
    most_refits        how many candidates are refitted through the simulation in each step
    most_asked         how often the posterior of an effect is asked for at most
    refutation_level   likelihood ratio, with a cause over without, below which the validation data
                       refute it: at most the probability that they refute a true one
    tolerated_loss     rise of the mean square error in closed loop (1 % in RMS) up to which an
                       extension does not lose

    Raises `UserError` for a value out of its range.
    """

    expected_causes: float = 1.0
    prior_scales: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)
    unrated_scales: tuple[float, ...] = (30.0, 100.0)
    spread_of_masses: float = 0.03
    spread_of_force_constants: float = 0.03
    spread_of_frictions: float = 0.1
    spread_of_dampings: float = 1.5
    included_from: float = 0.5
    named_from: float = 10.0 / 11.0
    credible_level: float = 0.95
    most_causes: int = 40
    most_refits: int = 8
    most_asked: int = 24
    refutation_level: float = 1e-3
    tolerated_loss: float = 0.02

    def __post_init__(self) -> None:
        """Check every value."""
        shares = (
            'included_from',
            'named_from',
            'credible_level',
            'refutation_level',
            'spread_of_masses',
            'spread_of_force_constants',
            'spread_of_frictions',
        )
        for name in shares:
            if not 0.0 < getattr(self, name) < 1.0:
                raise UserError(f'{name} is {getattr(self, name)}; it must be between 0 and 1')
        if self.named_from < self.included_from:
            raise UserError(
                f'named_from is {self.named_from}, less than included_from, {self.included_from}; '
                'what is named must be in the model'
            )
        if self.spread_of_dampings <= 0.0:
            raise UserError(
                f'spread_of_dampings is {self.spread_of_dampings}; it must be greater than 0'
            )
        scales = (*self.prior_scales, *self.unrated_scales)
        if self.expected_causes <= 0.0 or not all(scale > 0.0 for scale in scales):
            raise UserError(
                'expected_causes, prior_scales and unrated_scales must be greater than 0'
            )
        if self.tolerated_loss < 0.0:
            raise UserError(f'tolerated_loss is {self.tolerated_loss}; it must not be negative')
        if min(self.most_causes, self.most_refits, self.most_asked) < 1:
            raise UserError('most_causes, most_refits and most_asked must be at least 1')
