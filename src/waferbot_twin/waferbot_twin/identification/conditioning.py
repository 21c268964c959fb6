# SPDX-License-Identifier: Apache-2.0
"""
What measured signals say about parameters, and what they leave open.

With S (N, k) the change of N white residuals of unit variance by k scaled parameters, the information in
the signals is S^T S. The singular values s and right vectors V of S = U diag(s) V^T are the combinations
of parameters in the order in which the signals tell them: the standard error of a combination is 1 / s.
One with s = 0 can be moved without any change of the signals.

S comes from difference quotients and has an error, E. By Weyl's inequality no singular value is
further than |E| from the true one; one that is smaller than |E| says nothing. Therefore |E|^2 is taken
off s^2, with the columns of both scaled by D to unit length first, and each parameter is given the
little that is known beforehand, that it lies in its range:

    covariance = (D V diag(max(s^2 - |E|^2, 0)) V^T D + diag(1 / half range)^2)^-1 .

So a parameter that the signals do not show has a standard error as wide as its range, never a small one.

Source: G. H. Golub and C. F. Van Loan, Matrix Computations, 4th ed., sections 2.4 and 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]

OPEN = 0.5
"""
A scaled standard error above which a parameter or combination is called open. On a logarithmic scale
its 95 % interval would reach from a third to three times the value.
"""

TAKES_PART = 0.05
"""Share of the largest entry from which on a parameter is named in a combination."""

SIMPLE = 0.03
"""How close to 1 an exponent or factor is to be written as 1."""


@dataclass(frozen=True)
class Combination:
    """
    Parameters that can move together without the signals telling.

    `members` are their places, `move` how far each goes, scaled, the largest 1.
    """

    members: tuple[int, ...]
    move: tuple[float, ...]


@dataclass(frozen=True)
class Conditioning:
    """
    How well the signals determine the parameters.

    `singular_values` (k,) of S, the largest first, and the `condition_number`, infinite if the
    smallest is within its error; the `covariance` (k, k) of the scaled parameters; `no_influence`,
    places of parameters that the signals do not show; `combinations`, what cannot be told apart.
    """

    singular_values: Array
    condition_number: float
    covariance: Array
    no_influence: tuple[int, ...]
    combinations: tuple[Combination, ...]

    @property
    def standard_errors(self) -> Array:
        """Of each scaled parameter."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)

    @property
    def open(self) -> tuple[bool, ...]:
        """Whether the signals leave a parameter open, one by one."""
        return tuple(bool(error > OPEN) for error in self.standard_errors)

    @property
    def correlation(self) -> Array:
        """Correlations of the estimates, (k, k)."""
        errors = self.standard_errors
        return np.asarray(self.covariance / np.outer(errors, errors), np.float64)


def conditioning(sensitivity: Array, error: Array, half_ranges: Sequence[float]) -> Conditioning:
    """
    Return what a sensitivity matrix (N, k), white and scaled, determines.

    `error` (N, k) estimates the error of its entries; `half_ranges` (k,) are those of the scaled
    parameters.
    """
    ranges = np.asarray(half_ranges, float)
    length = np.linalg.norm(sensitivity, axis=0)
    # What changes the residuals by less than their noise over its whole range has no influence.
    silent = (length * ranges < 1.0) | (length <= np.linalg.norm(error, axis=0))
    information = np.zeros((len(ranges), len(ranges)))
    heard = np.flatnonzero(~silent)
    certain = True
    if len(heard):
        information[np.ix_(heard, heard)], certain = _information(
            sensitivity[:, heard], error[:, heard]
        )
    values = _singular_values(sensitivity)
    covariance = np.linalg.inv(information + np.diag(1.0 / ranges**2))
    known = certain and not silent.any()
    return Conditioning(
        values,
        float(values[0] / values[-1]) if known else math.inf,
        np.asarray(0.5 * (covariance + covariance.T), np.float64),
        tuple(int(place) for place in np.flatnonzero(silent)),
        _combinations(information[np.ix_(heard, heard)], [int(place) for place in heard]),
    )


def _information(sensitivity: Array, error: Array) -> tuple[Array, bool]:
    """Return the information that is beyond the error, and whether there is some of everything."""
    length = np.linalg.norm(sensitivity, axis=0)
    noise = float(np.linalg.norm(error / length, 2))
    # QR first: S has many rows, and R has the same singular values and right vectors.
    triangle = np.linalg.qr(sensitivity / length, mode='r')
    _, values, right = np.linalg.svd(triangle)
    certain = np.maximum(values**2 - noise**2, 0.0)
    scaled = (right.T * certain) @ right
    return np.asarray(scaled * np.outer(length, length), np.float64), bool(certain.all())


def _singular_values(sensitivity: Array) -> Array:
    values = np.linalg.svd(np.linalg.qr(sensitivity, mode='r'), compute_uv=False)
    return np.asarray(values, np.float64)


def _combinations(information: Array, names: Sequence[int]) -> tuple[Combination, ...]:
    """
    Return the open combinations, each with as few parameters as can be.

    A space that is open in several directions has no preferred ones. Those are chosen in which one
    parameter each, found by a pivoted QR decomposition, is alone with those that are not open.
    """
    if not names:
        return ()
    values, vectors = np.linalg.eigh(information)
    space = vectors[:, values < OPEN**-2]
    if not space.shape[1]:
        return ()
    _, _, order = scipy.linalg.qr(space.T, pivoting=True)
    pivots = order[: space.shape[1]]
    found = []
    for move in (space @ np.linalg.inv(space[pivots])).T:
        share = move / move[np.argmax(np.abs(move))]
        members = np.flatnonzero(np.abs(share) > TAKES_PART)
        found.append(
            Combination(
                tuple(names[int(place)] for place in members),
                tuple(float(share[place]) for place in members),
            )
        )
    return tuple(sorted(found, key=lambda item: item.members))


def in_words(combination: Combination, names: Sequence[str], logarithmic: Sequence[bool]) -> str:
    """Return what is known of a combination, and what is not, as a sentence without its full stop."""
    members, move = combination.members, combination.move
    if len(members) == 1:
        return f'{names[members[0]]} is left open'
    if len(members) == 2 and len({logarithmic[place] for place in members}) == 1:
        one, other = (names[place] for place in members)
        power = move[0] / move[1]
        simple = abs(abs(power) - 1.0) < SIMPLE
        if logarithmic[members[0]]:
            if simple:
                kind, sign = ('ratio', '/') if power > 0.0 else ('product', '*')
                return f'only the {kind} {one} {sign} {other} is known'
            return f'only {one} * {other}^{-power:.3g} is known'
        if simple:
            kind, sign = ('difference', '-') if power > 0.0 else ('sum', '+')
            return f'only the {kind} of {one} and {other} is known, each in shares of its range'
        return f'only {one} {-power:+.3g} {other} is known, each in shares of its range'
    together = ', '.join(
        f'{names[place]} {10.0 * step:+.2g} %' for place, step in zip(members, move, strict=True)
    )
    return f'these can change together and nothing shows: {together}'
