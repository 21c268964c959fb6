# SPDX-License-Identifier: Apache-2.0
"""
Signatures fitted linearly to the residuals of all blocks that they show in, with one value for all.

A resistance shows in the windings, a force constant there and in the plant: a value that would suit each
block by itself is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_twin.noise_model.prediction_error import Fit, fit
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array

Signature = dict[str, Array]
"""By block, what parameters change in its residuals: (samples of all channels, parameters)."""

Residuals = Mapping[str, Sequence[Array]]
"""By block, the residual of every channel."""


def side_by_side(signatures: Sequence[Signature], counts: Sequence[int]) -> Signature:
    """Return the signature of several causes with `counts` parameters each; zero where one has none."""
    rows = {block: len(matrix) for item in signatures for block, matrix in item.items()}
    firsts = np.cumsum([0, *counts])
    # Column by column, as it is filtered.
    found = {block: np.zeros((rows[block], firsts[-1]), order='F') for block in sorted(rows)}
    for item, first, count in zip(signatures, firsts, counts, strict=False):
        for block, matrix in item.items():
            found[block][:, first : first + count] = matrix
    return found


def by_channel(matrix: Array, channels: Sequence[Array]) -> list[Array]:
    """Return the rows of a block's signature channel by channel."""
    return np.split(matrix, np.cumsum([len(channel) for channel in channels])[:-1])


def fit_jointly(
    problem: Problem,
    residuals: Residuals,
    signature: Signature,
    rounds: int = 4,
    known: Mapping[str, Fit] | None = None,
) -> Fit:
    """
    Fit a signature to the residuals of its blocks; channels follow one another block by block.

    `known` is how likely the residuals are as they stand, by block, if somebody has found that already.
    """
    colours = [colour for block in signature for colour in known[block].colours] if known else []
    stacked = Stacked.of(residuals, signature)
    noises = [noise for block in signature for noise in problem.noises(block)]
    return fit(stacked.residuals, stacked.signatures, noises, rounds, colours)


@dataclass(frozen=True)
class Stacked:
    """Residuals and signatures of all blocks, channel by channel, one block behind the other."""

    residuals: list[Array]
    signatures: list[Array]

    @classmethod
    def of(cls, residuals: Residuals, signature: Signature) -> Stacked:
        """Stack the blocks of a signature."""
        return cls(
            [channel for block in signature for channel in residuals[block]],
            [
                part
                for block in signature
                for part in by_channel(signature[block], residuals[block])
            ],
        )
