# SPDX-License-Identifier: Apache-2.0
"""Logs as a real machine would give them, with hidden effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from waferbot.logs import Log
from waferbot.model import Model
from waferbot_twin.synthesis import synthesize as write_log


@dataclass(frozen=True)
class Synthesis:
    """A made log, and the truth that is not in it: model, experiment, seed, noise, effects."""

    log: Log
    truth: dict[str, Any] = field(repr=False)

    @property
    def hidden(self) -> pd.DataFrame:
        """One row for each parameter of each hidden effect: `cause`, `parameter`, `value`."""
        rows = [
            {'cause': f'{one["effect"]}:{one["axis"]}', 'parameter': name, 'value': value}
            for one in self.truth['effects']
            for name, value in one['values'].items()
        ]
        return pd.DataFrame(rows, columns=['cause', 'parameter', 'value'])

    def to_dataframe(self) -> pd.DataFrame:
        """Return `hidden`."""
        return self.hidden


def synthesize(
    model: Model,
    effects: Sequence[str],
    out: str | Path,
    experiment: str | Path = 'wafer_exchange',
    noise: float = 1.0,
    seed: int = 0,
    without: Sequence[str] = (),
    force: bool = False,
) -> Synthesis:
    """
    Write a log of a model with hidden effects to the new folder `out`.

    `effects` are `NAME[:AXIS][,KEY=VALUE...]`: an axis that is not given is drawn, a parameter is
    typical. `noise` is a level, 0 for none, 1 as `waferbot_twin.synthesis` says; `without` names signals
    that the log does not have (commanded, currents, command, voltages, amplifier). Raises `UserError` if
    an effect is wrong, the loop is unstable, or the folder exists and `force` is not given.
    """
    _, truth = write_log(
        model.variant,
        effects,
        str(experiment),
        noise,
        seed,
        without,
        Path(out),
        force,
        lambda done, total: None,
    )
    return Synthesis(Log(Path(out)), truth)
