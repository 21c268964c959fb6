# SPDX-License-Identifier: Apache-2.0
"""
Signatures fitted linearly to the residuals of all blocks that they show in, with one value for all.

A resistance shows in the windings, a force constant there and in the plant: a value that would suit each
block by itself is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from waferbot_twin.noise_model.prediction_error import Fit, fit, whitened
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array

Signature = dict[str, Array]
"""By block, what parameters change in its residuals: (samples of all channels, parameters)."""

Residuals = Mapping[str, Sequence[Array]]
"""By block, the residual of every channel."""


def side_by_side(signatures: Sequence[Signature], counts: Sequence[int]) -> Signature:
    """Return the signature of several causes with `counts` parameters each; zero where one has none."""
    rows = {block: len(matrix) for item in signatures for block, matrix in item.items()}
    return {
        block: np.hstack(
            [
                item.get(block, np.zeros((rows[block], count)))
                for item, count in zip(signatures, counts, strict=True)
            ]
        )
        for block in sorted(rows)
    }


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
    blocks = list(signature)
    colours = [colour for block in blocks for colour in known[block].colours] if known else []
    return fit(
        [channel for block in blocks for channel in residuals[block]],
        [part for block in blocks for part in by_channel(signature[block], residuals[block])],
        [noise for block in blocks for noise in problem.noises(block)],
        rounds,
        colours,
    )


def whitened_jointly(
    residuals: Residuals, signature: Signature, estimate: Fit
) -> tuple[Array, Array]:
    """Return the white rows of all blocks (`prediction_error.whitened`) filtered as in a joint fit."""
    blocks = list(signature)
    return whitened(
        [channel for block in blocks for channel in residuals[block]],
        [part for block in blocks for part in by_channel(signature[block], residuals[block])],
        estimate.colours,
    )
